"""Changes of the robot and its surroundings by the second dozen of held-out faults.

Each has the number of its target and an amplitude; at zero it changes nothing.
"""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.effects.injection import add_mass, edited, from_then_on
from tulip_testbed.effects.ropes import FAR, hook
from tulip_testbed.effects.targets import links
from tulip_testbed.experiments.benchmark.fault_targets import (
    add_rope,
    foot_at,
    heading,
    joint_at,
)
from tulip_testbed.experiments.benchmark.outside_faults import LOSS_TIME
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot

CLOSING = 2.0  # Nm, at which a worn rubber star fills its claws
FILLED = 5.0  # stiffness of a filled coupling over that of a worn one
SINKS = (0.05, 0.15, 0.3, 0.6)  # of the experiment's time
SHARES = (0.4, 0.3, 0.2, 0.1)  # of the tilt in the end
SHOULDER = 0.1  # m, from the torso's centre of mass to the strap
SLACK = 0.08  # of the height of the torso's centre of mass, by which it sinks before the strap is taut
BATTERY = 0.15  # of the torso's mass; a LiFePO4 pack of 1.6 kg in TULip
PACKED = 0.2  # slope at which a loose battery has squeezed its packing
STOP = 1e5  # N/m, of a battery's bay
TUGS = (0.15, 0.35, 0.55, 0.8)  # of the experiment's time
MOST_TUG = 2.0  # of the typical tug


def above_ankles(robot: Robot) -> tuple[str, ...]:
    """Return the links of the legs without feet and ankles, where a pull has hardly any moment."""
    model = robot.model
    low = {*robot.feet, *(model.body(int(model.body(foot).parentid[0])).name for foot in robot.feet)}
    return tuple(link for link in links(robot)[1:] if link not in low)


def cabled(robot: Robot, number: int) -> str:
    """Return a link of a leg to which a cable may lead."""
    legs = above_ankles(robot)
    return legs[number % len(legs)]


def rubber_star(rig: Rig, number: int, amplitude: float) -> Rig:
    """Let a joint yield behind its encoder, softly until its rubber fills the claws [rad]."""
    if amplitude == 0:
        return rig
    name = joint_at(rig.robot, number)
    stiffness = CLOSING / amplitude

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(name)
        joint.parent.add_joint(
            name=f"{name}_star",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            pos=joint.pos,
            stiffness=[stiffness, 0.0, 0.0],
            damping=[LOSS_TIME * FILLED * stiffness, 0.0, 0.0],
            armature=joint.armature,
        )
        claws = spec.add_tendon(
            name=f"{name}_star",
            stiffness=[(FILLED - 1.0) * stiffness, 0.0, 0.0],
            springlength=[-amplitude, amplitude],
        )
        claws.wrap_joint(f"{name}_star", 1.0)

    return edited(rig, edit)


def settles(rig: Rig, number: int, amplitude: float) -> Rig:
    """Tilt a plate under its foot by ever smaller steps, by this in the end [rad].

    Foot and gravity keep their directions in place of the board: the leg above leans instead.
    """
    if amplitude == 0:
        return rig
    foot, axis = foot_at(rig.robot, number), np.eye(3)[1 - number // 2 % 2]  # about y first
    for start, share in zip(SINKS, SHARES, strict=True):

        def edit(spec: mujoco.MjSpec, angle: float = amplitude * share) -> None:
            body, turned = spec.body(foot), np.zeros(4)
            tilt = np.append(np.cos(angle / 2), np.sin(angle / 2) * axis)
            mujoco.mju_mulQuat(turned, np.asarray(body.quat, float), tilt)
            body.quat = turned

        rig = from_then_on(rig, start, lambda one, edit=edit: edited(one, edit))
    return rig


def strap(rig: Rig, number: int, amplitude: float) -> Rig:
    """Hang the torso on a spring that is taut where it crouches [N/m]."""
    if amplitude == 0:
        return rig
    hooked = hook(rig.robot)
    point = hooked.point + SHOULDER * np.append(heading(number), 0.0)
    gantry = hooked.upright + np.array([0.0, 0.0, FAR])
    taut = FAR + SLACK * float(hooked.upright[2])

    def edit(spec: mujoco.MjSpec) -> None:
        add_rope(spec, "strap", (hooked.body, point), gantry, amplitude, (0.0, taut))

    return edited(rig, edit)


def battery(rig: Rig, number: int, amplitude: float) -> Rig:
    """Let a part of the torso's mass slide in the torso, this far each way [m]."""
    if amplitude == 0:
        return rig
    hooked, torso = hook(rig.robot), rig.robot.model.body(1)
    mass = BATTERY * float(torso.mass[0])
    packing = PACKED * mass * float(-rig.robot.model.opt.gravity[2]) / amplitude  # N/m

    def edit(spec: mujoco.MjSpec) -> None:
        add_mass(spec, hooked.body, -mass, hooked.point)
        bay = spec.body(hooked.body).add_body(
            name="battery", pos=hooked.point, ipos=[0.0, 0.0, 0.0], mass=mass, inertia=[1e-3 * mass] * 3
        )
        bay.explicitinertial = True
        bay.add_joint(
            name="battery_slides",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=np.eye(3)[number % 2],
            stiffness=[packing, 0.0, 0.0],
            damping=[2.0 * np.sqrt(packing * mass), 0.0, 0.0],
        )
        walls = spec.add_tendon(
            name="battery_bay", stiffness=[STOP, 0.0, 0.0], springlength=[-amplitude, amplitude]
        )
        walls.wrap_joint("battery_slides", 1.0)

    return edited(rig, edit)


def tugs(rig: Rig, number: int, amplitude: float) -> Rig:
    """Pull at a link of a leg, from some times on each time another way as well [N]."""
    if amplitude == 0:
        return rig
    link = cabled(rig.robot, number)
    point = rig.robot.model.body(link).ipos.copy()
    rng = np.random.default_rng(number)
    for k, start in enumerate(TUGS):
        tug = rng.standard_normal(2)
        tug *= min(1.0, MOST_TUG / float(np.linalg.norm(tug)))
        force = float(np.linalg.norm(tug))
        anchor = FAR * np.append(np.sign(amplitude) * tug / force, 0.0)
        stiffness = abs(amplitude) * force / FAR

        def edit(
            spec: mujoco.MjSpec, name: str = f"tug_{k}", anchor: np.ndarray = anchor, k: float = stiffness
        ) -> None:
            add_rope(spec, name, (link, point), anchor, k, (0.0, 0.0))

        rig = from_then_on(rig, start, lambda one, edit=edit: edited(one, edit))
    return rig
