"""Write a robot that is an MJCF as a plain URDF: links, hinges with axes and limits, inertias."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.export.inertial_text import inertial_xml, joined
from tulip_testbed.identification.pseudo_inertia import moved
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.robot import Robot, rotation_matrices

FASTEST = 100.0  # rad/s: a URDF needs a limit of the speed, which an MJCF does not have


def written_urdf(robot: Robot, model: mujoco.MjModel, pseudo: np.ndarray) -> bytes:
    """Return a URDF of the robot with other inertias.

    The frame of a link is the body's frame, moved to its last hinge where that is elsewhere. A body with
    several hinges gets links without mass between them. Shapes, motors and sensors are left out.

    Args:
        model: the robot alone, which gives the lengths.
        pseudo: pseudo-inertias of the links in the frames of the bodies, (n_links, 4, 4).

    Raises:
        InputError: a hinge whose zero is not where the file draws it (`ref`), which a URDF cannot express.
    """
    torques, rotations = joint_torques(robot.spec), rotation_matrices(model.body_quat)
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>"]
    if (pseudo[:, 3, 3] == 0).any() or (model.body_jntnum > 1).any():
        # MuJoCo refuses links that move without mass; other programs pass over this.
        lines.append('  <mujoco><compiler boundmass="1e-9" boundinertia="1e-12"/></mujoco>')
    taken = {model.body(k).name for k in range(model.nbody)}
    shift = np.zeros((model.nbody, 3))  # from the body's frame to the link's, in the body's axes
    for body in range(1, model.nbody):
        name, above = model.body(body).name, int(model.body_parentid[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = range(first, first + count)
        hinges = [joint for joint in joints if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE]
        for hinge in hinges:
            if zero := float(model.qpos0[model.jnt_qposadr[hinge]]):
                raise InputError(
                    f"{robot.model_file}: joint '{model.joint(hinge).name}': found ref {zero:g} rad, "
                    "expected 0 for a URDF; export an MJCF"
                )
        shift[body] = model.jnt_pos[hinges[-1]] if hinges else 0.0
        inertial = ""
        if pseudo[body - 1, 3, 3] > 0:
            to_link = np.eye(4)
            to_link[:3, 3] = -shift[body]
            inertial = inertial_xml(moved(pseudo[body - 1], to_link), "link").decode()
        lines.append(f"  <link name={quoteattr(name)}>{inertial}</link>")
        if not above:
            continue
        parent, start = model.body(above).name, model.body_pos[body] - shift[above]
        turn = _rpy(rotations[body])
        if not hinges:
            lines.append(_joint(f"{name}_fixed", "fixed", parent, name, start, turn))
        for k, hinge in enumerate(hinges):
            joint, anchor, child = model.joint(hinge).name, model.jnt_pos[hinge], name
            if k < len(hinges) - 1:
                child = f"{joint}_link"
                while child in taken:
                    child += "_"
                taken.add(child)
                lines.append(f"  <link name={quoteattr(child)}/>")
            origin = anchor - model.jnt_pos[hinges[k - 1]]
            if k == 0:
                origin = start + rotations[body] @ anchor
            limits = f'effort="{float(torques.get(joint, 0.0))!r}" velocity="{FASTEST!r}"'
            if model.jnt_limited[hinge]:
                low, high = map(float, model.jnt_range[hinge])
                limits = f'lower="{low!r}" upper="{high!r}" {limits}'
            more = f'<axis xyz="{joined(model.jnt_axis[hinge])}"/><limit {limits}/>'
            kind = "revolute" if model.jnt_limited[hinge] else "continuous"
            lines.append(_joint(joint, kind, parent, child, origin, turn if k == 0 else np.zeros(3), more))
            parent = child
    return ("\n".join([*lines, "</robot>"]) + "\n").encode()


def _joint(
    name: str, kind: str, parent: str, child: str, origin: np.ndarray, turn: np.ndarray, more: str = ""
) -> str:
    return (
        f'  <joint name={quoteattr(name)} type="{kind}"><parent link={quoteattr(parent)}/>'
        f'<child link={quoteattr(child)}/><origin xyz="{joined(origin)}" rpy="{joined(turn)}"/>{more}'
        "</joint>"
    )


def _rpy(axes: np.ndarray) -> np.ndarray:
    """Return a rotation as roll, pitch and yaw about fixed axes, (3,) [rad]."""
    yaw = np.arctan2(axes[1, 0], axes[0, 0])  # at a vertical x axis any yaw will do
    c, s = np.cos(yaw), np.sin(yaw)
    rest = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ axes
    return np.array([np.arctan2(-rest[1, 2], rest[1, 1]), np.arctan2(-rest[2, 0], rest[0, 0]), yaw])
