"""The streaming summary against numpy on all runs at once; its intervals against what they promise."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.stats import f, t
from statsmodels.stats.proportion import proportion_confint

from tests.montecarlo_work import LAYOUT, TRUTH, Regressions, run_regressions
from tulip_testbed.experiments.montecarlo.intervals import relative_bias, share, standard_error_ratio
from tulip_testbed.experiments.montecarlo.moments import BINS, histogram, moments, quantiles
from tulip_testbed.experiments.montecarlo.summary import Calibration, summarise

RUNS, FAILING = 200, (3, 77)


@pytest.fixture(scope="module")
def chunks(tmp_path_factory):
    return run_regressions(tmp_path_factory.mktemp("runs"), RUNS, 30, Regressions(seed=107, failing=FAILING))


@pytest.fixture(scope="module")
def table(chunks):
    whole = pa.parquet.read_table(chunks.folder)
    good = np.delete(np.arange(RUNS), FAILING)
    return {name: whole.column(name).to_numpy()[good] for name in whole.column_names}


@pytest.fixture(scope="module")
def summary(chunks):
    return summarise(chunks, LAYOUT)


def test_errors_and_stated_errors(summary, table):
    assert summary.runs == RUNS
    assert summary.count == RUNS - len(FAILING)
    assert summary.failures == {"too little": 2}
    for model, numbers in LAYOUT.models.items():
        found = summary.models[model]
        error = np.column_stack([table[f"{model}.value.{n}"] - TRUTH[n - 1] for n in numbers])
        stated = np.column_stack([table[f"{model}.se.{n}"] for n in numbers])
        np.testing.assert_allclose(found.bias, error.mean(axis=0), rtol=1e-10)
        np.testing.assert_allclose(found.sd, error.std(axis=0, ddof=1), rtol=1e-12)
        np.testing.assert_allclose(found.standard_error, np.sqrt((stated**2).mean(axis=0)), rtol=1e-12)
        for k, level in enumerate((0.5, 0.9, 0.95)):
            limit = t.ppf((1 + level) / 2, table[f"{model}.dof.1"][0])
            assert found.covered[k].tolist() == (np.abs(error / stated) <= limit).sum(axis=0).tolist()
        statistic = table[f"{model}.chi_square"] / len(numbers)
        assert found.exceeded == (statistic > f.ppf(0.95, len(numbers), 20 - len(numbers))).sum()
    assert summary.dropped_truth == {"full": 0.0, "simplified": 0.0}


def test_distributions(summary, table):
    for name, spread in summary.spreads.items():
        values = table[name].astype(float)
        assert spread.mean == pytest.approx(values.mean(), rel=1e-12)
        assert spread.sd == pytest.approx(values.std(ddof=1), rel=1e-9, abs=1e-12)
        assert (spread.least, spread.most) == (values.min(), values.max())
        # A quantile is off by at most a bin, and the bins' own quantiles lie between neighbouring values.
        room = np.ptp(values) / BINS + 1e-15
        below = np.quantile(values, (0.05, 0.5, 0.95), method="lower")
        above = np.quantile(values, (0.05, 0.5, 0.95), method="higher")
        assert (spread.quantiles >= below - room).all()
        assert (spread.quantiles <= above + room).all()


def test_the_summary_does_not_depend_on_the_chunks(summary, tmp_path):
    other = run_regressions(tmp_path, RUNS, 7, Regressions(seed=107, failing=FAILING))
    assert repr(summarise(other, LAYOUT)) == repr(summary)


def test_quantiles_of_many_rows():
    rows = np.random.default_rng(108).normal(size=(20_000, 2)) * [1.0, 5.0] + [0.0, 100.0]
    parts = np.array_split(rows, 13)
    found = moments(parts, 2)
    at = quantiles(histogram(parts, found), found, (0.05, 0.5, 0.95))
    np.testing.assert_allclose(
        at, np.quantile(rows, (0.05, 0.5, 0.95), axis=0), atol=1e-3 * np.ptp(rows[:, 1])
    )


def test_no_run_and_a_constant():
    assert np.isnan(moments([], 2).mean).all()
    parts = [np.ones((4, 1))]
    found = moments(parts, 1)
    assert found.sd == 0
    assert quantiles(histogram(parts, found), found, (0.5,)) == pytest.approx(1.0, abs=1e-3)


def calibration(errors: np.ndarray, stated: float) -> Calibration:
    size = errors.shape[1]
    return Calibration(
        np.arange(1, size + 1),
        errors.mean(axis=0),
        errors.std(axis=0, ddof=1),
        np.full(size, stated),
        np.zeros((3, size), dtype=int),
        np.zeros((2, size)),
        None,
    )


def test_intervals_hold_the_truth_as_often_as_they_say():
    """2,000 Monte Carlos of 50 runs: an error of 1.3 stated s.e. and a bias of 0.2."""
    rng = np.random.default_rng(109)
    found = calibration(0.2 + 1.3 * rng.standard_normal((50, 2000)), 1.0)
    for estimates, truth in (
        (relative_bias(found, 50, 0.9), 0.2),
        (standard_error_ratio(found, 50, 0.9), 1.3),
    ):
        low, high = estimates.interval
        held = ((low <= truth) & (truth <= high)).mean()
        assert abs(held - 0.9) < 3.3 * np.sqrt(0.9 * 0.1 / 2000)


def test_binomial_intervals_are_those_of_clopper_and_pearson():
    counts = np.array([0, 3, 190, 200])
    low, high = share(counts, 200, 0.99).interval
    expected = proportion_confint(counts, 200, alpha=0.01, method="beta")
    np.testing.assert_allclose([low, high], expected, atol=1e-9)
