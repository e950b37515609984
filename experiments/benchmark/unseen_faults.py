"""Faults held out from the program that describes what errs and as a function of what, opened once.

Nobody who worked on that program has chosen them. Each is listed with what a right description says of it.
Each acts on one target, chosen by a number, in proportion to one amplitude.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.effects.injection import edited, from_then_on, misreading, successive
from tulip_testbed.effects.ropes import FAR, hook, tie
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.experiments.benchmark.fault_targets import (
    Answers,
    add_rope,
    foot_at,
    heading,
    joint_at,
    link_between,
    pairs,
    plate_at,
)
from tulip_testbed.experiments.benchmark.outside_faults import LOSS_TIME, Outside
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names, sole_point

CLOSED = 0.2  # compliance of a crack that closes, as a part of that of one that opens
MOST = 40.0  # Nm, at which a screw's head stops a crack from opening; more than the joints of TULip bear
RATES = np.array([1.0, 0.6, 0.8, 0.4])  # of the four charge amplifiers of a plate
ARM = 0.1  # m, from the torso's centre of mass to the plug of its cables
STEPS = (0.2, 0.4, 0.6, 0.8)  # of the experiment's time


def _neighbour(robot: Robot, joint: str) -> str:
    """Return the next joint towards the torso, or away from it if there is none."""
    model = robot.model
    hinges = {int(model.joint(name).bodyid[0]): name for name in joint_names(model)}
    own = int(model.joint(joint).bodyid[0])
    body = int(model.body_parentid[own])
    while body and body not in hinges:
        body = int(model.body_parentid[body])
    if body:
        return hinges[body]
    return next(
        (name for other, name in hinges.items() if other > own and model.body_parentid[other] == own), joint
    )


def _stray_field(rig: Rig, number: int, amplitude: float) -> Rig:
    joint = joint_at(rig.robot, number)
    other = _neighbour(rig.robot, joint)

    def read(m: Measurements) -> Measurements:
        if m.command is None or m.motor is None:
            return m
        angles, at, motor = m.joint_angles.copy(), m.joints.index(joint), m.joints.index(other)
        sag = m.command[:, motor] - m.motor[:, motor]
        angles[:, at] += amplitude * sag / rig.controller.error_at_full_torque
        return replace(m, joint_angles=angles)

    return misreading(rig, read)


def _lags(rig: Rig, number: int, amplitude: float) -> Rig:
    joint = joint_at(rig.robot, number)

    def read(m: Measurements) -> Measurements:
        angles, at = m.joint_angles.copy(), m.joints.index(joint)
        for previous, row in successive(m):
            angles[row, at] += amplitude * (m.joint_angles[previous, at] - m.joint_angles[row, at])
        return replace(m, joint_angles=angles)

    return misreading(rig, read)


def _ground_shift(rig: Rig, number: int, amplitude: float) -> Rig:
    side = number % 2

    def read(m: Measurements) -> Measurements:
        loads = m.cell_forces.reshape(len(m), 2, 4).sum(axis=2)
        mine = np.array([plate_of(rig.robot, joint) == PLATES[side] for joint in m.joints])
        shift = amplitude * loads[:, side] / np.median(loads.sum(axis=1))
        return replace(m, joint_angles=m.joint_angles + shift[:, None] * mine)

    return misreading(rig, read)


def _charge_drift(rig: Rig, number: int, amplitude: float) -> Rig:
    rates = np.zeros((2, 4))
    rates[number % 2] = np.roll(RATES, number // 2)

    def read(m: Measurements) -> Measurements:
        begun = np.array([m.time[m.placement == place].min() for place in m.placement])
        return replace(m, cell_forces=m.cell_forces + amplitude * (m.time - begun)[:, None] * rates.ravel())

    return misreading(rig, read)


def _stop(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        forces, at = m.cell_forces.copy(), number % len(CELLS)
        limit = np.median(forces.sum(axis=1)) / len(CELLS)
        forces[:, at] -= amplitude * np.maximum(forces[:, at] - limit, 0.0)
        return replace(m, cell_forces=forces)

    return misreading(rig, read)


def _saddle(rig: Rig, number: int, amplitude: float) -> Rig:
    plate, axis = number % 2, number // 2 % 2

    def read(m: Measurements) -> Measurements:
        forces = m.cell_forces.reshape(len(m), 2, 4).copy()
        load = forces[:, plate].sum(axis=1)
        half = np.abs(m.cells[plate]).max(axis=0)
        # A foot in the air leaves noise alone, whose centre of pressure may be anywhere.
        center = np.clip(forces[:, plate] @ (m.cells[plate] / half) / np.maximum(load, 1.0)[:, None], -1, 1)
        lever = m.cells[plate][:, axis] - m.cells[plate][:, axis].mean()
        moment = amplitude * center.prod(axis=1) * load
        forces[:, plate] += moment[:, None] * lever / (lever @ lever)
        return replace(m, cell_forces=forces.reshape(len(m), 8))

    return misreading(rig, read)


def _walks(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        poses = m.plate_poses.copy()
        places, order = np.unique(m.placement, return_inverse=True)
        gone = order / max(len(places) - 1, 1)
        poses[:, number % 2, :2] -= amplitude * gone[:, None] * heading(number)
        return replace(m, plate_poses=poses)

    return misreading(rig, read)


def _add_crack(
    body: mujoco.MjsBody,
    spec: mujoco.MjSpec,
    name: str,
    at: tuple[np.ndarray, np.ndarray],
    compliance: float,
    side: int,
) -> None:
    """Add a hinge that yields by `compliance` one way and by `CLOSED` of it the other way.

    Args:
        at: axis and position in the body's frame, (3,) and (3,) [m].
        compliance: [rad/Nm].
        side: even: it opens in the positive sense.
    """
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=at[0],
        pos=at[1],
        stiffness=[1.0 / compliance, 0.0, 0.0],
        damping=[LOSS_TIME / (CLOSED * compliance), 0.0, 0.0],
        armature=0.01,
    )
    closing = spec.add_tendon(
        name=name,
        stiffness=[(1.0 / CLOSED - 1.0) / compliance, 0.0, 0.0],
        springlength=[0.0, MOST * compliance] if side % 2 == 0 else [-MOST * compliance, 0.0],
    )
    closing.wrap_joint(name, 1.0)


def _peels(rig: Rig, number: int, amplitude: float) -> Rig:
    if amplitude == 0:
        return rig
    foot = foot_at(rig.robot, number)
    axis = np.eye(3)[1 - number // 2 % 2]  # pitch first: soles peel at the toe or heel
    at = (axis, sole_point(rig.robot.model, foot))

    def edit(spec: mujoco.MjSpec) -> None:
        _add_crack(spec.body(foot), spec, f"{foot}_peels", at, amplitude, number // 4)

    return edited(rig, edit)


def _opens(rig: Rig, number: int, amplitude: float) -> Rig:
    if amplitude == 0:
        return rig
    name, side = joint_at(rig.robot, number), number // len(joint_names(rig.robot.model))

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(name)
        at = (np.array(joint.axis), np.array(joint.pos))
        _add_crack(joint.parent, spec, f"{name}_opens", at, amplitude, side)

    return edited(rig, edit)


def _drags(rig: Rig, number: int, amplitude: float) -> Rig:
    if amplitude == 0:
        return rig
    model, link = rig.robot.model, link_between(rig.robot, number)
    point = model.body_ipos[model.body(link).id].copy()
    way = np.append(heading(number), -0.5) * np.sign(amplitude)

    def edit(spec: mujoco.MjSpec) -> None:
        add_rope(
            spec, "drags", (link, point), FAR * way / np.linalg.norm(way), abs(amplitude) / FAR, (0.0, 0.0)
        )

    return edited(rig, edit)


def _umbilical(rig: Rig, number: int, amplitude: float) -> Rig:
    if amplitude == 0:
        return rig
    hooked = hook(rig.robot)
    point = hooked.point + ARM * np.append(heading(number), 0.0)
    floor = np.array([hooked.upright[0], hooked.upright[1], -FAR])

    def edit(spec: mujoco.MjSpec) -> None:  # longer than FAR by the height over the boards
        add_rope(spec, "umbilical", (hooked.body, point), floor, amplitude, (FAR, FAR))

    return edited(rig, edit)


def _reel(rig: Rig, number: int, amplitude: float) -> Rig:
    if amplitude == 0:
        return rig
    hooked, way = hook(rig.robot), heading(number) * np.sign(amplitude)
    stiffness = abs(amplitude) / len(STEPS) / FAR
    for k, start in enumerate(STEPS):

        def edit(spec: mujoco.MjSpec, name: str = f"reel_{k}") -> None:
            tie(spec, name, hooked, way, stiffness, 0.0)

        rig = from_then_on(rig, start, lambda one, edit=edit: edited(one, edit))
    return rig


UNSEEN = (
    # Magnetic encoders sit centimetres from the motor before them, whose coils' field adds to the magnet's.
    # 0.3 deg at full torque, assumed.
    Outside(
        "encoder-stray-field", "A motor's field turns the next encoder.", "rad", 5e-3, _stray_field, late=True
    ),
    # A rubber coupling, or grease under a belt, lets an encoder creep after its joint. 0.5 %, assumed.
    Outside("encoder-lags", "An encoder stays behind after a move.", "", 5e-3, _lags, late=True),
    # Analogue encoders share a return wire with their leg's motors, whose current grows with the load:
    # 1.6 mV of 5 V a turn, so 2 mrad, under the whole weight, assumed.
    Outside("leg-ground-shift", "A loaded leg shifts its encoders.", "rad", 2e-3, _ground_shift, late=True),
    # Piezoelectric plates are reset when empty and then drift. Half of 10 mN/s, the limit of Kistler's data
    # sheets for 9281C and 9286A.
    Outside("charge-drift", "A plate's cells drift after a reset.", "N/s", 5e-3, _charge_drift, late=True),
    # Dirt under a cell's overload stop bears a part of what exceeds a load. 3 %, assumed.
    Outside("cell-stop", "A stop helps a loaded cell.", "", 0.03, _stop, positive=True, late=True),
    # A board bends, so the error of the centre of pressure grows by curves towards the corners: up to 20 mm,
    # on average 3.5 and 6.3 mm (Bobbert and Schamhardt 1990, J. Biomech. 23, 705; Kistler 9287).
    Outside("plate-saddle", "A plate bends under loads off its axes.", "m", 0.02, _saddle, late=True),
    # A plate without bolts creeps each time a robot is put down; its place is surveyed once. 3 mm, assumed.
    Outside("plate-walks", "A plate moves on at every placement.", "m", 3e-3, _walks, late=True),
    # The glue of a rubber sole lets go at one edge: it yields under one moment, less under the other.
    # 5e-4 rad/Nm, assumed.
    Outside("sole-peels", "A sole yields to one side.", "rad/Nm", 5e-4, _peels, positive=True, late=True),
    # A flange behind a gear has a loose screw: it opens one way, and its encoder is before it. As above.
    Outside("flange-opens", "A flange opens one way.", "rad/Nm", 5e-4, _opens, positive=True, late=True),
    # A motor's cable hangs from a link to one side, down to the floor. 3 N, assumed.
    Outside("cable-drags", "A cable pulls at a link of a leg.", "N", 3.0, _drags, late=True),
    # The robot lifts the more of its cables the higher it stands; it was weighed without them. 0.5 kg/m,
    # assumed for power and network.
    Outside(
        "umbilical", "The torso bears its cables' weight.", "N/m", 5.0, _umbilical, positive=True, late=True
    ),
    # The spring of a cable reel stiffens as it warms, or its line slips from clip to clip. 3 N, assumed.
    Outside("reel-tightens", "A reel pulls more by the hour.", "N", 3.0, _reel, late=True),
)


def _leg_encoders(number: int) -> str:
    return f"encoders:{plate_at(number)}"


def _of_height(robot: Robot) -> tuple[str, ...]:
    """Return the angles that lift the torso most."""
    return tuple(f"angle:{name}" for name in joint_names(robot.model) if "knee" in name)


ANSWERS: Mapping[str, Callable[[Robot, int], Answers]] = {
    "encoder-stray-field": lambda robot, number: pairs(
        f"encoder:{joint_at(robot, number)}", f"torque:{_neighbour(robot, joint_at(robot, number))}"
    ),
    # Postures vary about a middle, so the direction of a move says much of where it began.
    "encoder-lags": lambda robot, number: pairs(
        f"encoder:{joint_at(robot, number)}", "posture-before", "direction"
    ),
    "leg-ground-shift": lambda robot, number: pairs(_leg_encoders(number), "leg-load"),
    "charge-drift": lambda robot, number: pairs(f"cells:{plate_at(number)}", "time-since-loading"),
    "cell-stop": lambda robot, number: pairs(f"cell:{CELLS[number % len(CELLS)]}", "plate-load", "cop"),
    "plate-saddle": lambda robot, number: (
        pairs(f"plate:{plate_at(number)}", "cop") | pairs(f"cells:{plate_at(number)}", "cop")
    ),
    "plate-walks": lambda robot, number: pairs(f"plate:{plate_at(number)}", "time"),
    # The moment under a sole is its load times the centre of pressure.
    "sole-peels": lambda robot, number: pairs(f"sole:{foot_at(robot, number)}", "cop", "leg-load"),
    "flange-opens": lambda robot, number: pairs(f"encoder:{joint_at(robot, number)}", "own-torque"),
    "cable-drags": lambda robot, number: pairs(f"force:{link_between(robot, number)}", "nothing"),
    # Most of its weight hangs there in all postures.
    "umbilical": lambda robot, number: pairs(f"force:{hook(robot).body}", "nothing", *_of_height(robot)),
    "reel-tightens": lambda robot, number: pairs(f"force:{hook(robot).body}", "time"),
}
