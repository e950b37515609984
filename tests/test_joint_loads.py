"""Loads of joints in closed legs: against a minimisation of the servos' energy and difference quotients."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.load_rates import load_rates
from tulip_testbed.identification.observation import Observation, observe


@pytest.fixture(scope="module")
def measured(robot, plan):
    few = plan.take(plan.placement <= 2)
    return Laboratory(robot, "force-plate").run(few, seed=3, engine="statics").measurements


@pytest.fixture(scope="module")
def observed(measured, nominal) -> Observation:
    return observe(measured, nominal)


def loads(measurements, nominal, gains):
    return observe(dataclasses.replace(measurements, gains=gains), nominal)


def test_stated_gains_decide_how_the_legs_share_their_forces(measured, nominal, observed):
    plain = observed
    soft = {"right_knee": 300.0, "left_hip_roll": 900.0}
    stated = loads(measured, nominal, soft)
    names = list(measured.joints)
    assert stated.servo_stiffness[names.index("right_knee")] == 300
    other = names.index("left_knee")
    assert stated.servo_stiffness[other] == plain.servo_stiffness[other]
    for row in range(len(measured)):
        levers = stated.loads.levers[row]
        rest = stated.torques[row] - levers @ stated.loads.internal_wrench[row]

        def energy(wrench, rest=rest, levers=levers):
            return ((rest + levers @ wrench) ** 2 / stated.servo_stiffness).sum()

        found = minimize(energy, np.zeros(3), method="BFGS", options={"gtol": 1e-10})
        assert stated.loads.internal_wrench[row] == pytest.approx(found.x, abs=1e-3)
    assert np.abs(stated.loads.internal_wrench - plain.loads.internal_wrench).max() > 1


def test_gains_in_proportion_to_the_torque_limits_change_nothing(measured, nominal, observed):
    plain = observed
    same = dict(zip(measured.joints, plain.servo_stiffness.tolist(), strict=True))
    again = loads(measured, nominal, same)
    assert again.torques == pytest.approx(plain.torques, abs=1e-9)
    twice = loads(measured, nominal, {name: 2 * gain for name, gain in same.items()})
    assert twice.torques == pytest.approx(plain.torques, abs=1e-9)
    assert twice.loads.stiffness == pytest.approx(2 * plain.loads.stiffness)


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
