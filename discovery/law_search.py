"""Search laws where noise alone does not explain an experiment: greedily, with exchange, by the evidence.

Effects of the catalogue compete in the same search and win where they do as well. So do the families of
ordinary imperfections, but a family that is wider than usual has a price here: otherwise it takes up a fault
that nobody listed. Laws are ranked by linear columns; the best of each pair of what errs and as a function of
what are judged by self-calibration, and then the shapes of the best pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.discovery.candidate_search import (
    DECISIVE,
    RESTS,
    CandidateSearch,
    Judged,
    at_estimate,
    calibrated_data,
)
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.evidence import sidak
from tulip_testbed.discovery.joint_fit import JointFit, joint_fit
from tulip_testbed.discovery.law_candidates import is_law, ranked_and_counted, ranked_laws, with_best_points
from tulip_testbed.discovery.selection import LEVEL, Selection, alternatives_of, is_decisive, judged_again
from tulip_testbed.discovery.unusual_members import WIDEST, too_wide, with_unusual_members
from tulip_testbed.effects.laws import LAW

MOST_TERMS = 3
PAIRS = 6  # of what errs and as a function of what, that are judged
SHAPES = 4  # of the best pair
EXCHANGES = 2  # rounds in which every term is sought anew
MOST_JUDGED = 60  # after which nothing is exchanged: in a gross gap a judgement takes a second
NEAR, SHARE = 15.0, 0.6  # laws are judged above SHARE of the best ln Bayes factor by linear columns less NEAR


@dataclass(frozen=True)
class LawSelection:
    """Laws and effects that explain an experiment together.

    Attributes:
        search: with the laws that were found and their neighbours among its candidates.
        better: whether they do decisively better than the effects of the catalogue alone.
        disagreement: r.m.s. difference of the base parameters to those of an explanation that does as well,
            in standard errors, the largest.
    """

    search: CandidateSearch
    selection: Selection
    better: bool
    disagreement: float = 0.0


def left_to_laws(search: CandidateSearch, selection: Selection, laws: list[Candidate]) -> bool:
    """Return whether the effects of the catalogue leave anything that a law may explain.

    A law that does decisively better than they is decisive in addition to them: with no family wider and no
    noise larger than usual, and at a glance, which misses the evidence by no more than is decisive.
    """
    if not selection.lacks_fit:
        alone = ranked_laws(selection.null.linear, laws)
        return min((sidak(one.p, selection.tests) for one in alone), default=1.0) < LEVEL
    if not selection.complete or too_wide(selection.calibration):
        return True
    calibration, terms = selection.calibration, selection.fit.terms
    _, usual = search.fits(calibration, terms)
    near = [one for one in _promising(usual, laws) if one.log_bayes_factor >= DECISIVE]
    search = replace(search, widest=WIDEST)
    plain = search.glanced(terms, calibration) if near and calibration.moved < RESTS else None
    if plain is None:
        return bool(near)
    glances = (search.glanced((*terms, one), calibration) for one in near)
    return any(one is None or one.evidence > plain.evidence for one in glances)


def select_laws(
    search: CandidateSearch, selection: Selection, laws: list[Candidate], rng: np.random.Generator
) -> LawSelection | None:
    """Select laws and effects of the catalogue that explain an experiment together.

    Args:
        selection: of effects of the catalogue alone.
        laws: see `law_candidates`.
        rng: for the number of independent tests.

    Returns:
        None: noise alone explains the experiment, or no law is decisive.
    """
    search = replace(search, widest=WIDEST)
    start = selection.first
    linear = selection.null.linear
    alone, more = ranked_and_counted(linear, laws, rng)
    tests = selection.tests + more
    p = min((sidak(one.p, tests) for one in alone), default=1.0)
    if not selection.lacks_fit and p >= LEVEL:
        return None
    law_search = LawSearch(search, laws, alone, start, tests)
    found = _forward(law_search, selection)
    if found is None:
        return None
    near = _alternatives(law_search, found)
    for _ in range(EXCHANGES):
        if sum(map(len, law_search.known.values())) > MOST_JUDGED or search.budget.spent:
            break
        better = _exchanged(law_search, found, near)
        if better is None:
            break
        found = better
        near = _alternatives(law_search, found)
    if not any(is_law(term.candidate) for term in found.terms):
        return None
    calibration = search.calibrated(found)
    calibration, terms = with_unusual_members(search, calibration, at_estimate(found.terms, calibration))
    known = {one.label: one for several in near for one in several if is_law(one.candidate)}
    known |= {one.label: one for one in terms if is_law(one.candidate)}
    fit = joint_fit(calibrated_data(search.observed, calibration), terms)
    labels = [term.label for term in found.terms]
    alternatives = tuple(  # an unusual member is compared with others as where no law is needed
        near[labels.index(term.label)]
        if term.label in labels
        else judged_again(search, calibration, fit, k, alternatives_of(search, fit, k)[0])
        for k, term in enumerate(terms)
    )
    wider = replace(search, candidates=[*search.candidates, *(one.candidate for one in known.values())])
    chosen = replace(
        selection,
        calibration=calibration,
        complete=True,
        ended=str(search.budget) if search.budget.spent else "",
        fit=fit,
        alternatives=alternatives,
        runners_up=(),
        p=min(p, selection.p),
        tests=tests,
    )
    listed = search.tried(at_estimate(selection.fit.terms, selection.calibration), law_search.start)
    better = listed is None or found.evidence > listed.evidence + DECISIVE
    return LawSelection(wider, chosen, better, disagreement(found, as_good(law_search, found)))


def _forward(law_search: LawSearch, selection: Selection) -> Judged | None:
    """Add the best law or effect while it is decisive; None: there is none, or something decisive is left."""
    search, found = law_search.search, None
    terms: tuple[Fitted, ...] = ()
    calibration = law_search.start
    seen: list[set[str]] = []
    while len(terms) < MOST_TERMS and not search.budget.spent:
        before = search.evidence(calibration, terms, law_search.start)
        if terms and (plain := search.tried(terms, law_search.start)) is not None:
            before = plain.evidence
        tried = _judged_in_addition(law_search, terms, calibration, None if terms else selection)
        good = [one for one in tried if is_decisive(one, before, law_search.tests)]
        best = _preferred(good)
        if best is None:
            return found
        found = search.without_idle(best, law_search.start)
        labels = {term.label for term in found.terms}
        if labels in seen:  # two terms eliminate each other in turn
            return None
        seen.append(labels)
        calibration = search.calibrated(found)
        terms = at_estimate(found.terms, calibration)
    if found is None:  # at the end of the budget
        return None
    near = [*_near(law_search, calibration, terms), *search.best(calibration, terms)]
    more = search.judged_of(terms, near, [], law_search.start)
    return None if any(is_decisive(one, found.evidence, law_search.tests) for one in more) else found


def _judged_in_addition(
    law_search: LawSearch,
    terms: tuple[Fitted, ...],
    calibration: SelfCalibration,
    selection: Selection | None,
) -> list[Judged]:
    """Judge the most promising laws and effects in addition to some terms.

    Args:
        calibration: with the terms.
        selection: a large effect distorts the members so far that it hides among them; with the catalogue's
            selection, laws are also searched for as if everything were exact. None: they are not.
    """
    search, key = law_search.search, tuple(sorted(term.label for term in terms))
    if key in law_search.known:
        return law_search.known[key]
    near = [*_near(law_search, calibration, terms), *search.best(calibration, terms)]
    afresh: list[Fitted] = []
    if selection is not None:
        afresh = [*_pairs(law_search.alone)[: PAIRS // 2], *search.shortest(selection.null)]
    out = search.judged_of(terms, near, afresh, law_search.start)
    laws = [one for one in out if is_law(one.terms[-1].candidate)]
    best = max(laws, key=lambda one: (one.steady, one.evidence), default=None)
    law_search.known[key] = out if best is None else out + _other_shapes(law_search, terms, calibration, best)
    return law_search.known[key]


def _near(law_search: LawSearch, calibration: SelfCalibration, terms: tuple[Fitted, ...]) -> list[Fitted]:
    """List the most promising laws in addition to some terms, one of each pair.

    They are searched for with the spreads and the noise as estimated, and with none larger than usual.
    """
    out: dict[str, Fitted] = {}
    for fit in law_search.search.fits(calibration, terms):
        for one in _promising(fit, law_search.laws):
            out.setdefault(_pair(one), one)
    return list(out.values())


def _promising(fit: JointFit, laws: list[Candidate]) -> list[Fitted]:
    """List the best law of each of a few pairs in addition to a fit, but those of its terms."""
    if LAW not in fit.ranked:
        pairs = {_pair(term) for term in fit.terms}
        others = [law for law in laws if law.target.rpartition("/")[0] not in pairs]
        fit.ranked[LAW] = _pairs(ranked_laws(fit.partialled_out, others))[:PAIRS]
    return fit.ranked[LAW]


def _pair(one: Fitted) -> str:
    """Return what errs and as a function of what."""
    return one.candidate.target.rpartition("/")[0] if is_law(one.candidate) else one.label


def _pairs(ranked: list[Fitted]) -> list[Fitted]:
    """List the best law of each pair of what errs and as a function of what, of those that are close."""
    if not ranked or not ranked[0].detectable:
        return []
    least = max(SHARE * ranked[0].log_bayes_factor - NEAR, 0.0)
    out: dict[str, Fitted] = {}
    for one in ranked:
        if one.log_bayes_factor > least:
            out.setdefault(_pair(one), with_best_points(one))
    return list(out.values())


def _other_shapes(
    law_search: LawSearch, terms: tuple[Fitted, ...], calibration: SelfCalibration, best: Judged
) -> list[Judged]:
    """Judge the other shapes of a law."""
    law = best.terms[-1]
    alike = [
        other
        for other in law_search.laws
        if other.target.rpartition("/")[0] == _pair(law) and other.label != law.label
    ]
    linear = law_search.search.fits(calibration, terms)[0].partialled_out
    near = [with_best_points(one) for one in ranked_laws(linear, alike)[:SHAPES] if one.detectable]
    return law_search.search.judged_of(terms, near, [], law_search.start, best.evidence)


def _preferred(tried: list[Judged]) -> Judged | None:
    """Return the best; an effect of the catalogue that does as well as a law is preferred."""
    best = max(tried, key=lambda one: (one.steady, one.evidence), default=None)
    if best is None or not is_law(best.terms[-1].candidate):
        return best
    listed = [
        one
        for one in tried
        if not is_law(one.terms[-1].candidate) and one.evidence > best.evidence - DECISIVE and one.steady
    ]
    return max(listed, key=lambda one: one.evidence, default=best)


def _alternatives(law_search: LawSearch, found: Judged) -> tuple[tuple[Fitted, ...], ...]:
    """Judge what else would explain what each term explains, with the other terms kept; the best first."""
    out = []
    for k, term in enumerate(found.terms):
        others = found.terms[:k] + found.terms[k + 1 :]
        plain = law_search.search.tried(others, law_search.start)
        before = (
            law_search.search.evidence(law_search.start, (), law_search.start)
            if plain is None
            else plain.evidence
        )
        calibration = law_search.start if plain is None else plain.calibration
        several = _judged_in_addition(law_search, others, calibration, None)
        best: dict[str, Fitted] = {_pair(term): replace(term, log_bayes_factor=found.evidence - before)}
        for one in sorted(several, key=lambda one: -one.evidence):
            if one.steady:
                last = replace(one.terms[-1], log_bayes_factor=one.evidence - before)
                if _pair(last) not in best or best[_pair(last)].log_bayes_factor < last.log_bayes_factor:
                    best[_pair(last)] = last
        out.append(tuple(sorted(best.values(), key=lambda one: -one.log_bayes_factor)))
    return tuple(out)


def _exchanged(law_search: LawSearch, found: Judged, near: tuple[tuple[Fitted, ...], ...]) -> Judged | None:
    """Exchange a term for a better one, or for an effect that does as well; None: no exchange is better."""
    for k, several in enumerate(near):
        own = next((one for one in several if one.label == found.terms[k].label), None)
        best = several[0]
        listed = [one for one in several if one.candidate.effect.name != LAW]
        if listed and listed[0].log_bayes_factor > best.log_bayes_factor - DECISIVE:
            best = listed[0]
        if own is None or best.label != own.label:
            terms = (*found.terms[:k], best, *found.terms[k + 1 :])
            again = law_search.search.tried(terms, law_search.start)
            if again is not None and again.possible:
                return again
    return None


@dataclass(frozen=True)
class LawSearch:
    """A search for laws.

    Attributes:
        alone: the laws ranked as if everything else were exact.
        start: without laws or effects.
        tests: effective number of independent tests among the candidates of the catalogue and the laws.
        known: what was judged before in addition to some terms, by their labels.
    """

    search: CandidateSearch
    laws: list[Candidate]
    alone: list[Fitted]
    start: SelfCalibration
    tests: float
    known: dict[tuple[str, ...], list[Judged]] = field(default_factory=dict)


def as_good(law_search: LawSearch, found: Judged) -> list[Judged]:
    """List what was judged to do as well with as many terms, all but one of them the same."""
    labels = {term.label for term in found.terms}
    return [
        one
        for several in law_search.known.values()
        for one in several
        if one.steady
        and one.evidence > found.evidence - DECISIVE
        and len(one.terms) == len(found.terms)
        and len(labels - {term.label for term in one.terms}) <= 1
    ]


def disagreement(found: Judged, others: Sequence[Judged]) -> float:
    """Compute how far others' base parameters lie from those that were found.

    Returns:
        the largest root mean square, in standard errors; 0: there are no others.
    """
    error = np.sqrt(np.diag(found.calibration.covariance))
    off = [(one.calibration.theta - found.calibration.theta) / error for one in others]
    return max((float(np.sqrt((one**2).mean())) for one in off), default=0.0)
