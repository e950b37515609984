"""Distributions against those of scipy.stats; degrees of freedom in special cases that are known."""

import numpy as np
import pytest
from scipy import stats

from tulip_testbed.identification import distributions as d
from tulip_testbed.identification.degrees_of_freedom import of_f_test, satterthwaite
from tulip_testbed.identification.distributions import f_ppf

P = np.array([1e-12, 0.004, 0.3, 0.5, 0.975, 1 - 1e-9])
X = np.array([-2.0, 0.0, 1e-9, 0.4, 3.0, 80.0, np.inf])
FREEDOM = ((1,), (2.5,), (7,), (400,))
PAIRS = ((1, 1), (3, 12.5), (40, 900))


@pytest.mark.parametrize(
    ("ours", "theirs", "at", "freedoms"),
    [
        (d.t_sf, stats.t.sf, X, (*FREEDOM, (1e6,), (np.inf,))),
        (d.t_ppf, stats.t.ppf, P, (*FREEDOM, (1e6,), (np.inf,))),
        (d.chi2_sf, stats.chi2.sf, X, (*FREEDOM, (0,))),
        (d.chi2_isf, stats.chi2.isf, P, FREEDOM),
        (d.chi2_ppf, stats.chi2.ppf, P, FREEDOM),
        (d.f_sf, stats.f.sf, X, (*PAIRS, (0, 3), (2, 0))),
        (d.f_ppf, stats.f.ppf, P, PAIRS),
        (d.normal_sf, stats.norm.sf, X, ((),)),
        (d.normal_logcdf, stats.norm.logcdf, X, ((),)),
        (np.vectorize(d.normal_isf), stats.norm.isf, P, ((),)),
    ],
)
def test_the_values_are_scipys(ours, theirs, at, freedoms):
    for freedom in freedoms:
        assert np.array_equal(ours(at, *freedom), theirs(at, *freedom), equal_nan=True), freedom


def test_one_scale_with_known_degrees_of_freedom_gives_them_back():
    # v = s^2 c with s^2 ~ chi-square of 12: the variance of ln s is 1 / (2 * 12).
    covariance = np.diag([1.0, 4.0, 9.0])
    uncertainty = np.array([[1 / 24]])
    each = satterthwaite(np.diag(covariance), 2 * np.diag(covariance)[None], uncertainty, 1000)
    assert each == pytest.approx(12)
    assert of_f_test(covariance, 2 * covariance[None], uncertainty, 1000) == pytest.approx(12)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turned = turn @ covariance @ turn.T
    assert of_f_test(turned, 2 * turned[None], uncertainty, 1000) == pytest.approx(12)
    assert of_f_test(covariance, 2 * covariance[None], uncertainty, 10) == 10
    assert of_f_test(covariance, 0 * covariance[None], uncertainty, 70) == 70


def test_welch_s_approximation():
    # The difference of two means with unknown variances: Welch (1947).
    variances, counts = np.array([3.0, 1.0]), np.array([5, 9])
    parts = variances / counts
    uncertainty = np.diag(1 / (2 * (counts - 1)))
    expected = parts.sum() ** 2 / (parts**2 / (counts - 1)).sum()
    assert satterthwaite(parts.sum()[None], 2 * parts[:, None], uncertainty, 1e6) == pytest.approx(expected)


def test_the_f_test_keeps_its_level_where_few_groups_tell_a_variance():
    """Two blocks of parameters, each with a variance of its own known with 6 and 20 degrees of freedom."""
    rng = np.random.default_rng(5)
    freedom, blocks = np.array([6, 20]), np.repeat([0, 1], 3)
    hits, runs = 0, 20_000
    for _ in range(runs):
        estimated = rng.chisquare(freedom) / freedom
        covariance = np.diag(estimated[blocks])
        slopes = np.stack([np.diag(2 * estimated[blocks] * (blocks == k)) for k in (0, 1)])
        dof = of_f_test(covariance, slopes, np.diag(1 / (2 * freedom)), 1e6)
        error = rng.standard_normal(6)
        hits += error @ np.linalg.solve(covariance, error) / 6 > f_ppf(0.95, 6, dof)
    assert hits / runs == pytest.approx(0.05, abs=0.01)


def test_scales_that_are_hardly_known_leave_one_degree_of_freedom():
    # Every axis has two degrees of freedom: the F test has no mean (Fai and Cornelius 1996).
    covariance = np.diag([1.0, 2.0])
    assert of_f_test(covariance, 2 * covariance[None], np.array([[1 / 4]]), 275) == 1
