"""The distributions, which are loaded faster, against those of scipy.stats."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from tulip_testbed.identification import distributions as d

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


def test_discover_does_not_wait_for_scipy_stats():
    code = "import sys, tulip_testbed.api; print(sorted({'scipy.stats', 'pandas'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
