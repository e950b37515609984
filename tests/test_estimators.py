"""The estimators against certified values, statsmodels and repetition, and what they know of the robot."""

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from tests.synthetic import WII
from tests.test_refusals import refuse
from tulip_testbed.identification import variance_components
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL, estimate_by, solve_least_squares
from tulip_testbed.identification.estimators.errors_in_variables import bounded_excess
from tulip_testbed.identification.estimators.ordinary import by_qr
from tulip_testbed.identification.estimators.prior import (
    CENTER_SD,
    MASS_SD,
    corner_parameters,
    identifiable_masses,
)
from tulip_testbed.identification.loop_closure import encoder_sd_by_closure
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.identification.statistics import (
    correlations,
    high_correlations,
    relative_standard_errors,
    residual_norms,
    standard_errors,
)
from tulip_testbed.identification.variance_components import fit_components


def test_statistics_by_hand():
    covariance = np.array([[4.0, -3.0], [-3.0, 9.0]])
    assert standard_errors(covariance).tolist() == [2.0, 3.0]
    assert correlations(covariance)[0, 1] == pytest.approx(-0.5)
    assert relative_standard_errors(np.array([-8.0, 1.0]), np.array([2.0, 3.0])).tolist() == [25.0, 300.0]
    assert relative_standard_errors(np.array([5e-324]), np.array([1.0])).tolist() == [np.inf]
    assert high_correlations(covariance, np.array([12, 13]), 0.4) == [(12, 13, pytest.approx(-0.5))]
    assert high_correlations(covariance, np.array([12, 13]), 0.6) == []
    norms = residual_norms(np.array([3.0, 4.0, 0.0, 1.0]))
    assert (norms.mean, norms.max) == (3.0, 5.0)
    assert norms.sd == pytest.approx(np.sqrt(8))


def test_filip_certified_values():
    """Condition number 2e15: the solver keeps seven digits; the check of the rank refuses such data."""
    table, (estimate, sd) = (
        np.loadtxt(Path(__file__).parent / "data" / f"{name}.csv", delimiter=",", skiprows=1).T
        for name in ("filip", "filip_certified")
    )
    matrix, output = np.vander(table[1], 11, increasing=True), table[0]
    value, c = by_qr(matrix, output)
    residual = output - matrix @ value
    deviation = np.sqrt(residual @ residual / (82 - 11) * np.diag(c))
    assert value == pytest.approx(estimate, rel=1e-6)
    assert deviation == pytest.approx(sd, rel=1e-6)
    refuse("not determined", solve_least_squares, matrix, output)


def made(seed, placement_sd=3.0, outliers=0):
    """30 placements of 4 to 6 postures; errors of both plates, then independent ones of s.d. 1."""
    rng = np.random.default_rng(seed)
    placement = np.repeat(np.arange(30), rng.integers(4, 7, 30))
    count = len(placement)
    left = rng.uniform(0.2, 0.8, count)
    share = np.column_stack([1 - left, left])
    plates = placement_sd * np.array([0.5, 1.0])[:, None, None] * rng.standard_normal((2, 30, 2))
    matrix = rng.standard_normal((2 * count, 8))
    output = np.einsum("mp,pma->ma", share, plates[:, placement]) + rng.standard_normal((count, 2))
    output[:outliers] += 30.0
    return Regression(matrix, output.ravel(), np.arange(1, 9), tuple("abcdefgh"), placement, share)


def plates(data, plate):
    """Z of one plate's placement errors, (2m, 2 placements)."""
    size = data.placement.max() + 1
    design = np.zeros((len(data.placement), 2, size, 2))
    for axis in (0, 1):
        design[np.arange(len(design)), axis, data.placement, axis] = data.load_share[:, plate]
    return design.reshape(len(data.output), 2 * size)


@pytest.fixture(scope="module")
def sm():
    """Import statsmodels where it is needed: that takes a second in every process."""
    return importlib.import_module("statsmodels.api")


