"""Faults that the catalogue never holds: the right verdict is `unknown`, or a law that says what errs.

Each acts on one joint, cell or plate, chosen by a number, in proportion to one amplitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from tulip_testbed.effects.injection import edited, misreading
from tulip_testbed.effects.laws.grammar import joints_of_leg
from tulip_testbed.effects.ropes import FAR, hook, tie
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.identification.observation import fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names

LOSS_TIME = 0.005  # s, damping over stiffness
CREEP = 200.0  # s, of a cell that yields
TEETH = 20.0
TURN = 2.4  # rad a number, so that numbers point in all directions

Description = tuple[str, str]  # what errs, and as a function of what; "*": of anything


@dataclass(frozen=True)
class Fault:
    """A fault without an entry in the catalogue.

    Attributes:
        amplitude: a typical one, in SI units.
        inject: (rig, number of the target, amplitude) -> rig.
        right: (robot, number of the target) -> all right descriptions.
        positive: whether there is no other sign.
    """

    name: str
    amplitude: float
    inject: Callable[[Rig, int, float], Rig]
    right: Callable[[Robot, int], tuple[Description, ...]]
    positive: bool = False


def _joint(robot: Robot, number: int) -> str:
    names = joint_names(robot.model)
    return names[number % len(names)]


def _misread(
    field: str, error: Callable[[Measurements, int, int], np.ndarray]
) -> Callable[[Rig, int, float], Rig]:
    """Return an injection by which one column of the readings errs by the amplitude times `error`.

    Args:
        error: (measurements, number of the column, number of the target) -> (m,).
    """

    def inject(rig: Rig, number: int, amplitude: float) -> Rig:
        def read(m: Measurements) -> Measurements:
            values = getattr(m, field).copy()
            at = number % values.shape[1]
            values[:, at] += amplitude * error(m, at, number)
            return replace(m, **{field: values})

        return misreading(rig, read)

    return inject


def _creep(m: Measurements, at: int, number: int) -> np.ndarray:
    begun = np.array([m.time[m.placement == place].min() for place in m.placement])
    return m.cell_forces[:, at] * (1 - np.exp((begun - m.time) / CREEP))


def _bend(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        forces = m.cell_forces.copy()
        plate = slice(4 * (number % 2), 4 * (number % 2) + 4)
        load = forces[:, plate].sum(axis=1, keepdims=True)
        forces[:, plate] *= 1 + amplitude * load / (m.gravity * 20.0)
        return replace(m, cell_forces=forces)

    return misreading(rig, read)


def _slacken(rig: Rig, number: int, amplitude: float) -> Rig:
    hooked, turn = hook(rig.robot), TURN * number

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "slack", hooked, np.array([np.cos(turn), np.sin(turn)]), amplitude, FAR)
        spec.tendon("slack").springlength = [0.0, FAR]

    return edited(rig, edit)


def _yield_sideways(rig: Rig, number: int, amplitude: float) -> Rig:
    name = _joint(rig.robot, number)

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


def _of_encoder(robot: Robot, number: int) -> tuple[Description, ...]:
    return ((f"encoder:{_joint(robot, number)}", "own-angle"),)


def _of_cell(of: str) -> Callable[[Robot, int], tuple[Description, ...]]:
    return lambda robot, number: ((f"cell:{CELLS[number % len(CELLS)]}", of),)


def _of_yield(robot: Robot, number: int) -> tuple[Description, ...]:
    """Any encoder of the joint's leg, or all of them, by a load of that leg."""
    leg = plate_of(robot, _joint(robot, number))
    whats = [f"encoder:{name}" for name in joints_of_leg(robot, leg)] + [f"encoders:{leg}"]
    of = ["own-torque", "leg-load", *(f"torque:{name}" for name in joint_names(robot.model))]
    return tuple((what, one) for what in whats for one in of)


FAULTS = (
    # An encoder's disc is eccentric: an error with one period a turn.
    Fault(
        "encoder-eccentric",
        0.01,
        _misread("joint_angles", lambda m, at, number: np.sin(m.joint_angles[:, at] + TURN * number)),
        _of_encoder,
    ),
    # An encoder errs with every tooth of a gear.
    Fault(
        "encoder-teeth",
        0.005,
        _misread("joint_angles", lambda m, at, number: np.sin(TEETH * m.joint_angles[:, at] + number)),
        _of_encoder,
    ),
    # A cell's gain grows with the square of a temperature.
    Fault(
        "cell-warm",
        0.02,
        _misread(
            "cell_forces",
            lambda m, at, number: (2 * fraction_of_time(m.time) - 1) ** 2 * m.cell_forces[:, at],
        ),
        _of_cell("time"),
    ),
    # A cell reads more the longer it is loaded.
    Fault("cell-creep", 0.02, _misread("cell_forces", _creep), _of_cell("time-since-loading")),
    # A plate's cells read in proportion to the square of its load.
    Fault("plate-bent", 0.02, _bend, lambda robot, number: ((f"cells:{PLATES[number % 2]}", "plate-load"),)),
    # A joint yields about an axis across its own.
    Fault("joint-sideways", 5e-4, _yield_sideways, _of_yield, positive=True),
    # A cable pulls at the torso on one side only.
    Fault("cable-slack", 20.0, _slacken, lambda robot, number: (("force:torso", "*"),), positive=True),
)
