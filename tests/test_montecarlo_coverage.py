"""Errors against stated errors: wrong standard errors are found out, right ones are not accused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from scipy.stats import binom, f, t

from tests.montecarlo_work import LAYOUT, TRUTH, Regressions, result_of, run_regressions
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.montecarlo.coverage import model_errors, summarise_errors
from tulip_testbed.experiments.montecarlo.coverage_verdict import (
    LEVEL,
    CoverageCheck,
    checks,
    shown,
    verdict,
    whole_bounds,
)
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.montecarlo.run_columns import Layout, numbers_of
from tulip_testbed.identification.estimators import Unseen

RUNS, FEW, FAILING = 5000, 200, (3, 77)


@pytest.fixture(scope="module", autouse=True)
def of_no_robot():
    """Judge columns that were made up; no plan says where their centre of mass is."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("tulip_testbed.experiments.montecarlo.montecarlo_result._usable", lambda *_: "")
        yield


def test_errors_and_stated_errors(tmp_path):
    """Of the identified runs, as another reader of Parquet has them."""
    chunks = run_regressions(tmp_path, FEW, 30, Regressions(seed=107, failing=FAILING))
    whole = pyarrow.parquet.read_table(chunks.folder)
    result: Any = result_of(chunks)
    good = np.delete(np.arange(FEW), FAILING)
    runs = {name: whole.column(name).to_numpy()[good] for name in whole.column_names}
    assert (result.runs, result.identified) == (FEW, FEW - len(FAILING))
    assert result.failures == {"too little": 2}
    for model, numbers in LAYOUT.models.items():
        rows = result.models[model].parameters
        error = np.column_stack([runs[f"{model}.value.{n}"] - TRUTH[n - 1] for n in numbers])
        stated = np.column_stack([runs[f"{model}.se.{n}"] for n in numbers])
        np.testing.assert_allclose([row.bias for row in rows], error.mean(axis=0), rtol=1e-10)
        found = [row.empirical_standard_error for row in rows]
        np.testing.assert_allclose(found, error.std(axis=0, ddof=1), rtol=1e-12)
        mean = np.sqrt((stated**2).mean(axis=0))
        np.testing.assert_allclose([row.standard_error for row in rows], mean, rtol=1e-12)
        np.testing.assert_allclose(result.errors_mm[model], 1e3 * error, rtol=1e-12)
        limit = t.ppf(0.975, runs[f"{model}.dof.1"][0])
        held = (np.abs(error / stated) <= limit).mean(axis=0)
        assert [row.coverage95 for row in rows] == held.tolist()
        statistic = runs[f"{model}.chi_square"] / len(numbers)
        beyond = (statistic > f.ppf(0.95, len(numbers), 20 - len(numbers))).mean()
        assert result.models[model].beyond_95.share == beyond


def test_intervals_hold_the_truth_as_often_as_they_say():
    """2,000 Monte Carlos of 50 runs: an error of 1.3 stated s.e. and a bias of 0.2."""
    error = 0.2 + 1.3 * np.random.default_rng(109).standard_normal((50, 2000))
    errors = summarise_errors(error, np.ones_like(error), np.full(error.shape, 40.0))
    for (_, (low, high)), truth in (
        (errors.relative_bias(0.9), 0.2),
        (errors.standard_error_ratio(0.9), 1.3),
    ):
        held = ((low <= truth) & (truth <= high)).mean()
        assert abs(held - 0.9) < 3.3 * np.sqrt(0.9 * 0.1 / 2000)


def judged(folder, runs, **changes) -> MonteCarlo:
    return result_of(run_regressions(folder, runs, 500, Regressions(seed=111, **changes)))


def failed(result: MonteCarlo) -> dict[str, CoverageCheck]:
    return {check.name: check for check in result.checks if check.result == "fail"}


def test_a_true_estimator_is_shown_to_be_right(tmp_path):
    result = judged(tmp_path, RUNS)
    assert (result.verdict, result.shown, result.exit_code) == ("pass", True, 0)
    assert result.parameters[0].standard_error_ratio == pytest.approx(1.0, abs=0.07)
    assert result.parameters[2].coverage95 == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize("runs", [1, 2])
def test_few_runs_print_and_are_inconclusive(tmp_path, runs):
    result = judged(tmp_path, runs)
    assert (result.verdict, result.shown, result.exit_code) == ("inconclusive", False, 3)
    assert ("its s.e. - g; found over stated s.e. -," in "".join(result.lines())) == (runs == 1)


def test_halved_standard_errors_fail(tmp_path):
    result = judged(tmp_path, 300, factor=0.5)
    assert (result.verdict, result.shown, result.exit_code) == ("fail", False, 1)
    found = failed(result)
    for model, numbers in (("full", (1, 2, 3)), ("simplified", (1, 3))):
        assert found[f"{model}: empirical over reported s.e."].beyond == numbers
        assert found[f"{model}: coverage of 95 % intervals"].beyond == numbers
    assert "full: runs whose chi-square / 3 exceeds 95 % of F" in found
    assert result.parameters[0].standard_error_ratio == pytest.approx(2.0, abs=0.25)


def test_doubled_standard_errors_and_a_bias_fail(tmp_path):
    found = failed(judged(tmp_path / "doubled", 1000, factor=2.0))
    assert found["full: coverage of 95 % intervals"].value > 0.99
    assert found["full: empirical over reported s.e."].value < 0.6
    found = failed(judged(tmp_path / "biased", 1000, shift=0.3))
    assert found["full: bias over s.e."].beyond == (1, 2, 3)


