"""The wrench that a moving robot needs: against MuJoCo's inverse dynamics and against rates of momentum."""

import dataclasses

import numpy as np
import pytest

from tests.moving_robots import GRAVITY, by_inverse_dynamics, moving, random_robot
from tulip_testbed.identification.inertial_wrench import needed_wrench
from tulip_testbed.identification.nominal import nominal_robot


@pytest.mark.parametrize("which", ["tulip", "humanoid"])
def test_it_is_what_inverse_dynamics_need(which, robot, foreign):
    rng = np.random.default_rng(210)
    for _ in range(3):
        one = random_robot(robot if which == "tulip" else foreign[which], rng)
        nominal, m = nominal_robot(one), moving(one, rng)
        found = needed_wrench(nominal, m)
        assert m.joint_rates is not None
        assert m.joint_accelerations is not None
        for row, support in enumerate(m.support):
            side = int(support == "left")
            foot = (one.stance_foot, one.swing_foot)[side]
            motion = m.joint_angles[row], m.joint_rates[row], m.joint_accelerations[row]
            expected, _, _ = by_inverse_dynamics(one, foot, nominal.points[side], *motion)
            assert found[row] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_a_robot_at_rest_is_carried_under_its_centre_of_mass(nominal, robot):
    m = dataclasses.replace(
        moving(robot, np.random.default_rng(211)), joint_rates=None, joint_accelerations=None
    )
    wrench, weight = needed_wrench(nominal, m), nominal.mass * GRAVITY
    assert wrench[:, :3] == pytest.approx(np.tile([0, 0, weight], (len(m), 1)), abs=1e-9)
    point = np.column_stack([-wrench[:, 4], wrench[:, 3]]) / weight
    right = m.support != "left"
    center = nominal.geometry(m.joint_angles[right]).center[:, :2]
    assert point[right] == pytest.approx(center, abs=1e-12)


def test_the_force_is_the_rate_of_the_momentum(nominal, robot):
    """Along a motion the centre of mass accelerates by the force."""
    start = moving(robot, np.random.default_rng(212), 1)
    assert start.joint_rates is not None
    assert start.joint_accelerations is not None
    step = 1e-4
    time = step * np.arange(-2, 3)[:, None]
    angle, rate, faster = start.joint_angles, start.joint_rates, start.joint_accelerations
    m = dataclasses.replace(
        start.take(np.zeros(5, int)),
        joint_angles=angle + time * rate + time**2 / 2 * faster,
        joint_rates=rate + time * faster,
        joint_accelerations=np.repeat(faster, 5, axis=0),
    )
    center = nominal.geometry(m.joint_angles).center
    second = (-center[0] + 16 * center[1] - 30 * center[2] + 16 * center[3] - center[4]) / (12 * step**2)
    expected = nominal.mass * (second + np.array([0, 0, GRAVITY]))
    assert needed_wrench(nominal, m)[2, :3] == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
