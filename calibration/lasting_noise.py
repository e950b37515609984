"""How long the noise of a moving record lasts, by the restricted likelihood.

Residuals that are left of a fit last shorter than the noise: base parameters and members take its slow part.
The likelihood of what they leave undetermined does not count them. The scales of the noise are estimated for
every duration, since short noise with small scales resembles long noise with large ones.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.reml import LikelihoodFit, fit_nearby
from tulip_testbed.identification.noise_in_time import WHITE, Decorrelation, NoiseInTime

SHARES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)
# s. What lasts longer than a few postures is not noise of the sensors but what the model lacks, and has to be
# seen as such. Assumed.
SECONDS = (0.5 * 2.0 ** (np.arange(7) / 2)).tolist()
SHORT = NoiseInTime(0.5, 1.0)
WAYS = ((0, -1), (0, 1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
LEAST_GAIN = 3.0  # of ln of the likelihood, from which noise lasts


def likeliest_noise(
    problem: LinearProblem,
    fitted: LikelihoodFit,
    start: NoiseInTime | None,
    decorrelated: Callable[[NoiseInTime], Decorrelation],
) -> NoiseInTime:
    """Return how the noise is correlated in time, by the largest restricted likelihood on a grid.

    From the start the search goes uphill to a neighbour, as long as it can in one direction.

    Args:
        fitted: the estimate with what `problem` holds now.
        start: a point of the grid, or white noise; None: short noise, from where the way leads along the
            ridge on which a larger share that lasts longer resembles a smaller one.
        decorrelated: makes what the problem needs in place of its `in_time`.
    """
    used = np.any(problem.whole, axis=2)
    known, modes = dict[NoiseInTime, float](), dict[NoiseInTime, LikelihoodFit]()

    def likelihood(one: NoiseInTime) -> float:
        if one not in known:
            in_time, near = decorrelated(one), modes.get(best, fitted)
            try:
                modes[one] = fit_nearby(replace(problem, in_time=in_time), (near.scales, near.spreads))
                known[one] = in_time.log_volume(used) - modes[one].value
            except np.linalg.LinAlgError:
                known[one] = -np.inf
        return known[one]

    start = start or SHORT
    at = SHARES.index(max(start.share, SHARES[0])), SECONDS.index(start.seconds)
    best, ways = NoiseInTime(SHARES[at[0]], SECONDS[at[1]]), list(WAYS)
    while ways:
        by = ways.pop(0)
        k, j = at[0] + by[0], at[1] + by[1]
        if not (0 <= k < len(SHARES) and 0 <= j < len(SECONDS)):
            continue
        if likelihood(other := NoiseInTime(SHARES[k], SECONDS[j])) > likelihood(best):
            at, best, ways = (k, j), other, [by, *(way for way in WAYS if way != by)]
    return best if likelihood(best) > likelihood(WHITE) + LEAST_GAIN else WHITE
