"""Predictive densities by blocks and a low rank, against the dense normal distribution."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from tulip_testbed.calibration.prediction import Prediction


@pytest.mark.parametrize("channels", ["A", "AT", "ATC"])
def test_density_and_chi_square_are_those_of_the_dense_covariance(channels):
    rng = np.random.default_rng(2)
    sizes, unit = (5, 3, 7), 10.0 ** rng.uniform(-4, 2, 15)
    factors = [rng.standard_normal((n, n)) for n in sizes]
    ends = np.cumsum(sizes)[:-1]
    noise = tuple(
        (factor @ factor.T + np.eye(len(factor))) * np.outer(part, part)
        for factor, part in zip(factors, np.split(unit, ends), strict=True)
    )
    estimates = 3 * unit[:, None] * rng.standard_normal((15, 4))
    channel = np.array(list("ATCATACCTTTAAAC"))
    whole = Prediction(unit * rng.standard_normal(15), channel, noise, estimates)
    found, rows = whole.of(channels), np.isin(channel, list(channels))
    covariance = (block_diag(*noise) + estimates @ estimates.T)[np.ix_(rows, rows)]
    scaled = covariance / np.outer(unit[rows], unit[rows])
    dense = multivariate_normal(np.zeros(rows.sum()), scaled)
    expected = dense.logpdf(whole.residual[rows] / unit[rows]) - np.log(unit[rows]).sum()
    assert found.log_density == pytest.approx(expected)
    inverse = np.linalg.solve(scaled, found.residual / unit[rows])
    assert found.chi_square == pytest.approx(inverse @ (found.residual / unit[rows]))
    assert found.variance == pytest.approx(np.diag(covariance))
