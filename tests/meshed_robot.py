"""A humanoid as they are published: 29 joints, a mesh on every link."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot, joint_names, load_robot
from tulip_testbed.sim.shipped import TULIP

SUBDIVISIONS = 4  # 5,120 triangles a mesh; those of a Unitree G1 (29 joints) have 11,099 on average
ARM = (
    ("shoulder_pitch", 1),
    ("shoulder_roll", 0),
    ("shoulder_yaw", 2),
    ("elbow", 1),
    *zip(("wrist_yaw", "wrist_roll", "wrist_pitch"), (2, 0, 1), strict=True),
)
HEAD = (("neck_yaw", 2), ("neck_pitch", 1), ("neck_roll", 0))


def write_meshed_robot(folder: Path) -> Robot:
    """TULip with arms and a head, every link covered by a mesh of its own that touches nothing."""
    folder.mkdir(parents=True)
    spec = mujoco.MjSpec.from_file(str(TULIP.with_name("tulip.xml")))
    for key in list(spec.keys):
        spec.delete(key)
    torso = spec.worldbody.bodies[0] if hasattr(spec.worldbody, "bodies") else spec.bodies[1]
    for side, y in (("left", 0.2), ("right", -0.2)):
        _add_chain(spec, torso, side, ARM, [0.0, y, 0.45], [0.0, 0.0, -0.08])
    _add_chain(spec, torso, "head", HEAD, [0.0, 0.0, 0.5], [0.0, 0.0, 0.05])
    for k, body in enumerate(spec.bodies[1:]):
        _write_mesh(folder / f"{body.name}.obj", 0.05 + 0.002 * k)
        spec.add_mesh(name=body.name, file=f"{body.name}.obj")
        body.add_geom(
            name=f"{body.name}_shape",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=body.name,
            contype=0,
            conaffinity=0,
            group=2,
        )
    spec.meshdir = str(folder)
    spec.compile()
    text = spec.to_xml()
    (folder / "robot.xml").write_text(
        text.replace(f'meshdir="{folder}/"', "").replace(f'meshdir="{folder}"', "")
    )
    planning = load_robot().settings["planning"]
    (folder / "robot.toml").write_text(
        'name = "meshed"\nmodel = "robot.xml"\nstance_foot = "right_foot"\nswing_foot = "left_foot"\n'
        "[planning]\n" + "".join(f"{key} = {value}\n" for key, value in planning.items())
    )
    return load_robot(folder / "robot.toml")


def _add_chain(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    name: str,
    joints: tuple[tuple[str, int], ...],
    first: list[float],
    then: list[float],
) -> None:
    for k, (joint, axis) in enumerate(joints):
        body = parent.add_body(name=f"{name}_{joint}_link", pos=first if k == 0 else then)
        body.mass, body.inertia, body.explicitinertial = 0.05, [5e-5] * 3, True
        body.ipos = [0.0, 0.01, then[2] / 2]
        body.add_joint(
            name=f"{name}_{joint}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=np.eye(3)[axis],
            range=[-20.0, 20.0],  # MjSpec takes degrees
            limited=True,
            armature=0.01,
            frictionloss=0.05,
        )
        motor = spec.add_actuator(name=f"{name}_{joint}", target=f"{name}_{joint}")
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
        motor.ctrllimited, motor.ctrlrange = True, [-10.0, 10.0]
        parent = body


def _write_mesh(path: Path, radius: float) -> None:
    """A bumpy ball."""
    ball = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS, radius=radius)
    ball.vertices *= 1 + 0.1 * np.sin(5 * ball.vertices[:, :1] / radius)
    ball.export(path)


def meshed_plan(robot: Robot, shipped: PosturePlan, rng: np.random.Generator) -> PosturePlan:
    """The shipped postures of the legs, arms and head anywhere."""
    joints = joint_names(robot.model)
    angles = rng.uniform(-0.3, 0.3, (len(shipped), len(joints)))
    angles[:, [joints.index(name) for name in shipped.joints]] = shipped.joint_angles
    made = {"model": robot.model_file.name, "sha256": robot.model_hash}
    return replace(shipped, joints=joints, joint_angles=angles, robot=made)
