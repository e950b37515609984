"""Postures that cannot tell parameters apart: which, said by name, with and without noise."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.edited_rows import changed, put
from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.rank import (
    describe_combinations,
    require_identifiable,
    undetermined_directions,
)
from tulip_testbed.identification.regressor import encoder_blur, stacked_regressor

ENCODER = 4e-4  # rad


def judged(parameters, angles, sd=ENCODER):
    """The message on postures (m, n_joints), or ""."""
    matrix = stacked_regressor(parameters, angles)
    try:
        require_identifiable(matrix, parameters.names, "data", encoder_blur(parameters, angles, sd))
    except InputError as error:
        return str(error)
    return ""


def frozen(plan, joint, noise=0.0, seed=0):
    """The plan's angles with a joint at rest, as encoders see them."""
    angles, k = plan.joint_angles.copy(), plan.joints.index(joint)
    angles[:, k] = angles[:, k].mean()
    return angles + noise * np.random.default_rng(seed).standard_normal(angles.shape)


def test_the_shipped_plan_tells_all_apart_with_much_to_spare(parameters, plan):
    assert judged(parameters, plan.joint_angles) == ""
    assert judged(parameters, plan.joint_angles, sd=10 * ENCODER) == ""


@pytest.mark.parametrize("noise", [0.0, ENCODER])
def test_an_ankle_that_never_moved(parameters, plan, noise):
    """Foot and ankle turn as one; the ankle's z column is a multiple of its y column."""
    message = judged(parameters, frozen(plan, "right_ankle_roll", noise, 110))
    assert message.startswith("data: the postures determine 23 of 25 parameters; ")
    expected = "right_hip.y, right_foot.y and right_ankle.z are not determined separately (free: "
    assert expected in message
    assert "right_foot.y - right_hip.y" in message
    assert "left" not in message


@pytest.mark.parametrize("joint", range(12))
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_every_joint_at_rest_is_found_at_every_noise(parameters, plan, joint, noise):
    """The simple test, full numerical rank, passes with noise: that is why there is another."""
    angles = frozen(plan, plan.joints[joint], noise, 112)
    matrix = stacked_regressor(parameters, angles)
    deficient = np.linalg.matrix_rank(matrix) < 25
    assert deficient == (noise == 0)
    assert "not determined separately" in judged(parameters, angles, max(noise, ENCODER / 100))


@pytest.mark.slow
def test_cad_carries_what_the_postures_do_not_determine(wii, robot):
    measured = wii.measurements
    rng = np.random.default_rng(114)
    noise = ENCODER * rng.standard_normal(len(measured))
    still = changed(measured, joint_angles=put(..., 5, value=noise))
    expected = (
        r"^data: .* right_hip.y \(12\) and right_foot.y \(13\) .*right_ankle.z \(21\) is not determined$"
    )
    with pytest.raises(InputError, match=expected):
        identify(still, robot, "data", estimator=MIXED_MODEL)
    found: Any = identify(still, robot, "data").full
    cad = nominal_robot(robot)
    assert found.data_share[20] < 0.1
    assert abs(found.value[20] - cad.value[20]) < 1e-3
    # The torso is known more by the data than by CAD in all directions.
    assert found.data_share[[0, 9, 16]].min() > 0.5
    # What the moving joints show is as it was.
    whole = wii.identification.full
    both = np.hypot(found.standard_error, whole.standard_error)
    assert np.abs((found.value - whole.value) / both)[[1, 4, 7]].max() < 3


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), columns=st.integers(2, 12), data=st.data())
def test_a_planted_null_space_is_found_whatever_the_scale_and_order(seed, columns, data):
    free = data.draw(st.integers(0, columns - 1))
    rng = np.random.default_rng(seed)
    null = np.linalg.qr(rng.standard_normal((columns, columns)))[0][:, :free].T
    matrix = rng.standard_normal((40, columns))
    matrix = matrix - matrix @ null.T @ null
    scale = 10.0 ** rng.integers(-3, 4, columns)
    found = undetermined_directions(rng.permutation(matrix * scale))
    assert found.shape == (free, columns)
    if free:
        first, second = (np.linalg.qr(basis.T)[0] for basis in (found * scale, null))
        assert np.abs(first @ first.T - second @ second.T).max() < 1e-8


def test_of_a_long_combination_the_largest_terms_are_named():
    text = describe_combinations(np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 1.0]]), tuple("abcdef"))
    assert (
        text == "a, b, c, d, e and f are not determined separately "
        "(free: f + 0.5 e + 0.4 d + 0.3 c and 2 smaller terms)"
    )