def test_failed_runs_fail_the_verdict(tmp_path):
    result = judged(tmp_path, 60, failing=(5, 6, 7))
    assert failed(result).keys() == {"share of runs that could not be identified"}
    assert not failed(judged(tmp_path / "one", 60, failing=(5,)))  # as chance alone may have it
    nothing = judged(tmp_path / "all", 2, failing=(0, 1))
    assert nothing.to_json()["parameters"][0]["bias"] is None
    assert all(isinstance(part, Table | str) for part in nothing.tables())


def outcomes(factor: float, size: int, runs: int, seed: int) -> list[list[CoverageCheck]]:
    """Judge errors of runs that are `factor` times as large as stated."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(300):
        z = factor * rng.standard_normal((runs, size))
        errors = summarise_errors(z, np.ones_like(z), np.array(1e9), tuple(range(1, size + 1)))
        found.append(checks(runs, {"full": errors}, {"full": 0.0}))
    return found


def test_what_only_a_prior_knows_is_no_error_of_the_estimator():
    """Hand-worked: theta = y - 2 phi, y of s.d. 1, phi unknown with a prior of s.d. 1.5; phi is really 3."""
    rng, runs = np.random.default_rng(116), 4000
    layout, covariance = Layout(("a", "b"), {"full": (1, 2)}), np.diag([1 + 9.0, 1])
    made = Regressions().fit(np.eye(4, 3), np.zeros(4), (1, 2))
    stated = {"covariance": covariance, "clustered_covariance": covariance}
    made = replace(made, interval_dof=np.full(2, 1e9), joint_dof=1e9, dof=1000, **stated)
    rows = []
    for theta in 0.7 + rng.standard_normal((runs, 2)):
        unseen = Unseen(("tilt",), np.zeros(1), np.array([[-2.0], [0.0]]), np.eye(2))
        estimate = replace(made, value=theta + np.array([6.0, 0.0]), unseen=unseen)
        rows.append(numbers_of(layout, {"full": estimate}, np.array([0.7, 0.7]), (1, 1, 1, 1), {"tilt": 3.0}))
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    plain, given = (model_errors(columns, "full", (1, 2), given) for given in (False, True))
    assert plain.bias[0] == pytest.approx(6, abs=0.1)
    assert verdict(checks(runs, {"full": plain}, {"full": 0.0})) == "fail"
    assert verdict(checks(runs, {"full": given}, {"full": 0.0})) != "fail"


MOST = binom.ppf(0.999, 300, LEVEL)  # of 300 verdicts at a level of 1 %


def test_a_true_estimator_is_rarely_failed():
    assert sum(verdict(found) == "fail" for found in outcomes(1.0, 25, 400, 112)) <= MOST


def test_an_estimator_on_a_bound_is_rarely_failed_for_it():
    ratios = [found[2] for found in outcomes(1.1, 25, 400, 113)]
    assert {check.name for check in ratios} == {"full: empirical over reported s.e."}
    assert sum(check.result == "fail" for check in ratios) <= MOST


@pytest.mark.slow
def test_an_estimator_on_a_bound_is_rarely_shown_to_be_right():
    assert sum(found[2].shown for found in outcomes(1.1, 1, 2500, 114)) <= MOST
    assert sum(shown(found) for found in outcomes(1.0, 25, 5000, 115)) > 250


def test_bounds_of_the_whole_are_those_of_the_ratios():
    """By drawing: 25 normal errors 1.1 times as large as stated."""
    low, high = whole_bounds(25, 1e9)
    rng = np.random.default_rng(114)
    statistic = (rng.standard_normal((40_000, 25)) ** 2).sum(axis=1)
    limit = np.quantile(statistic, 0.95)
    assert (1.21 * statistic > limit).mean() == pytest.approx(high, abs=0.01)
    assert (0.81 * statistic > limit).mean() == pytest.approx(low, abs=0.004)


def changed(folder: Path, runs: int, seed: int, name: str, change: Callable[..., np.ndarray]) -> MonteCarlo:
    """Judge runs of which one column was changed."""
    chunks = run_regressions(folder, runs, runs, Regressions(seed=seed))
    columns = chunks.read(0, LAYOUT.columns())
    chunks.write(columns | {name: change(columns)})
    return result_of(chunks)


def test_a_robot_outside_of_the_simplified_model_is_reported_and_not_judged(tmp_path):
    result = changed(tmp_path, 40, 111, "truth.2", lambda columns: np.full(40, 0.01))
    assert {c.name: c.result for c in result.checks}["simplified model"] == "not evaluated"
    assert len(result.simplified.parameters) == 2


@pytest.mark.parametrize(("quantity", "verdict"), [("value", "inconclusive"), ("given", "fail")])
def test_the_verdict_is_of_the_errors_without_what_only_a_prior_knows(tmp_path, quantity, verdict):
    name = f"full.{quantity}.2"
    result = changed(tmp_path, 400, 117, name, lambda columns: columns[name] + columns["full.se.2"])
    assert result.verdict == verdict
    ratio = result.parameters[1].bias / result.parameters[1].standard_error
    assert ratio == pytest.approx(float(quantity == "value"), abs=0.2)
