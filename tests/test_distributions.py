"""The distributions against those of scipy.stats."""

import numpy as np
import pytest
from scipy import stats

from tulip_testbed.identification import distributions as d

P = np.array([1e-12, 0.004, 0.3, 0.5, 0.975, 1 - 1e-9])
X = np.array([-2.0, 0.0, 1e-9, 0.4, 3.0, 80.0, np.inf])


@pytest.mark.parametrize("dof", [1, 2.5, 7, 400, 1e6, np.inf])
def test_student(dof):
    assert np.array_equal(d.t_sf(X, dof), stats.t.sf(X, dof))
    assert np.array_equal(d.t_ppf(P, dof), stats.t.ppf(P, dof))


@pytest.mark.parametrize("dof", [0, 1, 2.5, 7, 400])
def test_chi_square(dof):
    assert np.array_equal(d.chi2_sf(X, dof), stats.chi2.sf(X, dof), equal_nan=True)
    if dof:
        assert np.array_equal(d.chi2_isf(P, dof), stats.chi2.isf(P, dof))
        assert np.array_equal(d.chi2_ppf(P, dof), stats.chi2.ppf(P, dof))


@pytest.mark.parametrize(("above", "below"), [(0, 3), (2, 0), (1, 1), (3, 12.5), (40, 900)])
def test_fisher(above, below):
    assert np.array_equal(d.f_sf(X, above, below), stats.f.sf(X, above, below), equal_nan=True)
    if above and below:
        assert np.array_equal(d.f_ppf(P, above, below), stats.f.ppf(P, above, below))


def test_normal():
    assert np.array_equal(d.normal_sf(X), stats.norm.sf(X))
    assert np.array_equal(d.normal_logcdf(X), stats.norm.logcdf(X))
    assert [d.normal_isf(p) for p in P] == stats.norm.isf(P).tolist()


def test_discover_does_not_wait_for_scipy_stats():
    import subprocess
    import sys

    code = "import sys, tulip_testbed.api; print(sorted({'scipy.stats', 'pandas'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
