"""What the nominal robot's weight does in a held posture: its centre of mass, the torque on every joint."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.kinematics import Tree, joint_axes, moved_frames, walk
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.robot import joint_names


def mass_center(tree: Tree, rotations: np.ndarray, positions: np.ndarray, standard: np.ndarray) -> np.ndarray:
    """Centre of mass (eq. 1), (m, 3) [m].

    Args:
        rotations, positions: of all frames, (m, n_frames, 3, 3) and (m, n_frames, 3) [m].
        standard: (n_links, 4) [kg, kg m].
    """
    frames = np.array(tree.frame_of_link)
    moment = standard[:, 0, None] * positions[:, frames]
    moment = moment + (rotations[:, frames] @ standard[:, 1:, None])[..., 0]
    return moment.sum(axis=1) / standard[:, 0].sum()


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
    tree: Tree,
    base: int,
    frames: tuple[np.ndarray, np.ndarray],
    standard: np.ndarray,
    weight: float,
    swing_frame: int,
    swing_load: tuple[np.ndarray, np.ndarray],
    both: np.ndarray,
    torque_limits: np.ndarray,
) -> Loads:
    """Compute what joints and feet bear in held postures, from the nominal robot and the cells.

    The cells tell how the feet share the weight and where it passes, not what the feet bear
    sideways against each other and in torsion. Elastic servos settle where the complementary energy
    sum tau^2 / stiffness is least (Castigliano); their stiffness goes as their torque limits.

    Args:
        frames: rotations (m, n_frames, 3, 3) and origins (m, n_frames, 3) [m] in the base frame.
        standard: nominal standard parameters (eq. 5), (n_links, 4) [kg, kg m].
        weight: of the robot [N].
        swing_frame: frame number of the swing foot.
        swing_load: vertical force on it, (m,) [N], and where the cells tell that it passes, (m, 3) [m].
        both: whether the posture stands on both feet, (m,) bool.
        torque_limits: of the joints' motors, (n_joints,) [Nm].
    """
    rotations, positions = frames
    axes = joint_axes(tree, base, rotations)
    pivots = joint_pivots(tree, base, rotations, positions)
    moved = moved_frames(tree, base)
    links = np.array(tree.frame_of_link)
    mass = standard[:, 0]
    places = positions[:, links] * mass[:, None] + (rotations[:, links] @ standard[:, 1:, None])[..., 0]
    carried = moved[:, links].astype(float)
    heavy = carried @ mass
    moment = np.einsum("jl,mlk->mjk", carried, places) - heavy[:, None] * pivots
    g = weight / mass.sum()
    torque = g * (-moment[..., 1] * axes[..., 0] + moment[..., 0] * axes[..., 1])
    # What the ground does to the swing foot acts on every joint between it and the base.
    between = moved[:, swing_frame]
    down, place = swing_load
    arm = (place[:, None] - pivots) * between[:, None]
    torque = torque + _about(axes, arm, [0.0, 0.0, 1.0]) * down[:, None]
    unknown = np.stack(
        [
            _about(axes, arm, [1.0, 0.0, 0.0]),
            _about(axes, arm, [0.0, 1.0, 0.0]),
            axes[..., 2] * between,
        ],
        axis=-1,
    )
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


def joint_pivots(tree: Tree, base: int, rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """A point on every joint's axis, (m, n_joints, 3) [m]."""
    pivots = np.zeros((len(rotations), len(tree.joints), 3))
    for step in walk(tree, base):
        if step.edge.joint >= 0:
            turned = (rotations[:, step.new] @ step.anchor_new[:, None])[..., 0]
            pivots[:, step.edge.joint] = positions[:, step.new] + turned
    return pivots


def _about(axes: np.ndarray, arm: np.ndarray, force: list[float]) -> np.ndarray:
    """Moment of a force at an arm about axes, (m, n_joints)."""
    return (np.cross(arm, np.array(force)) * axes).sum(axis=-1)


def torque_limits(model: mujoco.MjModel) -> np.ndarray:
    """Torque limits of the joints' motors, (n_joints,) [Nm]; alike where one has none."""
    limits = np.ones(len(joint_names(model)))
    for k, name in enumerate(joint_names(model)):
        joint = model.joint(name).id
        for i in range(model.nu):
            if model.actuator_trnid[i, 0] == joint and model.actuator_forcerange[i, 1] > 0:
                limits[k] = model.actuator_forcerange[i, 1]
    return limits
