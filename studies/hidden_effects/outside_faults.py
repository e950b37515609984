"""Faults that no effect of the catalogue describes: right is `unknown`, or a law that says what errs.

Each acts on one joint, cell or plate, chosen by a number, in proportion to one size, or on the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from studies.hidden_effects.laboratories import Built
from studies.hidden_effects.readings import Readings, bend, couple, play
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.laws.grammar import joints_of_leg
from tulip_testbed.effects.ropes import FAR, hook, tie
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names

LOSS_TIME = 0.005  # s, damping over stiffness
CREEP = 200.0  # s, of a cell that yields
TEETH = 20.0
TURN = 2.4  # rad a number, so that numbers point in all directions

Culprits = Callable[[Robot, int], tuple[str, ...]]


@dataclass(frozen=True)
class Fault:
    """A fault without an entry in the catalogue.

    Attributes:
        sizes: the smallest and the largest, in SI units.
        inject: (rig, number of the target, size) -> rig; None: it changes readings alone.
        read: (readings, size, number of the target), changes the readings; None: it changes the rig.
        culprits: (robot, number of the target) -> what errs, as laws say it.
        positive: whether there is no other sign.
    """

    name: str
    sizes: tuple[float, float]
    inject: Callable[[Rig, int, float], Rig] | None = None
    read: Callable[[Readings, float, int], None] | None = None
    culprits: Culprits = lambda robot, number: ()
    positive: bool = False

    def put(self, built: Built, number: int, size: float) -> Built:
        """Return a laboratory with the fault."""
        if self.inject is not None:
            return replace(built, rig=self.inject(built.rig, number, size))
        read = self.read
        assert read is not None
        return replace(built, faults=(lambda readings: read(readings, size, number),))


def _joint(robot: Robot, number: int) -> str:
    names = joint_names(robot.model)
    return names[number % len(names)]


def _eccentric(r: Readings, size: float, number: int) -> None:
    angle = r.angles[:, number % r.angles.shape[1]]
    angle += size * np.sin(angle + TURN * number)


def _toothed(r: Readings, size: float, number: int) -> None:
    angle = r.angles[:, number % r.angles.shape[1]]
    angle += size * np.sin(TEETH * angle + number)


def _sticky(r: Readings, size: float, number: int) -> None:
    play(r, size * (np.arange(r.angles.shape[1]) == number % r.angles.shape[1]))


def _cell(r: Readings, number: int) -> np.ndarray:
    return r.forces.reshape(-1, len(CELLS))[:, number % len(CELLS)]


def _warm(r: Readings, size: float, number: int) -> None:
    _cell(r, number)[:] *= 1 + size * (2 * r.time - 1) ** 2


def _creeping(r: Readings, size: float, number: int) -> None:
    begun = np.array([r.true.time[r.true.placement == place].min() for place in r.true.placement])
    _cell(r, number)[:] *= 1 + size * (1 - np.exp((begun - r.true.time) / CREEP))


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
        tie(spec, "slack", hooked, _way(number), size, FAR)
        spec.tendon("slack").springlength = [0.0, FAR]

    return edited(rig, edit)


def _yield_sideways(rig: Rig, number: int, size: float) -> Rig:
    name = _joint(rig.robot, number)

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(name)
        joint.parent.add_joint(
            name=f"{name}_sideways",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=np.roll(joint.axis, 1 + number % 2),
            pos=joint.pos,
            stiffness=[1.0 / size, 0.0, 0.0],
            damping=[LOSS_TIME / size, 0.0, 0.0],
            armature=joint.armature,
        )

    return edited(rig, edit)


def _encoder(robot: Robot, number: int) -> tuple[str, ...]:
    return (f"encoder:{_joint(robot, number)}",)


def _one_cell(robot: Robot, number: int) -> tuple[str, ...]:
    return (f"cell:{CELLS[number % len(CELLS)]}",)


def _plate(robot: Robot, number: int) -> tuple[str, ...]:
    return (f"cells:{PLATES[number % 2]}",)


def _torso(robot: Robot, number: int) -> tuple[str, ...]:
    return ("force:torso",)


def _leg(robot: Robot, number: int) -> tuple[str, ...]:
    """Any encoder of the joint's leg, or all of them."""
    leg = plate_of(robot, _joint(robot, number))
    return (f"encoders:{leg}", *(f"encoder:{name}" for name in joints_of_leg(robot, leg)))


DEGREE = float(np.radians(1.0))
AT_WII = ("cable-slack", "plate-waves", "floor-yields")  # what moves the base parameters there

FAULTS = (
    # An encoder's disc is eccentric: an error with one period a turn.
    Fault("encoder-eccentric", (0.02, 0.08), read=_eccentric, culprits=_encoder),
    # An encoder errs with every tooth of a gear.
    Fault("encoder-teeth", (0.005, 0.03), read=_toothed, culprits=_encoder),
    # An encoder turns only when its joint has moved through a play: other than `lag`, it knows no distance.
    Fault("encoder-hysteresis", (0.002, 0.012), read=_sticky, culprits=_encoder, positive=True),
    # A cell's gain grows with the square of a temperature.
    Fault("cell-warm", (0.05, 0.2), read=_warm, culprits=_one_cell),
    # A cell reads more the longer it is loaded.
    Fault("cell-creep", (0.03, 0.15), read=_creeping, culprits=_one_cell),
    # A plate's cells read in proportion to the square of its load.
    Fault(
        "plate-bent",
        (0.02, 0.15),
        read=_bent,
        culprits=_plate,
    ),
    # A joint yields about an axis across its own.
    Fault("joint-sideways", (5e-4, 4e-3), inject=_yield_sideways, culprits=_leg, positive=True),
    # A cable pulls at the torso on one side only.
    Fault(
        "cable-slack",
        (20.0, 150.0),
        inject=_slacken,
        culprits=_torso,
        positive=True,
    ),
    # All cells read a part of the side forces.
    Fault("side-forces", (0.05, 0.2), read=couple, positive=True),
    # Both plates show the centre of pressure displaced by smooth waves.
    Fault("plate-waves", (2e-3, 8e-3), read=bend, positive=True),
    # The floor settles.
    Fault("floor-settles", (0.2 * DEGREE, 0.5 * DEGREE), read=_settling),
    # The floor tilts to the side of the load.
    Fault("floor-yields", (0.2 * DEGREE, 0.5 * DEGREE), read=_yielding, positive=True),
)