def test_least_squares_is_that_of_statsmodels(sm):
    data = made(0)
    found, theirs = estimate_by(data, "least-squares"), sm.OLS(data.output, data.matrix).fit()
    assert found.value == pytest.approx(theirs.params, rel=1e-9, abs=1e-12)
    assert found.covariance == pytest.approx(theirs.cov_params(), rel=1e-8, abs=1e-14)


def test_huber_is_that_of_statsmodels_and_shrugs_off_outliers(sm):
    """Their H1 covariance has Huber's small-sample factor K squared on top."""
    data = made(1, outliers=6)
    found = estimate_by(data, "robust")
    theirs = sm.RLM(data.output, data.matrix, M=sm.robust.norms.HuberT()).fit(tol=1e-10, maxiter=500)
    assert found.value == pytest.approx(theirs.params, abs=1e-7)
    psi = sm.robust.norms.HuberT().psi_deriv(theirs.sresid)
    k = 1 + 8 / len(psi) * psi.var() / psi.mean() ** 2
    assert k**2 * found.covariance == pytest.approx(theirs.bcov_scaled, rel=1e-3, abs=1e-9)
    plain = np.abs(estimate_by(data, "least-squares").value).max()
    assert np.abs(found.value).max() < 0.5 * plain


def test_generalised_least_squares_is_that_of_statsmodels(sm):
    data = made(2)
    found, fit = estimate_by(data, "placement"), fit_components(data, None)
    size = fit.scale[0] * estimate_by(data, "least-squares").sigma
    covariance = size**2 * np.eye(len(data.output))
    for plate, sd in enumerate(fit.placement_sd):
        covariance += sd**2 * plates(data, plate) @ plates(data, plate).T
    theirs = sm.GLS(data.output, data.matrix, sigma=covariance).fit()
    assert found.value == pytest.approx(theirs.params, rel=1e-7, abs=1e-10)
    assert found.covariance == pytest.approx(theirs.normalized_cov_params, rel=1e-6, abs=1e-12)


def test_restricted_maximum_likelihood_is_that_of_statsmodels(monkeypatch, sm):
    """With no belief in any data sheet. Their standard errors allow a little for the variances' own errors:
    1 %."""
    monkeypatch.setattr(variance_components, "NO_PRIOR", 1e4)
    data = made(3)
    found = estimate_by(data, "placement")
    groups = np.repeat(data.placement, 2)
    rows = [np.flatnonzero(groups == g) for g in range(30)]
    columns = [[2 * g, 2 * g + 1] for g in range(30)]
    mats = [[plates(data, plate)[r][:, c] for r, c in zip(rows, columns, strict=True)] for plate in (0, 1)]
    spec = sm.regression.mixed_linear_model.VCSpec(["right", "left"], [[["x", "y"]] * 30] * 2, mats)
    model = sm.MixedLM(data.output, data.matrix, groups, exog_vc=spec)
    theirs = model.fit(reml=True, method=["bfgs", "powell"])
    assert np.square(found.placement_sd) == pytest.approx(theirs.vcomp, rel=2e-3)
    assert found.value == pytest.approx(theirs.fe_params, abs=1e-4)
    assert standard_errors(found.covariance) == pytest.approx(theirs.bse_fe, rel=1e-2)


@pytest.mark.parametrize("sd", [1e-4, 3e-3])
def test_the_closed_chain_shows_the_encoders_errors(parameters, robot, plan, sd):
    """150 postures leave about 350 degrees of freedom, an s.d. known to 4 %: bounds at 4 of them. Constant
    offsets do not count."""
    rng = np.random.default_rng(131)
    swing = parameters.tree.frame(robot.swing_foot)
    offset = 2e-3 * rng.standard_normal(12)
    angles = plan.joint_angles + sd * rng.standard_normal(plan.joint_angles.shape)
    for measured in (angles, angles + offset):
        found = encoder_sd_by_closure(parameters.tree, parameters.base, swing, measured, plan.placement)
        assert found == pytest.approx(sd, rel=0.16)


def test_too_few_postures_show_nothing_of_the_encoders(parameters, robot, plan):
    swing = parameters.tree.frame(robot.swing_foot)
    arguments = (parameters.tree, parameters.base, swing, plan.joint_angles)
    assert encoder_sd_by_closure(*arguments, np.arange(150)) is None


