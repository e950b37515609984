"""Build the robot as the laboratory needs it, as MJCF with no other files."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.experiments.robot_import.feet import Foot, Stance
from tulip_testbed.experiments.robot_import.skeleton import (
    LEAST_INERTIA,
    LEAST_MASS,
    Array,
    Link,
    Shape,
    Skeleton,
    quaternion,
)
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.drive_needs import SOLIMP_FRICTION, SOLREF_FRICTION

CORNER_RADIUS = 0.002  # m
DARKEST = 0.35  # colours are lightened, so that black robots can be seen


def compose(name: str, skeleton: Skeleton, stance: Stance) -> mujoco.MjSpec:
    """Return the robot alone: links, hinges with complete drives, motors, shapes and sole corners."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    # Place and axes of every link's frame in the world at zero angles.
    frames = [(link.place, link.turn) for link in skeleton.links]
    frames[0] = skeleton.links[0].place, stance.axes
    for foot in stance.feet:
        frames[foot.link] = foot.origin, foot.axes
    bodies: list[mujoco.MjsBody] = []
    meshes: dict[int, str] = {}
    for k, link in enumerate(skeleton.links):
        place, turn = frames[k]
        if link.parent < 0:
            body = _body(spec.worldbody, link, frames[k], (np.zeros(3), np.eye(3)))
            body.add_freejoint(name=f"{link.name}_free")
        else:
            body = _body(bodies[link.parent], link, frames[k], frames[link.parent])
        bodies.append(body)
        for hinge in link.hinges:
            body.add_joint(
                name=hinge.name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                pos=turn.T @ (hinge.anchor - place),
                axis=turn.T @ hinge.axis,
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                range=hinge.range,
                armature=hinge.armature,
                damping=[hinge.damping, 0, 0],
                frictionloss=hinge.friction,
                solref_friction=SOLREF_FRICTION,
                solimp_friction=SOLIMP_FRICTION,
            )
        for number, shape in enumerate(link.shapes):
            _add_shape(spec, body, shape, frames[k], f"{link.name}_shape{number}", meshes)
    for hinge in skeleton.hinges:
        assert hinge.torque is not None
        torques = [-hinge.torque, hinge.torque]
        motor = spec.add_actuator(name=hinge.name, target=hinge.name, gear=[1, 0, 0, 0, 0, 0])
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.forcelimited, motor.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, torques
    for foot in stance.feet:
        _add_sole(bodies[foot.link], foot)
    return spec


def _body(
    parent: mujoco.MjsBody, link: Link, frame: tuple[Array, Array], above: tuple[Array, Array]
) -> mujoco.MjsBody:
    (place, turn), (base, axes) = frame, above
    moments, principal = np.linalg.eigh(turn.T @ link.inertia @ turn)
    if np.linalg.det(principal) < 0:
        principal[:, 0] *= -1
    moments = np.maximum(moments, LEAST_INERTIA)
    moments[2] = min(moments[2], moments[0] + moments[1])
    return parent.add_body(
        name=link.name,
        pos=axes.T @ (place - base),
        quat=quaternion(axes.T @ turn),
        mass=max(link.mass, LEAST_MASS),
        ipos=turn.T @ (link.center - place),
        iquat=quaternion(principal),
        inertia=moments,
        explicitinertial=True,
    )


def _add_shape(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    shape: Shape,
    frame: tuple[Array, Array],
    name: str,
    meshes: dict[int, str],
) -> None:
    place, turn = frame
    geom = body.add_geom(
        type=shape.kind,
        size=shape.size,
        pos=turn.T @ (shape.place - place),
        quat=quaternion(turn.T @ shape.turn),
        rgba=[*(DARKEST + (1 - DARKEST) * shape.color[:3]), 1.0],
        group=3 if shape.collides else 2,
        contype=int(shape.collides),
        conaffinity=int(shape.collides),
        mass=0.0,
    )
    if shape.vertices is not None:
        if id(shape.vertices) not in meshes:
            meshes[id(shape.vertices)] = name
            spec.add_mesh(name=name, uservert=np.round(shape.vertices, 5).ravel())
        geom.meshname = meshes[id(shape.vertices)]
        geom.size = [0, 0, 0]


def _add_sole(body: mujoco.MjsBody, foot: Foot) -> None:
    for corner, point in zip(CORNERS, foot.corners, strict=True):
        body.add_geom(
            name=f"{body.name}_{corner}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[CORNER_RADIUS, 0, 0],
            pos=[point[0], point[1], point[2] + CORNER_RADIUS],
            rgba=[0.1, 0.1, 0.1, 1],
            group=3,
            contype=1,
            conaffinity=0,
            mass=0.0,
        )
