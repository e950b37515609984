"""The result of a discovery, as it is recorded and compared with the truth."""

from __future__ import annotations

import numpy as np

from tulip_testbed.discovery.discover import AMBIGUOUS, NAMED, Discovery
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.benchmark.case_outcome import Found
from tulip_testbed.identification.distributions import t_ppf


def found_effects(found: Discovery) -> tuple[Found, ...]:
    """Return the effects that stand out, the best first."""
    return tuple(_found(found, k) for k in found.effects)


def _found(found: Discovery, k: int) -> Found:
    term, instance = found.fit.terms[k], with_intervals(found.fit, k)
    low, high = zip(*(interval or (None, None) for interval in instance.intervals), strict=True)
    alike = tuple(one.label for one in found.equivalents[k])
    return Found(term.label, term.values, low, high, alike)


def calibrated_members(found: Discovery) -> tuple[Found, ...]:
    """Return the ordinary imperfections, that with the most standard errors first."""
    out = []
    for one in found.calibrated:
        known = [(v, i) for v, i in zip(one.values, one.intervals, strict=True) if i is not None]
        clearest = max((abs(v) / max(high - low, 1e-300) for v, (low, high) in known), default=0.0)
        low, high = zip(*(interval or (None, None) for interval in one.intervals), strict=True)
        out.append((clearest, Found(one.label, one.values, low, high, ())))
    return tuple(one for _, one in sorted(out, key=lambda each: -each[0]))


def covered(found: Discovery, hidden: EffectInstance, of_time: bool) -> tuple[bool, ...]:
    """Return whether the interval of each size, or time, of a correctly named effect holds the truth."""
    effect, out = hidden.effect, []
    if found.verdict not in (NAMED, AMBIGUOUS):
        return ()
    wanted = [k for k in range(len(effect.parameters)) if (k not in effect.sizes) == of_time]
    for k in found.effects:
        if found.fit.terms[k].label == hidden.label:
            intervals = with_intervals(found.fit, k).intervals
            pairs = [(intervals[at], hidden.values[at]) for at in wanted]
            out += [interval[0] <= true <= interval[1] for interval, true in pairs if interval]
    return tuple(out)


def members_covered(found: Discovery, hidden: tuple[EffectInstance, ...]) -> tuple[bool, ...]:
    """Return whether the interval of each ordinary imperfection holds the truth; not hidden: zero."""
    true = {one.label: one.values for one in hidden}
    out = []
    for one in found.calibrated:
        values = true.get(one.label, (0.0,) * len(one.values))
        out += [i[0] <= v <= i[1] for v, i in zip(values, one.intervals, strict=True) if i]
    return tuple(bool(held) for held in out)


def base_covered(found: Discovery, truth: np.ndarray) -> tuple[bool, ...]:
    """Return whether the 95 % interval of each base parameter holds the truth."""
    calibration = found.selection.calibration
    half = t_ppf(0.975, calibration.interval_dof) * np.sqrt(np.diag(calibration.covariance))
    return tuple((np.abs(calibration.theta - truth) <= half).tolist())
