"""Derivatives of the loads against difference quotients."""

import dataclasses

import numpy as np
import pytest

from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.load_rates import load_rates
from tulip_testbed.identification.observation import Observation, observe


@pytest.fixture(scope="module")
def observed(robot, plan, nominal) -> Observation:
    few = plan.take(plan.placement <= 3)
    return observe(Laboratory(robot, "wii").run(few, seed=4, engine="statics").measurements, nominal)


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
