"""What the joints and feet of the nominal robot bear in a held posture."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.posture_geometry import PostureGeometry
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.robot import joint_names


@dataclass(frozen=True)
class Loads:
    """What the joints and the feet bear.

    Attributes:
        torques: with which the load turns what lies beyond each joint, (m, n_joints) [Nm].
        internal_wrench: of the ground on the swing foot sideways and in torsion, (m, 3) [N, N, Nm].
        stiffness: with which the closed legs resist a joint's turning by itself, (m, n_joints) [Nm/rad].
    """

    torques: np.ndarray
    internal_wrench: np.ndarray
    stiffness: np.ndarray


def joint_loads(
    geometry: PostureGeometry,
    weight: float,
    swing_load: tuple[np.ndarray, np.ndarray],
    both: np.ndarray,
    torque_limits: np.ndarray,
) -> Loads:
    """Compute what joints and feet bear in held postures, from the nominal robot and the cells.

    The cells tell how the feet share the weight and where it passes, not what the feet bear
    sideways against each other and in torsion. Elastic servos settle where the complementary energy
    sum tau^2 / stiffness is least (Castigliano); their stiffness goes as their torque limits.

    Args:
        geometry: of the postures.
        weight: of the robot [N].
        swing_load: vertical force on the swing foot, (m,) [N], and where the cells tell that it passes,
            (m, 3) [m].
        both: whether the posture stands on both feet, (m,) bool.
        torque_limits: of the joints' motors, (n_joints,) [Nm].
    """
    torque = weight / geometry.standard[:, 0].sum() * geometry.mass_moments
    # What the ground does to the swing foot acts on every joint between it and the base.
    between = geometry.moved[:, geometry.nominal.swing_frame]
    down, place = swing_load
    ax, ay, az = np.moveaxis(geometry.axes, -1, 0)
    x, y, z = np.moveaxis((place[:, None] - geometry.pivots) * between[:, None], -1, 0)
    # Moments about the axes of unit forces along z, x and y, and of a unit torque about z.
    torque = torque + (y * ax - x * ay) * down[:, None]
    unknown = np.stack([z * ay - y * az, x * az - z * ax, az * between], axis=-1)
    # On one foot the other one bears nothing.
    weigh = 1 / np.sqrt(torque_limits)
    scaled = unknown * weigh[:, None]
    inverse = np.linalg.pinv(scaled)
    push = np.where(both[:, None], -(inverse @ (torque * weigh)[..., None])[..., 0], 0.0)
    shared = np.einsum("mjk,mkj->mj", scaled, inverse) * both[:, None]
    return Loads(
        torques=torque + (unknown @ push[..., None])[..., 0],
        internal_wrench=push,
        stiffness=shared / weigh**2 / Controller().error_at_full_torque,
    )


def torque_limits(model: mujoco.MjModel) -> np.ndarray:
    """Torque limits of the joints' motors, (n_joints,) [Nm]; alike where one has none."""
    limits = np.ones(len(joint_names(model)))
    for k, name in enumerate(joint_names(model)):
        joint = model.joint(name).id
        for i in range(model.nu):
            if model.actuator_trnid[i, 0] == joint and model.actuator_forcerange[i, 1] > 0:
                limits[k] = model.actuator_forcerange[i, 1]
    return limits
