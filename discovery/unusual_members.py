"""Members of a family that are too large for the others: they become effects of their own."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.discovery.candidate_search import DECISIVE, MOST_TERMS, Search, at_estimate
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.effects.instance import effect_label

STANDS_OUT = 3.0  # largest of its family's spread and tolerance, beyond which a member is an effect
SURE = float(ndtri(0.95))  # s.e. by which it has to lie beyond: its probability of doing so is 95 %
NORMAL_SD = 1.4826  # s.d. of a normal distribution over the median of its absolute value


def with_unusual_members(
    search: Search, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> tuple[SelfCalibration, tuple[Fitted, ...]]:
    """Add the members that are too large for the others of their family, the largest first.

    A few members say little about the spread of a family: it grows with one of them, and the evidence hardly
    prefers an effect of its own, still less if there are two. What is usual is said by the tolerance and the
    other members then. Those of one family are added together, or else the largest alone.
    """
    refused: set[str] = set()
    while True:
        found = [one for one in _unusual_members(search, calibration) if one.label not in refused]
        if not found or len(terms) >= MOST_TERMS:
            return calibration, terms
        plain = search.tried(terms, calibration)
        if plain is None:
            return calibration, terms
        alike = [one for one in found if one.candidate.effect is found[0].candidate.effect]
        together = alike[: MOST_TERMS - len(terms)]
        for added in [together, together[:1]] if len(together) > 1 else [together]:
            tried = search.tried((*terms, *added), calibration)
            if tried is not None and tried.possible and tried.evidence > plain.evidence - DECISIVE:
                calibration = search.calibrated(tried)
                terms = at_estimate(tried.terms, calibration)
                break
        refused.add(found[0].label)


def _unusual_members(search: Search, calibration: SelfCalibration) -> list[Fitted]:
    """List the members that are too large for the others of their family, the largest first.

    The data determine them, and say with 95 % probability that they are.
    """
    out = []
    for one in calibration.families:
        targets = one.family.targets
        sizes = one.value.reshape(len(targets), -1) / one.family.tolerance
        errors = one.standard_error.reshape(sizes.shape) / one.family.tolerance
        known = one.determined.reshape(sizes.shape)
        for k, target in enumerate(targets):
            others = np.delete(sizes, k, axis=0)
            # The median, since several that stand out would hide one another in a mean square.
            usual = max(1.0, NORMAL_SD * float(np.median(np.abs(others)))) if others.size else 1.0
            least = np.where(known[k], np.abs(sizes[k]) - SURE * errors[k], 0.0)
            ratio = float(least.max()) / (STANDS_OUT * usual)
            label = effect_label(one.family.name, target)
            candidate = next((c for c in search.candidates if c.label == label), None)
            if ratio > 1 and candidate is not None:
                out.append((ratio, Fitted(candidate, 0, sizes[k] * one.family.tolerance)))
    return [fitted for _, fitted in sorted(out, key=lambda each: -each[0])]