def test_no_more_than_half_is_taken_for_encoder_errors():
    information = np.diag([4.0, 1.0])
    small, large = np.diag([0.4, 0.1]), np.diag([0.4, 2.0])
    assert bounded_excess(small, information) == pytest.approx(small)
    assert bounded_excess(large, information) == pytest.approx(large / 4)


def test_masses_that_statics_gives(parameters, nominal, model, foreign):
    """TULip: the total alone. Moving mass between links along an unseen direction changes no measurement."""
    visible = identifiable_masses(parameters)
    assert visible.combinations == pytest.approx(np.ones((1, 13)))
    assert "no single link mass" in visible.sentence
    total = np.zeros((13, 4))
    total[:, 0] = 1.0
    _, _, turned = np.linalg.svd(np.vstack([parameters.from_standard, total.ravel()]))
    unseen = turned[26:].reshape(-1, 13, 4)
    standard = standard_parameters(model)
    for direction in unseen:
        assert parameters.values(standard + 0.1 * direction) == pytest.approx(nominal.value, abs=1e-9)
    assert (np.abs(unseen[:, :, 0]).max(axis=0) > 1e-3).all()
    assert identifiable_masses(base_parameters(foreign["humanoid"])).alone == ("right_foot", "left_foot")


def test_the_posterior_is_right_about_its_errors(bench, nominal, model):
    """30 robots from the prior, 52 quantities each: the mean of z^2 is 1 within 0.15, about four of its s.d.
    (quantities correlate), masses and centres each."""
    standard, squares, shares = standard_parameters(model), [], []
    for seed in range(30):
        rng = np.random.default_rng([132, seed])
        mass = standard[:, 0] * (1 + MASS_SD * rng.standard_normal(len(standard)))
        center = standard[:, 1:] / standard[:, :1] + CENTER_SD * rng.standard_normal((len(mass), 3))
        truth = np.column_stack([mass, center])
        value = nominal.parameters.values(np.column_stack([mass, mass[:, None] * center]))
        robot = dataclasses.replace(nominal, value=value, mass=float(mass.sum()))
        data = dataclasses.replace(bench, nominal=robot).draw(rng, **WII)
        found = estimate_by(data, "prior").standard
        assert found is not None
        error = np.column_stack([found.mass, found.center]) - truth
        squares.append((error / np.column_stack([found.mass_error, found.center_error])) ** 2)
        shares.append(np.column_stack([found.mass_share, found.center_share]))
    mean = np.mean(squares, axis=(0, 1))
    assert np.abs(mean - 1).max() < 0.25
    assert np.mean(squares) == pytest.approx(1, abs=0.15)
    assert 0 <= np.min(shares) <= np.max(shares) <= 1
    assert np.mean(shares, axis=0)[0, 0] > 0.5  # the torso's mass: most of the total


def test_consistent_estimates_are_reachable_and_nearer(bench):
    """Every estimate is a robot's (by a linear program), and errors shrink; nine in ten at least must."""
    better = []
    for seed in range(10):
        data = bench.draw(np.random.default_rng([134, seed]), **WII)
        free, found = estimate_by(data, MIXED_MODEL), estimate_by(data, "consistent")
        reachable = corner_parameters(data)
        rows = np.vstack([reachable, np.ones(reachable.shape[1])])
        program = linprog(
            np.zeros(rows.shape[1]), A_eq=rows, b_eq=np.append(found.value, 1.0), bounds=(0, None)
        )
        assert program.status == 0
        errors = [np.linalg.norm(e.value - bench.nominal.value) for e in (free, found)]
        better.append(errors[1] < errors[0])
    assert sum(better) >= 9


def test_a_feasible_estimate_is_left_alone(bench):
    data = bench.draw(np.random.default_rng(135), cell=1e-3, placement=1e-6, mark=1e-6, encoder=0.0)
    free, found = estimate_by(data, MIXED_MODEL), estimate_by(data, "consistent")
    assert np.abs((found.value - free.value) / standard_errors(free.covariance)).max() < 1e-3
