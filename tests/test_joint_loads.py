"""Loads of joints in closed legs, held against a minimisation of the servos' energy."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe


@pytest.fixture(scope="module")
def measured(robot, plan):
    few = plan.take(plan.placement <= 2)
    return Laboratory(robot, "force-plate").run(few, seed=3, engine="statics").measurements


def loads(measurements, robot, gains):
    return observe(dataclasses.replace(measurements, gains=gains), nominal_robot(robot))


def test_stated_gains_decide_how_the_legs_share_their_forces(measured, robot):
    plain = loads(measured, robot, {})
    soft = {"right_knee": 300.0, "left_hip_roll": 900.0}
    stated = loads(measured, robot, soft)
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


def test_gains_in_proportion_to_the_torque_limits_change_nothing(measured, robot):
    plain = loads(measured, robot, {})
    same = dict(zip(measured.joints, plain.servo_stiffness.tolist(), strict=True))
    again = loads(measured, robot, same)
    assert again.torques == pytest.approx(plain.torques, abs=1e-9)
    twice = loads(measured, robot, {name: 2 * gain for name, gain in same.items()})
    assert twice.torques == pytest.approx(plain.torques, abs=1e-9)
    assert twice.loads.stiffness == pytest.approx(2 * plain.loads.stiffness)
