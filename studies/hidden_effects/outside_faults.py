"""Faults that no effect of the catalogue describes: right is `unknown`, or a law that says what errs.

Each acts on one joint, cell or plate, chosen by a number, in proportion to one size, or on the whole.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from studies.hidden_effects.laboratories import Built
from studies.hidden_effects.readings import Readings, bend, couple, play
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.ropes import FAR, hook, tie
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names

CREEP = 200.0  # s, of a cell that yields
TEETH = 20.0
TURN = 2.4  # rad a number, so that numbers point in all directions


@dataclass(frozen=True)
class Fault:
    """A fault without an entry in the catalogue.

    Attributes:
        sizes: the smallest and the largest, in SI units.
        inject: (rig, number of the target, size) -> rig; None: it changes readings alone.
        read: (readings, size, number of the target), changes the readings; None: it changes the rig.
        errs: what errs; "" nothing that a law could name.
        positive: whether there is no other sign.
    """

    name: str
    sizes: tuple[float, float]
    inject: Callable[[Rig, int, float], Rig] | None = None
    read: Callable[[Readings, float, int], None] | None = None
    errs: str = ""
    positive: bool = False

    def put(self, built: Built, number: int, size: float) -> Built:
        """Return a laboratory with the fault."""
        if self.inject is not None:
            return replace(built, rig=self.inject(built.rig, number, size))
        read = self.read
        assert read is not None
        return replace(built, faults=(lambda readings: read(readings, size, number),))

    def culprits(self, robot: Robot, number: int) -> tuple[str, ...]:
        """Return what errs as laws say it, or effects that are right in cause."""
        names = joint_names(robot.model)
        return {
            "": (),
            "encoder": (f"encoder:{names[number % len(names)]}",),
            "cell": (f"cell:{CELLS[number % len(CELLS)]}",),
            "plate": (f"cells:{PLATES[number % 2]}",),
            "sides": tuple(f"cell-side-force:{plate}" for plate in PLATES),
            "torso": ("force:torso",),
            # A plate that shows the load elsewhere, as a function of its place, seems to stand elsewhere.
            "maps": tuple(f"law:plate:{p}/cop/{shape}" for p in PLATES for shape in ("linear", "quadratic")),
        }[self.errs]


def _angle(r: Readings, number: int) -> np.ndarray:
    return r.angles[:, number % r.angles.shape[1]]


def _eccentric(r: Readings, size: float, number: int) -> None:
    angle = _angle(r, number)
    angle += size * np.sin(angle + TURN * number)


def _toothed(r: Readings, size: float, number: int) -> None:
    angle = _angle(r, number)
    angle += size * np.sin(TEETH * angle + number)


def _sticky(r: Readings, size: float, number: int) -> None:
    play(r, size * (np.arange(r.angles.shape[1]) == number % r.angles.shape[1]))


def _warm(r: Readings, size: float, number: int) -> None:
    r.forces.reshape(-1, 8)[:, number % 8] *= 1 + size * (2 * r.time - 1) ** 2


def _creeping(r: Readings, size: float, number: int) -> None:
    begun = np.array([r.true.time[r.true.placement == place].min() for place in r.true.placement])
    r.forces.reshape(-1, 8)[:, number % 8] *= 1 + size * (1 - np.exp((begun - r.true.time) / CREEP))


def _bent(r: Readings, size: float, number: int) -> None:
    load = r.forces[:, number % 2].sum(axis=1, keepdims=True)
    r.forces[:, number % 2] *= 1 + size * load / (r.true.gravity * 20.0)


def _way(number: int) -> np.ndarray:
    return np.array([np.cos(TURN * number), np.sin(TURN * number)])


def _settling(r: Readings, size: float, number: int) -> None:
    """The floor settles during the experiment, most of it at the beginning."""
    r.tilt(size * np.outer(1 - np.exp(-3 * r.time), _way(number)))


def _yielding(r: Readings, size: float, number: int) -> None:
    """The floor yields to the side where the load is."""
    place = (r.true.plate_poses[..., :2] * r.load[..., None]).sum(axis=1) / r.load.sum(axis=1)[:, None]
    along = (place - place.mean(axis=0)) @ _way(number)
    r.tilt(size * np.outer(along / np.abs(along).max(), [-_way(number)[1], _way(number)[0]]))


def _slacken(rig: Rig, number: int, size: float) -> Rig:
    hooked = hook(rig.robot)

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "slack", hooked, FAR * np.append(_way(number), 0.0), size, FAR)
        spec.tendon("slack").springlength = [0.0, FAR]

    return edited(rig, edit)


DEGREE = float(np.radians(1.0))
AT_WII = ("cable-slack", "plate-waves", "floor-yields")  # what moves the base parameters there

FAULTS = (
    Fault("encoder-eccentric", (0.02, 0.08), read=_eccentric, errs="encoder"),
    Fault("encoder-teeth", (0.005, 0.03), read=_toothed, errs="encoder"),
    # It turns only when its joint has moved through a play: other than `lag`, it knows no distance.
    Fault("encoder-hysteresis", (0.002, 0.012), read=_sticky, errs="encoder", positive=True),
    Fault("cell-warm", (0.05, 0.2), read=_warm, errs="cell"),
    Fault("cell-creep", (0.03, 0.15), read=_creeping, errs="cell"),
    Fault("plate-bent", (0.02, 0.15), read=_bent, errs="plate"),
    Fault("cable-slack", (20.0, 150.0), inject=_slacken, errs="torso", positive=True),
    Fault("side-forces", (0.05, 0.2), read=couple, errs="sides", positive=True),
    Fault("plate-waves", (2e-3, 8e-3), read=bend, errs="maps", positive=True),
    Fault("floor-settles", (0.2 * DEGREE, 0.5 * DEGREE), read=_settling),
    Fault("floor-yields", (0.2 * DEGREE, 0.5 * DEGREE), read=_yielding, positive=True),
)
