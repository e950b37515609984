"""95 % intervals of the parameters of a fitted effect."""

from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.joint_fit import JointFit, gauss_newton
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import packed, unpacked

QUANTILE = 1.959964
MOST_SHRUNK = 0.5  # part of its prior's variance from which the data determine a size less than the prior
# Increase of chi-square within which a time of change is believed: 95 % of the limiting distribution of its
# likelihood ratio, (1 - exp(-x / 2))^2 (Hansen 2000, Econometrica 68).
TIME_GAIN = float(-2 * np.log(1 - np.sqrt(0.95)))


def as_calibrated(fit: JointFit, calibration: SelfCalibration) -> JointFit:
    """Return the terms at their sizes by self-calibration.

    It knows more than a joint fit: spreads, scales and what no reading shows are estimated together with the
    sizes. Where the data say more than the prior, its shrinkage is undone: intervals would not allow for it.

    Args:
        calibration: with the terms of the fit, in its order.
    """
    terms, variances = [], [np.zeros(0)]
    for term, one, error in zip(fit.terms, calibration.effects, calibration.effect_errors, strict=True):
        effect = FreeEffect(one)
        share = (error / effect.prior_sd) ** 2
        plain = np.where(share < MOST_SHRUNK, 1 / (1 - np.minimum(share, MOST_SHRUNK)), 1.0)
        sizes = effect.sizes * plain
        sizes = np.where(term.candidate.positive, np.maximum(sizes, 0.0), sizes)
        terms.append(replace(term, sizes=sizes))
        variances.append(error**2 * plain)
    return replace(fit, terms=tuple(terms), covariance=np.diag(np.concatenate(variances)))


def with_intervals(found: JointFit, k: int) -> EffectInstance:
    """Return term k with the 95 % intervals of its sizes and times."""
    term, effect = found.terms[k], found.terms[k].candidate.effect
    first = sum(len(other.sizes) for other in found.terms[:k])
    spread = np.sqrt(np.diag(found.covariance))[first : first + len(term.sizes)]
    intervals: list[tuple[float, float] | None] = [None] * len(effect.parameters)
    for at, size, sd, positive in zip(effect.sizes, term.sizes, spread, term.candidate.positive, strict=True):
        low = size - QUANTILE * sd
        intervals[at] = (float(max(low, 0.0) if positive else low), float(size + QUANTILE * sd))
    for at, parameter in enumerate(effect.parameters):
        if parameter.grid and not parameter.choices:
            intervals[at] = _time_interval(found, k, at)
    return EffectInstance(effect, term.candidate.target, term.values, tuple(intervals))


def _time_interval(found: JointFit, k: int, at: int) -> tuple[float, float]:
    """Find the times between postures at which a change explains nearly as much as at the best one."""
    term, observed = found.terms[k], found.linear.observed
    part = np.unique(observed.time_fraction)
    middles = (part[1:] + part[:-1]) / 2
    here = int(np.abs(middles - term.values[at]).argmin())
    # The experiment with the terms removed has lost this term's change; its prediction puts it back.
    linear = found.linear
    changed = replace(linear, observed=_put_back(term, observed), smoothed=_put_back(term, linear.smoothed))
    changed = replace(changed, residual=changed.residual_of(changed.observed))

    def chi_square(index: int) -> float:
        settings = term.candidate.settings[[term.point]].copy()
        settings[:, at] = middles[index]
        tried = Fitted(replace(term.candidate, settings=settings), 0, term.sizes)
        return gauss_newton(changed, (tried,)).chi_square

    best = chi_square(here)
    low = high = here
    while low > 0 and chi_square(low - 1) < best + TIME_GAIN:
        low -= 1
    while high < len(middles) - 1 and chi_square(high + 1) < best + TIME_GAIN:
        high += 1
    return float(part[low]), float(part[high + 1])


def _put_back(term: Fitted, observed: Observation) -> Observation:
    """Return the observation with an effect added, to first order."""
    return unpacked(observed, 2 * packed(observed) - packed(term.removed(observed)))
