"""Random postures on the stance foot alone, and the torques that hold them."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.postures import planning_ranges
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot, joint_names, joint_ranges

AT_ONCE = 50_000
MOST_ROUNDS = 400
MARGIN = 0.02  # m, of the CoM's projection inside the sole
MOST_TORQUE = 0.8  # of the drives' limits: what tracking errors and sag may still need
LIFTED = 0.01  # m, of the swing sole's lowest corner over the floor


def one_foot_postures(robot: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Joint angles, (count, n_joints) [rad], drawn uniformly within the joints' ranges and kept if feasible.

    Feasible: CoM over the stance sole with a margin, torso and its height within the planning
    ranges, swing foot lifted and to its own side, static torques within 80 % of the drives' limits.
    Collisions of links other than that are not looked at.

    Raises:
        InputError: hardly any draw is feasible.
    """
    model, nominal = robot.model, nominal_robot(robot)
    value = base_parameters(robot, support="right").values(standard_parameters(model))
    regressor = base_parameters(robot, support="right").regressor
    low, high = joint_ranges(model).T
    kept: list[np.ndarray] = []
    for _ in range(MOST_ROUNDS):
        angles = rng.uniform(low, high, (AT_ONCE, len(low)))
        com = regressor(angles) @ value
        sole = nominal.soles[0]
        inside = (com > sole.min(axis=0) + MARGIN) & (com < sole.max(axis=0) - MARGIN)
        angles, com = angles[inside.all(axis=1)], com[inside.all(axis=1)]
        fits = _stands_well(robot, nominal, angles)
        limits = _torque_limits(model)
        kept += [
            q
            for q, point in zip(angles[fits], com[fits], strict=True)
            if (np.abs(holding_torques(robot, model, q, point)) <= MOST_TORQUE * limits).all()
        ]
        if len(kept) >= count:
            return np.array(kept[:count])
    raise InputError(
        f"found {len(kept)} postures on one foot in {MOST_ROUNDS * AT_ONCE} draws, expected {count}"
    )


def holding_torques(robot: Robot, model: mujoco.MjModel, angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Torques that hold the robot on its stance foot, (n_joints,) [N m].

    Args:
        point: centre of pressure, (2,) [m]; below the centre of mass.
    """
    data = mujoco.MjData(model)
    chain = ClosedChain(model, robot)
    data.qpos[:7], data.qpos[chain.qpos] = chain.base_pose(angles), angles
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, np.append(point, 0.0), model.body(robot.stance_foot).id)
    weight = -model.opt.gravity * model.body_subtreemass[0]
    return (data.qfrc_bias - jacobian.T @ weight)[chain.dofs]


def _stands_well(robot: Robot, nominal: Nominal, angles: np.ndarray) -> np.ndarray:
    """Whether torso and swing foot are where they may be, (m,)."""
    ranges, tree, base = planning_ranges(robot), nominal.parameters.tree, nominal.parameters.base
    rotations = link_rotations(tree, base, angles)
    positions = frame_positions(tree, base, rotations, -nominal.points[0])
    torso = rotations[:, 0]
    roll = np.arctan2(torso[:, 2, 1], torso[:, 2, 2])
    pitch = -np.arcsin(np.clip(torso[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(torso[:, 1, 0], torso[:, 0, 0])
    foot, place = rotations[:, nominal.swing_frame], positions[:, nominal.swing_frame]
    corners = np.column_stack([nominal.soles[1], np.full(4, nominal.points[1][2])])
    height = place[:, 2, None] + np.einsum("mb,cb->mc", foot[:, 2], corners)
    side = place[:, 1] + foot[:, 1] @ nominal.points[1]
    within = [
        _inside(roll, ranges.torso_roll),
        _inside(pitch, ranges.torso_pitch),
        _inside(yaw, ranges.torso_yaw),
        positions[:, 0, 2] >= ranges.least_height,
        height.min(axis=1) >= LIFTED,
        side >= ranges.swing_y[0],
    ]
    return np.all(within, axis=0)


def _inside(value: np.ndarray, interval: tuple[float, float]) -> np.ndarray:
    return (value >= interval[0]) & (value <= interval[1])


def _torque_limits(model: mujoco.MjModel) -> np.ndarray:
    """Of the joints in the order of their angles, (n_joints,) [N m]."""
    of_joint = {int(joint): k for k, joint in enumerate(model.actuator_trnid[:, 0])}
    return np.array([model.actuator_forcerange[of_joint[model.joint(n).id], 1] for n in joint_names(model)])
