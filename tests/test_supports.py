"""Centre of mass and of pressure, wrenches and torques by support, against MuJoCo and by hand."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.moving_robots import by_inverse_dynamics, moving, random_robot
from tests.test_refusals import refuse
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.inertial_wrench import needed_wrench
from tulip_testbed.identification.load_rates import load_rates
from tulip_testbed.identification.nominal import PostureGeometry, jacobian, nominal_robot
from tulip_testbed.identification.observation import Observation, observe

SUPPORT = np.array(["double", "right", "left"] * 4)


@pytest.fixture(scope="module")
def angles(plan):
    rng = np.random.default_rng(5)
    return plan.joint_angles[: len(SUPPORT)] + 0.2 * rng.standard_normal((len(SUPPORT), 12))


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


@pytest.fixture(scope="module")
def measured_of_joint(robot, plan):
    few = plan.take(plan.placement <= 2)
    return Laboratory(robot, "force-plate").run(few, seed=3, engine="statics").measurements


@pytest.fixture(scope="module")
def observed(measured_of_joint, nominal) -> Observation:
    return observe(measured_of_joint, nominal)


def loads(measurements, nominal, gains):
    return observe(dataclasses.replace(measurements, gains=gains), nominal)


def test_stated_gains_decide_how_the_legs_share_their_forces(measured_of_joint, nominal, observed):
    plain = observed
    soft = {"right_knee": 300.0, "left_hip_roll": 900.0}
    stated = loads(measured_of_joint, nominal, soft)
    names = list(measured_of_joint.joints)
    assert stated.servo_stiffness[names.index("right_knee")] == 300
    other = names.index("left_knee")
    assert stated.servo_stiffness[other] == plain.servo_stiffness[other]
    for row in range(len(measured_of_joint)):
        levers = stated.loads.levers[row]
        rest = stated.torques[row] - levers @ stated.loads.internal_wrench[row]

        def energy(wrench, rest=rest, levers=levers):
            return ((rest + levers @ wrench) ** 2 / stated.servo_stiffness).sum()

        found = minimize(energy, np.zeros(3), method="BFGS", options={"gtol": 1e-10})
        assert stated.loads.internal_wrench[row] == pytest.approx(found.x, abs=1e-3)
    assert np.abs(stated.loads.internal_wrench - plain.loads.internal_wrench).max() > 1


def moved(observed: Observation, reading: int, step: float) -> Observation:
    change = step * np.eye(14)[reading]
    return observed.changed(
        cell_forces=observed.cell_forces + change[:8],
        plate_poses=observed.plate_poses + change[8:].reshape(2, 3),
    )


def test_loads_by_cells_and_plates(observed):
    torques, soles = load_rates(observed)
    for reading in range(14):
        step = 1e-2 if reading < 8 else 1e-5
        ends = [moved(observed, reading, sign * step) for sign in (1, -1)]
        by_torque = (ends[0].torques - ends[1].torques) / (2 * step)
        by_sole = (ends[0].sole_loads - ends[1].sole_loads) / (2 * step)
        assert torques[..., reading] == pytest.approx(by_torque, abs=1e-6 * np.abs(by_torque).max() + 1e-9)
        assert soles[..., reading] == pytest.approx(by_sole, abs=1e-6 * np.abs(by_sole).max() + 1e-9)


def test_a_softer_joint_takes_load_off(observed):
    """The closed legs share the load by the servos' stiffness: the derivative by one compliance."""
    for joint in (0, 3, 8):
        ends = []
        for sign in (1, -1):
            softer = 1 / observed.servo_stiffness
            softer[joint] += sign * 1e-6
            ends.append(dataclasses.replace(observed, servo_stiffness=1 / softer).torques)
        expected = -observed.loads.sharing[..., joint] * observed.torques[:, [joint]]
        assert expected == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-4 * np.abs(expected).max())


def test_no_weight_is_refused(wii):
    empty = dataclasses.replace(wii.measurements, cell_forces=np.zeros((len(wii.measurements), 8)))
    refuse("row 1: cells sum to 0.00 N", center_of_pressure, empty)
