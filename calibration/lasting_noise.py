"""How long the noise of a moving record lasts, by the restricted likelihood.

Residuals that are left of a fit last shorter than the noise: base parameters and members take its slow part.
The likelihood of what they leave undetermined does not count them. The scales of the noise are estimated for
every duration, since short noise with small scales resembles long noise with large ones.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.reml import LikelihoodFit, least_nearby
from tulip_testbed.identification.noise_in_time import WHITE, Decorrelation, NoiseInTime

SHARES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995)
# s. What lasts longer than a few postures is not noise of the sensors but what the model lacks, and has to be
# seen as such. Assumed.
SECONDS = (0.5 * 2.0 ** (np.arange(7) / 2)).tolist()
SHORT = NoiseInTime(0.7, 1.0, 0.9)
# Steps of share, seconds and the closure's share, whose likelihood hardly depends on the other share.
WAYS = (
    *((0, -1, 0), (0, 1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)),
    *((1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0)),
)
LEAST_GAIN = 3.0  # of ln of the likelihood, from which noise lasts
FAR = 20.0  # of ln of the likelihood; the next linearisation changes differences by some 4 %


def likeliest_noise(
    problem: LinearProblem,
    fitted: LikelihoodFit,
    start: NoiseInTime | None,
    decorrelated: Callable[[NoiseInTime], Decorrelation],
    far: set[NoiseInTime],
) -> NoiseInTime:
    """Return how the noise is correlated in time, by the largest restricted likelihood on a grid.

    From the start the search goes uphill to a neighbour, as long as it can in one direction.

    Args:
        fitted: the estimate with what `problem` holds now.
        start: a point of the grid, or white noise; None: short noise, from where the way leads along the
            ridge on which a larger share that lasts longer resembles a smaller one.
        decorrelated: makes what the problem needs in place of its `in_time`.
        far: what need not be tried, since it was much less likely about an earlier linearisation; those that
            are found here are added.
    """
    used = np.any(problem.whole, axis=2)
    known, modes = dict[NoiseInTime, float](), dict[NoiseInTime, tuple[np.ndarray, np.ndarray]]()

    def likelihood(one: NoiseInTime) -> float:
        if one in far:
            return -np.inf
        if one not in known:
            in_time, near = decorrelated(one), modes.get(best, (fitted.scales, fitted.spreads))
            volume = in_time.log_volume(used)
            beat = volume - known.get(best, -np.inf)
            try:
                least, modes[one] = least_nearby(replace(problem, in_time=in_time), near, beat)
                known[one] = volume - least
            except np.linalg.LinAlgError:
                known[one] = -np.inf
        return known[one]

    def noise(at: np.ndarray) -> NoiseInTime:
        return NoiseInTime(SHARES[at[0]], SECONDS[at[1]], SHARES[at[2]])

    start = start or SHORT
    shares = [SHARES.index(max(one.share, SHARES[0])) for one in (start, start.of_closure())]
    at, ways = np.array([shares[0], SECONDS.index(start.seconds), shares[1]]), list(WAYS)
    best, last = noise(at), np.array([len(SHARES), len(SECONDS), len(SHARES)]) - 1
    while ways:
        there = np.clip(at + (by := ways.pop(0)), 0, last)
        if likelihood(best) < likelihood(other := noise(there)):
            at, best, ways = there, other, [by, *(way for way in WAYS if way != by)]
    lasts = likelihood(best) > likelihood(WHITE) + LEAST_GAIN
    far |= {one for one, value in known.items() if value < likelihood(best) - FAR}
    return best if lasts else WHITE
