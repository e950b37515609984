"""Our closed-form kinematics against MuJoCo's."""

import dataclasses

import mujoco
import numpy as np
import pytest

from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, tree_of
from tulip_testbed.sim.robot import sole_point


def random_angles(tree, count, seed):
    low, high = tree.joint_range.T
    return np.random.default_rng(seed).uniform(low, high, (count, len(tree.joints)))


def in_base(robot, model, data, support):
    foot = robot.stance_foot if support != "left" else robot.swing_foot
    rotation = data.body(foot).xmat.reshape(3, 3)
    return foot, rotation, data.body(foot).xpos + rotation @ sole_point(model, foot)


@pytest.mark.parametrize("support", ["right", "left"])
def test_frames_and_com_agree_with_mujoco(robot, model, support):
    parameters = base_parameters(robot, support=support)
    theta, tree = parameters.values(standard_parameters(model)), parameters.tree
    data = mujoco.MjData(model)
    angles = random_angles(tree, 20, 1)
    rotations = link_rotations(tree, parameters.base, angles)
    for k, q in enumerate(angles):
        data.qpos[7:] = q
        mujoco.mj_forward(model, data)
        foot, base, origin = in_base(robot, model, data, support)
        positions = frame_positions(tree, parameters.base, rotations[k : k + 1], -sole_point(model, foot))[0]
        for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
            expected = base.T @ data.body(link).xmat.reshape(3, 3)
            assert rotations[k, frame] == pytest.approx(expected, abs=1e-13)
            assert positions[frame] == pytest.approx(base.T @ (data.body(link).xpos - origin), abs=1e-13)
        com = base.T @ (data.subtree_com[1] - origin)
        assert parameters.regressor(q[None])[0] @ theta == pytest.approx(com[:2], abs=1e-13)


def test_regressor_derivative_agrees_with_mujocos_jacobian(robot, model):
    """Finite differences of H theta against mj_jacSubtreeCom in the base frame."""
    parameters = base_parameters(robot, support="right")
    theta = parameters.values(standard_parameters(model))
    q, step = random_angles(parameters.tree, 1, 2)[0], 1e-6
    shifted = q + step * np.vstack([np.eye(12), -np.eye(12)])
    com = parameters.regressor(shifted) @ theta
    numeric = (com[:12] - com[12:]).T / (2 * step)
    data = mujoco.MjData(model)
    data.qpos[7:] = q
    mujoco.mj_forward(model, data)
    foot, base, origin = in_base(robot, model, data, "right")
    of_com, linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSubtreeCom(model, data, of_com, 1)
    mujoco.mj_jac(model, data, linear, angular, origin, model.body(foot).id)
    arm = data.subtree_com[1] - origin
    relative = of_com - linear + np.cross(arm, angular, axisa=0, axisb=0, axisc=0)
    assert numeric == pytest.approx((base.T @ relative)[:2, 6:], abs=1e-8)


def test_lengths_leave_the_turns_of_a_tree(robot):
    tree = tree_of(robot.model)
    edges = tuple(dataclasses.replace(edge, anchor=2 * edge.anchor) for edge in tree.edges)
    longer, anew = tree.with_lengths(edges), dataclasses.replace(tree, edges=edges)
    assert longer.turns is tree.turns
    for one, other in zip(longer.turns, anew.turns, strict=True):
        np.testing.assert_array_equal(one, other)
