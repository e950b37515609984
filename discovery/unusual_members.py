"""Members of a family that are too large for the others: they become effects of their own."""

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from tulip_testbed.calibration.calibration_result import HALF_95, CalibratedFamily, SelfCalibration
from tulip_testbed.discovery.candidate_search import (
    DECISIVE,
    MOST_TERMS,
    CandidateSearch,
    Judged,
    at_estimate,
)
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.loose_parts import hidden_joints, speaks_of
from tulip_testbed.effects.instance import effect_label

STANDS_OUT = 3.0  # largest of its family's spread and tolerance, beyond which a member is an effect
WIDEST = STANDS_OUT / HALF_95  # tolerances: s.d. of a spread of which 5 % lie beyond `STANDS_OUT`
SURE = float(ndtri(0.95))  # s.e. by which it has to lie beyond: its probability of doing so is 95 %
PAIRS = 6  # of members of a family, at most, that are judged of each ranking
OUTLYING, SLAB = 0.1, 10.0  # prior probability of a member unlike the others, and s.d. of such members
SPREADS = np.exp(np.linspace(-3.0, 3.0, 121))  # of the others, that are tried


def with_unusual_members(
    search: CandidateSearch, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> tuple[SelfCalibration, tuple[Fitted, ...]]:
    """Add the members that are too large for the others of their family, the largest first.

    A few members say little about the spread of a family: it grows with one of them, and the evidence hardly
    prefers an effect of its own, still less if there are two. The usual size is given by the tolerance and
    the other members then. Those of one family are added together, or else the largest alone. Of a family
    that is too wide, and whose members the data hardly distinguish, the one with the most evidence is added.
    A member without which a family that was too wide is as usual is added even if an evidence that believes
    in wide families is against it, unless that is not decisive and another family becomes too wide in its
    place; or else another effect or two members, see `_in_its_place`. The only member of a family is added
    regardless of the evidence.
    """
    refused: set[str] = set()
    while len(terms) < MOST_TERMS and not search.budget.spent:
        room = MOST_TERMS - len(terms)
        hidden = hidden_joints(calibration.linear.smooth, terms)
        found, wide = (
            [one for one in some if one.label not in refused and not speaks_of(one.candidate, hidden)]
            for some in (_unusual_members(search, calibration), _of_wide_families(search, calibration))
        )
        together = [one for one in found if one.candidate.effect is found[0].candidate.effect][:room]
        if found:
            tries = [together, together[:1]] if len(together) > 1 else [together]
            tried_in_vain = {found[0].label}
        elif wide:
            tries = [[one] for one in wide]
            tried_in_vain = {one.label for one in wide}
        elif _too_wide(calibration) and not refused:  # of no member that a search tries, such as a map
            tries, tried_in_vain = [], {""}
        else:
            break
        plain = search.tried(terms, calibration)
        if plain is None:
            break
        tried = [search.tried((*terms, *added), calibration) for added in tries]
        good = [one for one in tried if one is not None and one.possible]
        # Of a family with one member there is no doubt which is off, however implausible its size.
        name = tries[0][0].candidate.effect.name if tries else ""
        if any(len(one.family.targets) > 1 for one in calibration.families if one.family.name == name):
            before = set(_too_wide(calibration))
            usual = [name in before and before - {name} >= set(_too_wide(one.calibration)) for one in good]
            least = plain.evidence + (-DECISIVE if found else DECISIVE)
            near = [one.evidence > least for one in good]
            good = [one for one, *why in zip(good, usual, near, strict=True) if any(why)]
        good = good or ([] if found else _in_its_place(search, calibration, terms))
        if not good:
            refused |= tried_in_vain
        else:
            best = good[0] if found else max(good, key=lambda one: (one.steady, one.evidence))
            calibration = search.calibrated(best)
            terms = at_estimate(best.terms, calibration)
    return calibration, terms


def _in_its_place(
    search: CandidateSearch, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> list[Judged]:
    """Judge other effects, or else pairs of members of one family: of two that are off neither stands out.

    The family that they make too wide need not be their own: two tares look like gains of all cells, and a
    hoist like tares of all. They have to leave it as usual and to be decisive where a family that wide is
    seldom.
    """
    search, name = replace(search, widest=WIDEST), _too_wide(calibration)[0]
    plain, kinds = search.tried(terms, calibration), [one.family.name for one in calibration.families]
    least = np.inf if plain is None else plain.evidence + 2 * DECISIVE
    others = set(_too_wide(calibration)) - {name}

    def good(judged: list[Judged]) -> list[Judged]:
        sure = [one for one in judged if one.steady and one.evidence >= least]
        return [one for one in sure if others.issuperset(_too_wide(one.calibration))]

    if single := good(search.judged_of(terms, search.best(calibration, terms), [], calibration)):
        return single
    return good(search.pairs(calibration, terms, kinds, PAIRS)) if len(terms) + 2 <= MOST_TERMS else []


def too_wide(calibration: SelfCalibration) -> list[CalibratedFamily]:
    """List the families whose members as a whole are larger than is usual."""
    return [one for one in calibration.families if one.spread > STANDS_OUT and one.spread95[0] > 1]


def _too_wide(calibration: SelfCalibration) -> list[str]:
    return [one.family.name for one in too_wide(calibration)]


def _of_wide_families(search: CandidateSearch, calibration: SelfCalibration) -> list[Fitted]:
    """List the members of the first family that is too wide."""
    out = []
    for one in too_wide(calibration)[:1]:
        values = one.value.reshape(len(one.family.targets), -1)
        for target, value in zip(one.family.targets, values, strict=True):
            label = effect_label(one.family.name, target)
            out += [Fitted(c, 0, value) for c in search.candidates if c.label == label]
    return out


def _unusual_members(search: CandidateSearch, calibration: SelfCalibration) -> list[Fitted]:
    """List the members that are, by 95 %, too large for the others of their family, the largest first."""
    out = []
    for one in calibration.families:
        targets = one.family.targets
        usual_sizes = one.family.sizes.reshape(len(targets), -1)
        sizes = one.value.reshape(usual_sizes.shape) / usual_sizes
        errors = one.standard_error.reshape(sizes.shape) / usual_sizes
        known = one.determined.reshape(sizes.shape)
        plain, doubt = _without_prior(sizes, errors, one.spread)
        for k, target in enumerate(targets):
            usual = max(1.0, _usual_spread(np.delete(plain, k, axis=0), np.delete(doubt, k, axis=0)))
            least = np.where(known[k], np.abs(sizes[k]) - SURE * errors[k], 0.0)
            ratio = float(least.max()) / (STANDS_OUT * usual)
            label = effect_label(one.family.name, target)
            candidate = next((c for c in search.candidates if c.label == label), None)
            if ratio > 1 and candidate is not None:
                out.append((ratio, Fitted(candidate, 0, sizes[k] * usual_sizes[k])))
    return [fitted for _, fitted in sorted(out, key=lambda each: -each[0])]


def _without_prior(value: np.ndarray, error: np.ndarray, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Return members and their s.e. as the data alone say, from those with a normal prior."""
    information = np.maximum(1 / error**2 - 1 / spread**2, 1e-6 / error**2)
    return value / (error**2 * information), 1 / np.sqrt(information)


def _usual_spread(value: np.ndarray, error: np.ndarray) -> float:
    """Estimate the spread of members of which some may be unlike the others (spike and slab).

    A member has the spread tau of most, or with a small probability that of the slab; tau has the prior of a
    half-Cauchy about the tolerance. In a mean square, members that stand out would hide one another.

    Args:
        value, error: in tolerances.
    """
    z, s = value.ravel()[:, None], error.ravel()[:, None]
    densities = [np.exp(-0.5 * z**2 / (sd**2 + s**2)) / np.hypot(sd, s) for sd in (SPREADS, SLAB)]
    log = np.log((1 - OUTLYING) * densities[0] + OUTLYING * densities[1] + 1e-300).sum(axis=0)
    return float(SPREADS[(log + np.log(SPREADS / (1 + SPREADS**2))).argmax()])
