"""The least-squares core against certified values, and the standard errors against repetition."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.estimators import least_squares, solve_least_squares
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.statistics import (
    correlations,
    high_correlations,
    relative_standard_errors,
    residual_norms,
    standard_errors,
)

# NIST StRD Longley: estimate and standard deviation of b0 to b6, residual s.d.
LONGLEY = [
    (-3482258.63459582, 890420.383607373),
    (15.0618722713733, 84.9149257747669),
    (-0.358191792925910e-01, 0.334910077722432e-01),
    (-2.02022980381683, 0.488399681651699),
    (-1.03322686717359, 0.214274163161675),
    (-0.511041056535807e-01, 0.226073200069370),
    (1829.15146461355, 455.478499142212),
]
LONGLEY_SIGMA = 304.854073561965


def test_longley_certified_values():
    with (Path(__file__).parent / "data" / "longley.csv").open() as file:
        table = np.array([[float(v) for v in row.values()] for row in csv.DictReader(file)])
    output = table[:, 0]
    matrix = np.column_stack([np.ones(len(table)), table[:, 1:]])
    value, c = solve_least_squares(matrix, output)
    residual = output - matrix @ value
    sigma = np.sqrt(residual @ residual / (16 - 7))
    for k, (certified, deviation) in enumerate(LONGLEY):
        assert value[k] == pytest.approx(certified, rel=1e-8)
        assert sigma * np.sqrt(c[k, k]) == pytest.approx(deviation, rel=1e-8)
    assert sigma == pytest.approx(LONGLEY_SIGMA, rel=1e-8)


def test_rank_deficiency_names_the_parameters():
    matrix = np.random.default_rng(0).standard_normal((20, 4))
    matrix[:, 3] = 2 * matrix[:, 1]
    with pytest.raises(InputError, match=r"2 and 4 are not determined separately \(free: 4 - 2 2\)"):
        solve_least_squares(matrix, np.ones(20))


@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), columns=st.integers(1, 6))
def test_residual_is_orthogonal_and_scaling_is_undone(seed, columns):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((30, columns)) * 10.0 ** rng.integers(-4, 5, columns)
    output = rng.standard_normal(30)
    value, c = solve_least_squares(matrix, output)
    residual = output - matrix @ value
    assert np.abs((matrix / np.linalg.norm(matrix, axis=0)).T @ residual).max() < 1e-12
    scale = np.linalg.norm(matrix, axis=0)
    assert c * np.outer(scale, scale) == pytest.approx(
        np.linalg.inv((matrix / scale).T @ (matrix / scale)), rel=1e-9
    )


def synthetic(rng, placements=30, per=5, columns=8):
    """A design with load shares, as the plates would give."""
    rows = placements * per
    matrix = rng.standard_normal((2 * rows, columns))
    placement = np.repeat(np.arange(placements), per)
    left = rng.uniform(0.2, 0.8, rows)
    share = np.column_stack([1 - left, left])
    return matrix, placement, share


def repeat(seed, placement_sd, runs=150):
    rng = np.random.default_rng(seed)
    matrix, placement, share = synthetic(rng)
    # Columns that are nearly constant within a placement suffer most from its error.
    matrix[:, :4] = np.repeat(rng.standard_normal((30, 2, 4)), 5, axis=0).reshape(-1, 4)
    values, plain, clustered = [], [], []
    for _ in range(runs):
        error = placement_sd * rng.standard_normal((30, 2))[placement] * share[:, 1:]
        output = (error + rng.standard_normal((150, 2))).ravel()
        data = Regression(matrix, output, np.arange(1, 9), tuple("abcdefgh"), placement, share)
        estimate = least_squares(data)
        values.append(estimate.value)
        plain.append(standard_errors(estimate.covariance))
        clustered.append(standard_errors(estimate.clustered_covariance))
    spread = np.std(values, axis=0)
    return np.mean(plain, axis=0) / spread, np.mean(clustered, axis=0) / spread


def test_clustered_standard_errors_are_calibrated_where_eq_14_is_not():
    """150 repetitions: a ratio's own s.d. is 0.058; bounds at 3.5 s.d. over 8 ratios (0.4 %)."""
    plain, clustered = repeat(seed=5, placement_sd=3.0)
    assert plain[:4].max() < 0.75  # eq. 14 is far too optimistic here
    assert np.abs(clustered - 1).max() < 0.20


@pytest.mark.parametrize("placement_sd", [0.01, 1.0, 100.0])
def test_placement_errors_are_estimated_over_four_decades(placement_sd):
    """Right plate exact, left plate off; 60 errors make an s.d. known to 9 %: bounds at 4 s.d."""
    rng = np.random.default_rng(7)
    matrix, placement, share = synthetic(rng)
    error = placement_sd * rng.standard_normal((30, 2))[placement] * share[:, 1:]
    output = (error + 0.05 * rng.standard_normal((150, 2))).ravel()
    estimate = least_squares(Regression(matrix, output, np.arange(1, 9), tuple("abcdefgh"), placement, share))
    if placement_sd > 0.05:
        assert estimate.placement_sd[1] == pytest.approx(placement_sd, rel=0.36)
    assert estimate.placement_sd[0] < 0.2 * max(placement_sd, 0.2)


@pytest.mark.slow
def test_without_placement_errors_clustering_costs_nothing():
    plain, clustered = repeat(seed=6, placement_sd=0.0)
    assert np.abs(plain - 1).max() < 0.20
    assert np.abs(clustered - 1).max() < 0.20


def test_statistics_by_hand():
    covariance = np.array([[4.0, -3.0], [-3.0, 9.0]])
    assert standard_errors(covariance).tolist() == [2.0, 3.0]
    assert correlations(covariance)[0, 1] == pytest.approx(-0.5)
    assert relative_standard_errors(np.array([-8.0, 1.0]), np.array([2.0, 3.0])).tolist() == [25.0, 300.0]
    assert high_correlations(covariance, np.array([12, 13]), 0.4) == [(12, 13, pytest.approx(-0.5))]
    assert high_correlations(covariance, np.array([12, 13]), 0.6) == []
    norms = residual_norms(np.array([3.0, 4.0, 0.0, 1.0]))
    assert (norms.mean, norms.max) == (3.0, 5.0)
    assert norms.sd == pytest.approx(np.sqrt(8))


def test_simplified_model_refuses_unknown_numbers():
    data = Regression(
        np.eye(4), np.ones(4), np.arange(1, 5), tuple("abcd"), np.zeros(2), np.full((2, 2), 0.5)
    )
    assert data.keep([1, 3]).names == ("a", "c")
    with pytest.raises(InputError, match="unknown parameter numbers 9; valid: 1 to 4"):
        data.keep([1, 9])
