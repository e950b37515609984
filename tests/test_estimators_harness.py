"""Every estimator by one harness: exact data, symmetries, bad input, calibration."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binom
from scipy.stats import t as t_distribution

from tests.synthetic import WII
from tests.test_refusals import refuse
from tulip_testbed.identification import distributions as d
from tulip_testbed.identification.distributions import f_ppf
from tulip_testbed.identification.estimators import ESTIMATORS, MIXED_MODEL, estimate_by
from tulip_testbed.identification.statistics import of_f_test, satterthwaite, standard_errors
from tulip_testbed.measurements import SensorSheet


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("sheet", ["stated", "zero", "unknown"])
def test_exact_data_give_the_truth(bench, name, sheet):
    data = bench.draw(np.random.default_rng(0), 0.0, 0.0, 0.0, 0.0)
    sheets = {
        "stated": SensorSheet(4e-4, 0.0, 1.4, 0.0, (3.5e-3, 3.5e-3, 1e-2)),
        "zero": SensorSheet(0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)),
        "unknown": SensorSheet(),
    }
    found = estimate_by(dataclasses.replace(data, sensors=sheets[sheet]), name)
    assert np.abs(found.value - bench.nominal.value).max() < 1e-9
    assert np.isfinite(found.covariance).all()
    assert (found.interval_dof > 0).all()


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_order_of_postures_and_the_placements_numbers_do_not_matter(bench, name):
    rng = np.random.default_rng(2)
    data = bench.draw(rng, **WII)
    order = rng.permutation(len(data.placement))
    rows = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
    renumbered = rng.permutation(100)[data.placement]
    mixed = dataclasses.replace(
        data,
        matrix=data.matrix[rows],
        output=data.output[rows],
        placement=renumbered[order],
        load_share=data.load_share[order],
        slope=data.slope[order],
        cells=data.cells[order],
        levers=data.levers[order],
    )
    one, other = estimate_by(data, name), estimate_by(mixed, name)
    assert other.value == pytest.approx(one.value, abs=1e-6)
    assert standard_errors(other.covariance) == pytest.approx(standard_errors(one.covariance), rel=1e-4)
    assert other.residual == pytest.approx(one.residual[rows], abs=1e-6)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_simplified_model_keeps_its_numbers(bench, name):
    data = bench.draw(np.random.default_rng(3), **WII)
    kept = bench.nominal.robot.settings["simplified"]
    found = estimate_by(data.keep(kept), name)
    assert found.numbers.tolist() == kept
    error = found.value - bench.nominal.value[found.numbers - 1]
    assert np.abs(error / standard_errors(found.covariance)).max() < 6


@pytest.mark.slow
@pytest.mark.parametrize("name", ESTIMATORS)
def test_few_placements_and_single_postures_are_no_obstacle(bench, name):
    data = bench.draw(np.random.default_rng(4), **WII)
    for placement in (np.zeros(150, dtype=int), np.arange(150)):
        found = estimate_by(dataclasses.replace(data, placement=placement), name)
        assert np.isfinite(standard_errors(found.covariance)).all()


@pytest.mark.parametrize("name", ESTIMATORS)
def test_what_the_postures_do_not_show_is_refused(bench, name):
    data = bench.draw(np.random.default_rng(6), **WII)
    matrix = data.matrix.copy()
    matrix[:, 12] = matrix[:, 11]
    refuse("not determined", estimate_by, dataclasses.replace(data, matrix=matrix), name)


def calibrated(bench, name, runs, first, clustered=False, **errors):
    """S.d. of the estimates over reported standard errors, share of 95 % intervals that hold, and bias."""
    found = [
        estimate_by(bench.draw(np.random.default_rng([7, first + k]), **errors), name) for k in range(runs)
    ]
    error = np.array([f.value for f in found]) - bench.nominal.value
    reported = np.array(
        [standard_errors(f.clustered_covariance if clustered else f.covariance) for f in found]
    )
    limit = np.array([t_distribution.ppf(0.975, f.interval_dof) for f in found])
    ratio = error.std(axis=0, ddof=1) / np.sqrt((reported**2).mean(axis=0))
    return ratio, (np.abs(error) < limit * reported).mean(axis=0), error.mean(axis=0) / error.std(axis=0)


@pytest.mark.parametrize("sheet", [1.0, *(pytest.param(s, marks=pytest.mark.slow) for s in (2.0, 0.5))])
def test_the_default_is_right_about_its_errors(bench, sheet):
    """60 runs, 25 parameters. A ratio's own s.d. is 9 %, so 4 of them bound all 25 (0.2 % false alarms); mean
    ratio and overall coverage are sharper (parameters correlate: about 8 independent ones)."""
    ratio, held, bias = calibrated(bench, MIXED_MODEL, 60, 0, **WII, sheet=sheet)
    assert np.abs(ratio - 1).max() < 0.36
    assert abs(ratio.mean() - 1) < 0.12
    assert held.min() >= binom.ppf(1e-4, 60, 0.95) / 60
    assert 0.92 < held.mean() < 0.98
    assert np.abs(bias).max() < 4 / np.sqrt(60)


@pytest.mark.slow
def test_eq_14_is_too_optimistic_where_placements_err(bench):
    """Placement errors dominate: some of least squares' standard errors are far too small (1.35: 3.9 s.d.
    of a ratio from 60 runs), and its intervals fail; clustered ones and the default's hold."""
    errors = {"cell": 0.5, "placement": 5e-3, "mark": 2e-3, "encoder": 0.0}
    plain, held, _ = calibrated(bench, "least-squares", 60, 100, **errors)
    assert plain.max() > 1.35
    assert held.min() < 0.85
    _, held, _ = calibrated(bench, "least-squares", 60, 100, clustered=True, **errors)
    assert 0.9 < held.mean() < 0.98
    right, held, _ = calibrated(bench, MIXED_MODEL, 60, 100, **errors)
    assert np.abs(right - 1).max() < 0.36
    assert 0.92 < held.mean() < 0.98


@pytest.mark.slow
def test_encoder_errors_bias_least_squares_and_not_the_corrected(bench):
    """Encoders far worse than the other sensors deserve: the bias in its own Monte Carlo errors."""
    errors = {"cell": 0.1, "placement": 1e-4, "mark": 1e-4, "encoder": 3e-3}
    bias = {
        name: np.abs(calibrated(bench, name, 60, 200, **errors)[2]).max() * np.sqrt(60)
        for name in ("least-squares", "placement", "errors-in-variables", MIXED_MODEL)
    }
    assert bias["least-squares"] > 6
    assert bias["placement"] > 6
    assert bias["errors-in-variables"] < 4
    assert bias[MIXED_MODEL] < 4


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


@pytest.mark.slow
def test_the_f_test_keeps_its_level_where_few_groups_tell_a_variance():
    """Two blocks of parameters, each with a variance of its own known with 6 and 20 degrees of freedom."""
    rng = np.random.default_rng(5)
    freedom, blocks = np.array([6, 20]), np.repeat([0, 1], 3)
    hits, runs = 0, 5_000
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
