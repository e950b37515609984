"""Faults that the catalogue never holds, to be hidden in data: the right answer is `unknown`.

Each acts on one joint, cell or plate, chosen by a number, in proportion to one amplitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.effects.injection import edited, misreading
from tulip_testbed.effects.ropes import FAR, hook, tie
from tulip_testbed.identification.observation import fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names

LOSS_TIME = 0.005  # s, damping over stiffness
CREEP = 200.0  # s, of a cell that yields
TEETH = 20.0


@dataclass(frozen=True)
class Outside:
    """A fault without an entry in the catalogue.

    Attributes:
        amplitude: a typical one [unit]; the benchmark draws multiples of it by what they show.
        inject: (rig, number of the target, amplitude) -> rig.
        positive: whether there is no other sign.
        late: thought of after the discovery was fixed. Of the others some look like patterns that it tries.
    """

    name: str
    sentence: str
    unit: str
    amplitude: float
    inject: Callable[[Rig, int, float], Rig]
    positive: bool = False
    late: bool = False


def _angles(rig: Rig, number: int, error: Callable[[Measurements, int], np.ndarray]) -> Rig:
    """Joint `number`'s encoder errs by `error` of the measurements and the joint's number, (m,) [rad]."""

    def read(m: Measurements) -> Measurements:
        at = number % len(m.joints)
        wrong = np.zeros_like(m.joint_angles)
        wrong[:, at] = error(m, at)
        return replace(m, joint_angles=m.joint_angles + wrong)

    return misreading(rig, read)


def _cells(rig: Rig, number: int, error: Callable[[Measurements, int], np.ndarray]) -> Rig:
    """The same of a cell [N]."""

    def read(m: Measurements) -> Measurements:
        at = number % m.cell_forces.shape[1]
        wrong = np.zeros_like(m.cell_forces)
        wrong[:, at] = error(m, at)
        return replace(m, cell_forces=m.cell_forces + wrong)

    return misreading(rig, read)


def _eccentric(rig: Rig, number: int, amplitude: float) -> Rig:
    phase = 2.4 * number
    return _angles(rig, number, lambda m, at: amplitude * np.sin(m.joint_angles[:, at] + phase))


def _jump(rig: Rig, number: int, amplitude: float) -> Rig:
    return _angles(
        rig, number, lambda m, at: amplitude * (m.joint_angles[:, at] > np.median(m.joint_angles[:, at]))
    )


def _coupled(rig: Rig, number: int, amplitude: float) -> Rig:
    return _angles(rig, number, lambda m, at: amplitude * m.joint_angles[:, at - 1])


def _warm(rig: Rig, number: int, amplitude: float) -> Rig:
    return _cells(
        rig, number, lambda m, at: amplitude * (2 * fraction_of_time(m.time) - 1) ** 2 * m.cell_forces[:, at]
    )


def _walk(rig: Rig, number: int, amplitude: float) -> Rig:
    def walk(m: Measurements, at: int) -> np.ndarray:
        steps = np.random.default_rng(number).standard_normal(10_000)
        path = np.concatenate([[0.0], np.cumsum(steps)]) / 100
        return amplitude * np.interp(fraction_of_time(m.time), np.linspace(0, 1, len(path)), path)

    return _cells(rig, number, walk)


def _bent(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        forces = m.cell_forces.copy()
        plate = slice(4 * (number % 2), 4 * (number % 2) + 4)
        load = forces[:, plate].sum(axis=1, keepdims=True)
        forces[:, plate] *= 1 + amplitude * load / (m.gravity * 20.0)
        return replace(m, cell_forces=forces)

    return misreading(rig, read)


def _skewed(rig: Rig, number: int, amplitude: float) -> Rig:
    names = joint_names(rig.robot.model)

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(names[number % len(names)])
        across = np.roll(joint.axis, 1 + number % 2)
        joint.axis = Rotation.from_rotvec(amplitude * across).apply(joint.axis)

    return edited(rig, edit)


def _slack(rig: Rig, number: int, amplitude: float) -> Rig:
    hooked, turn = hook(rig.robot), 2.4 * number

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "slack", hooked, np.array([np.cos(turn), np.sin(turn)]), amplitude, FAR)
        spec.tendon("slack").springlength = [0.0, FAR]

    return edited(rig, edit)


def _sideways(rig: Rig, number: int, amplitude: float) -> Rig:
    names = joint_names(rig.robot.model)
    name = names[number % len(names)]

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(name)
        joint.parent.add_joint(
            name=f"{name}_sideways",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=np.roll(joint.axis, 1 + number % 2),
            pos=joint.pos,
            stiffness=[1.0 / amplitude, 0.0, 0.0],
            damping=[LOSS_TIME / amplitude, 0.0, 0.0],
            armature=joint.armature,
        )

    return edited(rig, edit)


def _creep(rig: Rig, number: int, amplitude: float) -> Rig:
    def creep(m: Measurements, at: int) -> np.ndarray:
        begun = np.array([m.time[m.placement == place].min() for place in m.placement])
        return amplitude * m.cell_forces[:, at] * (1 - np.exp((begun - m.time) / CREEP))

    return _cells(rig, number, creep)


def _touching(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        plates = m.cell_forces.reshape(-1, 2, 4).copy()
        giver = number % 2
        passed_on = amplitude * plates[:, giver]
        plates[:, giver] -= passed_on
        plates[:, 1 - giver] += passed_on.mean(axis=1, keepdims=True)
        return replace(m, cell_forces=plates.reshape(-1, 8))

    return misreading(rig, read)


def _teeth(rig: Rig, number: int, amplitude: float) -> Rig:
    return _angles(rig, number, lambda m, at: amplitude * np.sin(TEETH * m.joint_angles[:, at] + number))


OUTSIDE = (
    Outside("encoder-eccentric", "An encoder errs with one period a turn.", "rad", 0.01, _eccentric),
    Outside("encoder-jump", "An encoder reads too much beyond one angle.", "rad", 0.01, _jump),
    Outside("encoder-coupled", "A joint's reading depends on its neighbour's angle.", "", 0.01, _coupled),
    Outside("cell-warm", "A cell's gain grows with the square of a temperature.", "", 0.02, _warm),
    Outside("cell-walk", "A cell's zero walks at random.", "N", 1.0, _walk),
    Outside("plate-bent", "A plate's cells read in proportion to its load's square.", "", 0.02, _bent),
    Outside("axis-skewed", "A joint's axis is not where the drawing has it.", "rad", 0.01, _skewed),
    Outside(
        "cable-slack", "A cable pulls at the torso on one side only.", "N/m", 20.0, _slack, positive=True
    ),
    Outside(
        name="joint-sideways",
        sentence="A joint yields about an axis across its own.",
        unit="rad/Nm",
        amplitude=5e-4,
        inject=_sideways,
        positive=True,
        late=True,
    ),
    Outside("cell-creep", "A cell reads more the longer it is loaded.", "", 0.02, _creep, late=True),
    Outside(
        name="boards-touch",
        sentence="A board passes part of its load on to the other.",
        unit="",
        amplitude=0.01,
        inject=_touching,
        positive=True,
        late=True,
    ),
    Outside("encoder-teeth", "An encoder errs with every tooth of a gear.", "rad", 0.005, _teeth, late=True),
)
