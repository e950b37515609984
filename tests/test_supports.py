"""Centre of mass and of pressure by support: eq. 11 by hand, and rows on either foot."""

import dataclasses

import mujoco
import numpy as np
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import base_parameters, common_support, standard_parameters
from tulip_testbed.identification.center_of_pressure import (
    cell_positions,
    center_of_pressure,
    load_shares,
    total_mass,
)
from tulip_testbed.identification.nominal import PostureGeometry, jacobian, nominal_robot
from tulip_testbed.sim.robot import joint_names, sole_point


@pytest.fixture
def measured(wii):
    return wii.measurements


def test_all_weight_on_one_cell_is_at_that_cell(measured):
    forces = np.zeros((len(measured), 8))
    forces[:, 5] = 100.0  # left plate, front right
    poses = np.zeros((len(measured), 2, 3))
    poses[:, 1] = [0.3, 0.2, np.pi / 2]
    moved = dataclasses.replace(measured, cell_forces=forces, plate_poses=poses)
    # (0.2165, -0.119) turned by 90 degrees is (0.119, 0.2165)
    assert center_of_pressure(moved) == pytest.approx(np.tile([0.419, 0.4165], (len(measured), 1)))
    assert load_shares(moved)[0].tolist() == [0.0, 1.0]
    assert total_mass(moved) == pytest.approx((100 / 9.81, 0.0), abs=1e-12)


def test_equal_cells_give_the_mean_of_the_cells(measured):
    even = dataclasses.replace(measured, cell_forces=np.full((len(measured), 8), 25.0))
    assert center_of_pressure(even) == pytest.approx(cell_positions(even).mean(axis=1))


SUPPORT = np.array(["double", "right", "left"] * 4)


@pytest.fixture(scope="module")
def angles(plan):
    rng = np.random.default_rng(5)
    return plan.joint_angles[: len(SUPPORT)] + 0.2 * rng.standard_normal((len(SUPPORT), 12))


def center_by_mujoco(robot, angles, foot):
    """The centre of mass in the frame of a foot, from MuJoCo's own kinematics, (3,) [m]."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[[model.joint(name).qposadr[0] for name in joint_names(model)]] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    body = data.body(foot)
    return body.xmat.reshape(3, 3).T @ (data.subtree_com[1] - body.xpos) - sole_point(model, foot)


def test_no_weight_is_refused(measured):
    empty = dataclasses.replace(measured, cell_forces=np.zeros((len(measured), 8)))
    with pytest.raises(InputError, match=r"row 1: cells sum to 0\.00 N"):
        center_of_pressure(empty)


@pytest.mark.parametrize(("support", "count"), [("mixed", 27), ("double-left", 26)])
def test_the_centre_of_mass_in_the_frame_of_the_foot_that_carries(support, count, robot, angles):
    nominal = nominal_robot(robot, support)
    assert len(nominal.value) == count
    rows = SUPPORT == "left" if support == "double-left" else np.full(len(SUPPORT), True)
    found = nominal.center_of_mass(angles, SUPPORT)
    for k in np.flatnonzero(rows):
        foot = robot.swing_foot if SUPPORT[k] == "left" else robot.stance_foot
        np.testing.assert_allclose(found[k], center_by_mujoco(robot, angles[k], foot)[:2], atol=1e-12)


def test_the_25_of_double_support_are_among_the_27_with_the_same_values(robot):
    standard = standard_parameters(robot.model)
    sets = [base_parameters(robot, support=support) for support in ("double", "mixed")]
    both, mixed = (dict(zip(one.names, one.values(standard), strict=True)) for one in sets)
    assert set(mixed) - set(both) == {"right_foot.z", "left_foot.z"}
    for name, value in both.items():
        assert mixed[name] == pytest.approx(value, abs=1e-15)


def test_slopes_are_those_of_finite_differences(robot, angles):
    nominal = nominal_robot(robot, "mixed")
    geometry = PostureGeometry(
        nominal, nominal.parameters.tree, angles, SUPPORT, standard_parameters(robot.model)
    )
    by_angle = geometry.slope_along(nominal.value) + geometry.stance_sole_slope[:, :2]
    assert geometry.slope_along(nominal.value) == pytest.approx(geometry.slope @ nominal.value, abs=1e-14)
    expected = jacobian(lambda q: nominal.center_of_mass(q, SUPPORT), angles)
    np.testing.assert_allclose(by_angle, expected, atol=1e-8)
    np.testing.assert_allclose(geometry.center[:, :2], nominal.center_of_mass(angles, SUPPORT), atol=1e-12)


def test_the_other_sole_in_the_frame_of_the_foot_that_carries(robot, angles):
    nominal = nominal_robot(robot, "mixed")
    found = nominal.other_sole(angles, SUPPORT)
    model, data = robot.model, mujoco.MjData(robot.model)
    for k, support in enumerate(SUPPORT):
        data.qpos[[model.joint(name).qposadr[0] for name in joint_names(model)]] = angles[k]
        mujoco.mj_kinematics(model, data)
        base, other = robot.feet[::-1] if support == "left" else robot.feet
        turn = data.body(base).xmat.reshape(3, 3)
        place = data.body(other).xpos + data.body(other).xmat.reshape(3, 3) @ sole_point(model, other)
        expected = turn.T @ (place - data.body(base).xpos) - sole_point(model, base)
        np.testing.assert_allclose(found[k, :2], expected[:2], atol=1e-12)


def test_the_common_support():
    for rows, expected in (
        (["double", "right"], "right"),
        (["double", "left"], "double-left"),
        (["right", "left"], "mixed"),
        (["double"], "double"),
    ):
        assert common_support(np.array(rows)) == expected
