"""Static loads of the nominal robot in a held posture: centre of mass and torque on every joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.posture_geometry import PostureGeometry
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.robot import joint_names

ROUNDING = 1e-12  # relative
# S.d. of the wrench between the closed legs about that of elastic servos without friction, assumed: a fifth
# of the wrench of TULip's postures. Friction at rest makes most of it.
UNSEEN = np.array([1.0, 1.0, 0.4])  # N, N, Nm


@dataclass(frozen=True)
class Loads:
    """Static loads of joints and feet.

    Attributes:
        torques: torque of the load on each joint about its axis, (m, n_joints) [Nm].
        internal_wrench: horizontal force and torsion of the ground on the swing foot, (m, 3) [N, N, Nm].
        stiffness: stiffness of the closed legs against a rotation of a single joint, (m, n_joints) [Nm/rad].
        levers: torque on every joint per unit of the internal wrench, (m, n_joints, 3) [m, m, -].
        doubt: s.d. of the torques, by the noise of the cells and by what they do not show of the internal
            wrench, (m, n_joints) [Nm].
    """

    torques: np.ndarray
    internal_wrench: np.ndarray
    stiffness: np.ndarray
    levers: np.ndarray
    doubt: np.ndarray


def joint_loads(
    geometry: PostureGeometry,
    weight: float,
    swing_load: tuple[np.ndarray, np.ndarray],
    swing_cells: np.ndarray,
    cell_sd: float,
    both: np.ndarray,
    servo_stiffness: np.ndarray,
) -> Loads:
    """Compute the loads of joints and feet in held postures from the nominal robot and the cells.

    The cells give the vertical force on each foot and its point, but not the horizontal force and torsion
    between the feet. Elastic servos settle at the least complementary energy sum tau^2 / stiffness
    (Castigliano).

    Args:
        geometry: geometry of the postures.
        weight: weight of the robot [N].
        swing_load: vertical force on the swing foot, (m,) [N], and its point by the cells, (m, 3) [m].
        swing_cells: places of the cells under the swing foot, (m, 4, 2) [m]. cell_sd: their noise [N].
        both: whether the posture stands on both feet, (m,) bool.
        servo_stiffness: torque of each joint's servo per error of its angle, (n_joints,) [Nm/rad].
    """
    torque = weight / geometry.standard[:, 0].sum() * geometry.mass_moments
    # The wrench of the ground on the swing foot acts on every joint between it and the base.
    between = geometry.moved[:, geometry.nominal.swing_frame]
    down, place = swing_load
    ax, ay, az = np.moveaxis(geometry.axes, -1, 0)
    x, y, z = np.moveaxis((place[:, None] - geometry.pivots) * between[:, None], -1, 0)
    # Moments about the axes of unit forces along z, x and y, and of a unit torque about z.
    torque = torque + (y * ax - x * ay) * down[:, None]
    cx, cy = np.moveaxis(
        (swing_cells[:, :, None] - geometry.pivots[:, None, :, :2]) * between[:, None], -1, 0
    )
    by_cells = cy * ax[:, None] - cx * ay[:, None]
    unknown = np.stack([z * ay - y * az, x * az - z * ax, az * between], axis=-1)
    # In single support the swing foot bears no load.
    weigh = 1 / np.sqrt(servo_stiffness)
    scaled = unknown * weigh[:, None]
    # The pseudoinverse; the small term keeps it finite where the legs leave a component free.
    square = scaled.mT @ scaled
    scale = np.trace(square, axis1=1, axis2=2)[:, None, None] + 1e-300
    inverse = np.linalg.solve(square + ROUNDING * scale * np.eye(3), scaled.mT)
    push = np.where(both[:, None], -(inverse @ (torque * weigh)[..., None])[..., 0], 0.0)
    settled = by_cells - np.einsum("mjk,mkl,mcl->mcj", unknown, inverse, by_cells * weigh, optimize=True)
    variance = cell_sd**2 * (settled**2).sum(axis=1) + ((unknown * UNSEEN) ** 2).sum(axis=2)
    shared = np.einsum("mjk,mkj->mj", scaled, inverse) * both[:, None]
    return Loads(
        torques=torque + (unknown @ push[..., None])[..., 0],
        internal_wrench=push,
        stiffness=shared / weigh**2,
        levers=unknown * both[:, None, None],
        doubt=np.sqrt(variance) * both[:, None],
    )


def servo_stiffness(model: mujoco.MjModel, gains: Mapping[str, float]) -> np.ndarray:
    """Return the stiffness of the joints' servos, (n_joints,) [Nm/rad].

    Where no gain is stated, it is proportional to the torque limit (1 Nm for a joint without a motor).

    Args:
        gains: of position, by joint [Nm/rad].
    """
    limits = np.ones(len(joint_names(model)))
    for k, name in enumerate(joint_names(model)):
        joint = model.joint(name).id
        for i in range(model.nu):
            if model.actuator_trnid[i, 0] == joint and model.actuator_forcerange[i, 1] > 0:
                limits[k] = model.actuator_forcerange[i, 1]
    usual = limits / Controller().error_at_full_torque
    return np.array([gains.get(name, k) for name, k in zip(joint_names(model), usual, strict=True)])
