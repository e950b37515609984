"""The verdict: wrong standard errors are found out, right ones are not accused, few runs show nothing."""

import numpy as np
import pytest
from scipy.stats import binom

from tests.montecarlo_work import LAYOUT, Regressions, run_regressions
from tulip_testbed.experiments.montecarlo.calibration_report import CalibrationReport, report
from tulip_testbed.experiments.montecarlo.calibration_tables import (
    calibration_check_table,
    calibration_report,
)
from tulip_testbed.experiments.montecarlo.calibration_verdict import (
    LEVEL,
    CalibrationCheck,
    checks,
    shown,
    verdict,
    whole_bounds,
)
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.summary import Calibration, Spread, Summary, summarise

RUNS = 5000


def judged(folder, runs, **changes):
    work = Regressions(seed=111, **changes)
    return report(summarise(run_regressions(folder, runs, 500, work), LAYOUT), LAYOUT, "stand-in", 0).plain()


def failed(document):
    return {check["name"]: check for check in document["checks"] if check["result"] == "fail"}


def test_a_true_estimator_is_shown_to_be_right(tmp_path):
    document = judged(tmp_path, RUNS)
    assert CalibrationReport.model_validate(document).conclusive
    assert document["verdict"] == "pass"
    assert document["shown"]
    assert document["parameters"][0]["standard_error_ratio"] == pytest.approx(1.0, abs=0.07)
    assert document["parameters"][2]["coverage95"] == pytest.approx(0.95, abs=0.015)
    assert document["correlations"]["1,3"]["mean"] == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("runs", [1, 2])
def test_a_pass_of_few_runs_prints_and_is_not_conclusive(tmp_path, runs):
    chunks = run_regressions(tmp_path, runs, 500, Regressions(seed=111))
    found = report(summarise(chunks, LAYOUT), LAYOUT, "stand-in", 0)
    assert (found.verdict, found.conclusive) == ("pass", False)
    text = "\n".join(map(str, calibration_report(found.plain())))
    assert ("± - g, found over stated s.e. -," in text) == (runs == 1)


def test_halved_standard_errors_fail(tmp_path):
    document = judged(tmp_path, 300, factor=0.5)
    assert document["verdict"] == "fail"
    assert not document["shown"]
    found = failed(document)
    for model, numbers in (("full", [1, 2, 3]), ("simplified", [1, 3])):
        assert found[f"{model}: empirical over reported s.e."]["beyond"] == numbers
        assert found[f"{model}: coverage of 95 % intervals"]["beyond"] == numbers
    assert "full: runs whose chi-square / 3 exceeds 95 % of F" in found
    assert document["parameters"][0]["standard_error_ratio"] == pytest.approx(2.0, abs=0.25)


def test_doubled_standard_errors_fail(tmp_path):
    found = failed(judged(tmp_path, 1000, factor=2.0))
    assert found["full: coverage of 95 % intervals"]["value"] > 0.99
    assert found["full: empirical over reported s.e."]["value"] < 0.6


def test_a_bias_fails(tmp_path):
    found = failed(judged(tmp_path, 1000, shift=0.3))
    assert found["full: bias over s.e."]["beyond"] == [1, 2, 3]


def test_few_runs_fail_nothing_and_show_nothing(tmp_path):
    document = judged(tmp_path, 20)
    assert document["verdict"] == "pass"
    assert not document["shown"]


def test_one_run_is_reported_and_not_judged(tmp_path):
    document = judged(tmp_path, 1)
    assert {c["result"] for c in document["checks"][1:]} == {"not evaluated"}
    assert not document["shown"]


def test_failed_runs_fail_the_verdict(tmp_path):
    document = judged(tmp_path, 60, failing=(5, 6, 7))
    assert failed(document).keys() == {"share of runs that could not be identified"}
    assert not failed(judged(tmp_path / "one", 60, failing=(5,)))  # as chance alone may have it
    assert judged(tmp_path / "all", 2, failing=(0, 1))["parameters"][0]["bias"] is None


def drawn(rng: np.random.Generator, factor: float, size: int, runs: int) -> Summary:
    """A summary of runs whose errors are `factor` times as large as stated."""
    z = factor * rng.standard_normal((runs, size))
    model = Calibration(
        numbers=np.arange(1, size + 1),
        bias=z.mean(axis=0),
        sd=z.std(axis=0, ddof=1),
        standard_error=np.ones(size),
        covered=np.array([(np.abs(z) <= limit).sum(axis=0) for limit in (0.6745, 1.6449, 1.9600)]),
        truth=np.zeros((2, size)),
        exceeded=None,
    )
    dof = Spread(1e9, 0.0, 1e9, 1e9, (1e9, 1e9, 1e9))
    return Summary(runs, runs, {}, {"full": model}, model, {"full.residual_dof": dof}, {"full": 0.0})


def outcomes(factor: float, size: int, runs: int, seed: int) -> list[list[CalibrationCheck]]:
    rng = np.random.default_rng(seed)
    return [checks(drawn(rng, factor, size, runs)) for _ in range(300)]


MOST = binom.ppf(0.999, 300, LEVEL)  # of 300 verdicts at a level of 1 %


def test_a_true_estimator_is_rarely_failed():
    assert sum(verdict(found) == "fail" for found in outcomes(1.0, 25, 400, 112)) <= MOST


def test_an_estimator_on_a_bound_is_rarely_failed_for_it():
    ratios = [found[2] for found in outcomes(1.1, 25, 400, 113)]
    assert {check.name for check in ratios} == {"full: empirical over reported s.e."}
    assert sum(check.result == "fail" for check in ratios) <= MOST


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


def test_a_robot_outside_of_the_simplified_model_is_reported_and_not_judged(tmp_path):
    chunks = run_regressions(tmp_path, 40, 40, Regressions(seed=111))
    columns = next(iter(chunks.read(["failure", "rows", "dropped", *LAYOUT.columns()])))
    columns["truth.2"] = np.full(40, 0.01)
    (tmp_path / "other").mkdir()
    changed = Chunks(tmp_path / "other", 40, 40)
    changed.write(columns)
    document = report(summarise(changed, LAYOUT), LAYOUT, "stand-in", 0).plain()
    results = {check["name"]: check["result"] for check in document["checks"]}
    assert results["simplified model"] == "not evaluated"
    assert len(document["simplified"]["parameters"]) == 2


def test_a_pass_that_is_not_shown_reads_inconclusive():
    row = {
        "name": "full: bias over s.e.",
        "result": "pass",
        "shown": False,
        "number": 3,
        "value": 0.2159,
        "interval": [-0.05, 0.48],
        "bounds": [-0.1, 0.1],
        "beyond": [],
        "source": "somewhere",
    }
    lines = [calibration_check_table([row | {"shown": shown}]).text(90) for shown in (False, True)]
    assert all("0.0500 to 0.4800" in text and "-0.1 to 0.1" in text for text in lines)
    results = [next(line for line in text.splitlines() if "0.2159" in line) for text in lines]
    assert "inconclusive" in results[0]
    assert "inconclusive" not in results[1]
    assert "pass" in results[1]
