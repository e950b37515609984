"""Compliant soles and load cells: springs between foot and sole, and between board and cells."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.robot import Robot

# Springs are critically damped at this rate by an armature inertia of their own, which has no weight. The
# rate is slow enough for the time step and fast compared with the settling of the robot.
RATE = 50.0  # 1/s; at 150, together with flexible drives, the contacts gained energy
# Stiffer springs are rigid: 100 N m would turn them by 1e-7 rad, and at 1e-11 rad/(N m) their rounding errors
# tip the robot in statics.
RIGID = 1e-9  # rad/(N m)
SHAPE = ("type", "size", "quat", "group", "rgba")
CONTACT = ("contype", "conaffinity", "condim", "priority", "friction", "solref", "solimp", "margin")


@dataclass(frozen=True)
class Compliance:
    """Compliances of soles and load cells; zero means rigid.

    Attributes:
        sole: vertical compliance of a sole [m/N].
        sole_tilt: compliance of a sole in roll and pitch about its centre [rad/(N m)].
        cell: vertical compliance of every load cell [m/N].
        right_roll, right_pitch, left_roll, left_pitch: what one sole yields about one axis in addition to
            `sole_tilt` [rad/(N m)].
    """

    sole: float = 0.0
    sole_tilt: float = 0.0
    cell: float = 0.0
    right_roll: float = 0.0
    right_pitch: float = 0.0
    left_roll: float = 0.0
    left_pitch: float = 0.0

    @property
    def tilt(self) -> np.ndarray:
        """Return the compliance of the right and the left sole in roll and pitch, (2, 2) [rad/(N m)]."""
        own = [[self.right_roll, self.right_pitch], [self.left_roll, self.left_pitch]]
        return self.sole_tilt + np.array(own)


def add_compliance(spec: mujoco.MjSpec, robot: Robot, compliance: Compliance) -> None:
    """Mount the sole corners of each foot and the cells of each board on springs where compliance > 0."""
    for foot, (roll, pitch) in zip(robot.feet, compliance.tilt.tolist(), strict=True):
        if max(compliance.sole, roll, pitch) > 0:
            corners = [spec.geom(f"{foot}_{corner}") for corner in CORNERS]
            center = np.mean([corner.pos for corner in corners], axis=0)
            center[2] -= corners[0].size[0]
            sole = _hang(spec, spec.body(foot), f"{foot}_sole", center.tolist(), corners)
            if compliance.sole > 0:
                _spring(sole, "z", mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], compliance.sole)
            if roll > 0:
                _spring(sole, "roll", mujoco.mjtJoint.mjJNT_HINGE, [1, 0, 0], roll)
            if pitch > 0:
                _spring(sole, "pitch", mujoco.mjtJoint.mjJNT_HINGE, [0, 1, 0], pitch)
    if compliance.cell > 0:
        for plate in PLATES:
            for corner in CORNERS:
                name = f"{plate}_plate_{corner}"
                parts = [spec.geom(name), spec.site(name)]
                cell = _hang(spec, spec.body(f"{plate}_plate"), f"{name}_cell", parts[1].pos, parts)
                _spring(cell, "z", mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], compliance.cell)


def lagging(model: mujoco.MjModel) -> np.ndarray:
    """Return which degrees of freedom are such springs, (nv,) bool: these follow a load late, by 40 ms."""
    damping = 2.0 * model.jnt_stiffness / RATE
    springs = (model.jnt_stiffness > 0) & np.isclose(model.dof_damping[model.jnt_dofadr], damping)
    out = np.zeros(model.nv, bool)
    out[model.jnt_dofadr[springs]] = True
    return out


def _hang(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, position: list[float], parts: list
) -> mujoco.MjsBody:
    """Add a massless body at `position` in `body` and move the geoms and sites `parts` to it."""
    child = body.add_body(name=name, pos=position, mass=1e-9, inertia=[1e-9] * 3, ipos=[0, 0, 0])
    child.explicitinertial = True
    for part in parts:
        add = child.add_geom if isinstance(part, mujoco.MjsGeom) else child.add_site
        copied = add(part.classname)
        for attribute in SHAPE + (CONTACT if isinstance(part, mujoco.MjsGeom) else ()):
            setattr(copied, attribute, getattr(part, attribute))
        copied.pos = part.pos - np.asarray(position)
        own_name = part.name
        spec.delete(part)
        copied.name = own_name
    return child


def _spring(
    body: mujoco.MjsBody, direction: str, kind: mujoco.mjtJoint, axis: list[int], compliance: float
) -> None:
    inertia = 1.0 / (compliance * RATE**2)
    body.add_joint(
        name=f"{body.name}_{direction}",
        type=kind,
        axis=axis,
        stiffness=1.0 / compliance,
        armature=inertia,
        damping=2.0 * inertia * RATE,
    )
