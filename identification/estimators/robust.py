"""Huber's M-estimator, which gives outlying postures less weight."""

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.estimators.estimate import Estimate
from tulip_testbed.identification.estimators.ordinary import least_squares, residual_sigma, solve
from tulip_testbed.identification.regressor import Regression

EXACT = 1e-12  # of the output's size; smaller residuals need no weights


def huber(data: Regression) -> Estimate:
    """Estimate by Huber's M-estimator (1964) with 95 % efficiency, scaled by the median absolute deviation.

    Its covariance is Huber's (1973): C times sigma^2 of the clipped residuals over their mean slope. This
    equals least squares on the pseudo-observations H theta + clipped residuals over the mean slope, whose
    solution is the M-estimate itself; so the clustered covariance follows as for least squares.
    """
    start, _ = solve(data)
    if residual_sigma(data, start)[1] <= EXACT * np.abs(data.output).max(initial=0.0):
        return least_squares(data)
    import statsmodels.api as sm  # takes a second to import

    fitted = sm.RLM(data.output, data.matrix, M=sm.robust.norms.HuberT()).fit(tol=1e-10, maxiter=200)
    ratio = (data.output - data.matrix @ fitted.params) / fitted.scale
    norm = sm.robust.norms.HuberT()
    clipped = fitted.scale * norm.psi(ratio) / norm.psi_deriv(ratio).mean()
    pseudo = least_squares(replace(data, output=data.matrix @ fitted.params + clipped))
    residual, sigma, _ = residual_sigma(data, pseudo.value)
    return replace(pseudo, residual=residual, sigma=sigma)
