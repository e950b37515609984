"""Select the effects that explain an experiment beyond its ordinary imperfections.

Forward selection with backward elimination. Candidates are ranked by linear columns; the best are judged by
the evidence of a self-calibration in which the spreads of all families and the scales of the noise are
estimated again. A family whose spread grew because of one member thus competes with that member as an effect
of its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tulip_testbed.calibration import reml
from tulip_testbed.calibration.calibration_result import CalibratedFamily, SelfCalibration
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.calibration.linearisation import mixing_of
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.candidate_search import (
    DECISIVE,
    MOST_TERMS,
    NEAR,
    CandidateSearch,
    Judged,
    at_best_time,
    at_estimate,
    calibrated_data,
    first_calibration,
    fit_in_addition,
    shortlist,
)
from tulip_testbed.discovery.candidates import MOST_PLACEMENTS, Candidate, Fitted
from tulip_testbed.discovery.columns import candidate_blocks
from tulip_testbed.discovery.detectability import WeaklyDetectable, single_level, weakly_detectable
from tulip_testbed.discovery.evidence import fitted_and_counted, sidak
from tulip_testbed.discovery.excessive_noise import excessive_noise
from tulip_testbed.discovery.joint_fit import Data, JointFit, joint_fit
from tulip_testbed.discovery.pure_error import pure_error, widened
from tulip_testbed.discovery.unusual_members import WIDEST, too_wide, with_unusual_members
from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.identification.residual_noise import noise_of

LEVEL = 0.005  # of the test of all effects, and of that of the four channels: 0.01 in all

AGAIN = 4  # alternatives of each term, at most, that are compared by self-calibration
RANKED = 12  # candidates that are kept for each term, however far behind


class Chosen(NamedTuple):
    """Effects that were chosen, their calibration, and whether no further one is known to be decisive."""

    calibration: SelfCalibration
    terms: tuple[Fitted, ...]
    complete: bool


@dataclass(frozen=True)
class LackOfFit:
    """The chi-square test of one channel.

    Attributes:
        chi_square, dof, p: of its residuals alone, with the base parameters fitted to it.
    """

    channel: str
    chi_square: float
    dof: int
    p: float


@dataclass(frozen=True)
class Selection:
    """The effects that were selected.

    Attributes:
        first: ordinary imperfections without effects. calibration: in addition to the selected effects.
        tolerances: as asked for.
        complete: whether no further candidate is decisive. ended: by what budget the search ended, or "".
        fit: of the selected effects, with the ordinary imperfections as background. null: without either.
        alternatives: what else might explain each term, the best first; itself among them. By predictions,
            the nearest by self-calibration if nothing is left unexplained.
        runners_up: of each term, the best of all candidates by linear predictions, the best first.
        lack_of_fit: of each channel if everything were exact.
        p: probability of as strong an effect among noise alone, over all candidates.
        tests: effective number of independent tests among the candidates.
        undetectable: candidates that the experiment cannot show.
        weak: candidates that it shows only if they are larger than plausible.
    """

    first: SelfCalibration
    calibration: SelfCalibration
    tolerances: Mapping[str, float] | None
    complete: bool
    fit: JointFit
    null: JointFit
    alternatives: tuple[tuple[Fitted, ...], ...]
    runners_up: tuple[tuple[Fitted, ...], ...]
    lack_of_fit: tuple[LackOfFit, ...]
    p: float
    tests: float
    undetectable: tuple[Candidate, ...]
    weak: tuple[WeaklyDetectable, ...]
    ended: str = ""

    @property
    def lacks_fit(self) -> bool:
        """Whether noise as it is stated does not explain the experiment, at 1 % in all."""
        least = min(test.p for test in self.lack_of_fit)
        alone = self.p < LEVEL or least < LEVEL / len(self.lack_of_fit)
        return alone or bool(excessive_noise(self.first))

    @cached_property
    def unexplained(self) -> tuple[str, ...]:
        """Say what is left unexplained however the effects are fitted."""
        if not self.lacks_fit:
            return ()
        out = [f"The search ended at its budget of {self.ended}."] if self.ended else []
        out += [] if self.complete else ["Another effect would still be decisive."]
        out += [] if self.calibration.steady else ["The estimate did not come to rest."]
        out += [
            f"The family {one.family.name} is {one.spread:.0f} times as wide as its tolerance: "
            "that is not usual."
            for one in too_wide(self.calibration)
            if not _may_be_usual(self.calibration, one)
        ]
        return (*out, *excessive_noise(self.calibration))


def lack_of_fit(data: Data) -> tuple[LackOfFit, ...]:
    """Test each channel by itself."""
    out = []
    for channel in "AFTC":
        linear = linear_model(data.observed, data.noise, channel)
        if linear.dof > 0:
            p = float(chi2_sf(linear.chi_square, linear.dof))
            out.append(LackOfFit(channel, linear.chi_square, linear.dof, p))
    return tuple(out)


def select(
    search: CandidateSearch,
    first: SelfCalibration,
    rng: np.random.Generator,
    progress: Callable[[int], None] = lambda count: None,
) -> Selection:
    """Select the effects of an experiment.

    Args:
        first: calibration without effects.
        rng: for the number of independent tests.
        progress: called with 1 after every step.
    """
    observed, calibration = search.observed, first
    stated = noise_of(observed)  # with placements that scatter as much as they do
    stated = replace(stated, plates=np.maximum(stated.plates, calibration.noise.plates))
    repeats = pure_error(calibration.observed, calibration.theta, stated)
    exact = Data(observed, widened(calibration.observed, stated, repeats))
    null = exact.null
    blocks = candidate_blocks(null.linear, search.candidates)
    fits, tests = fitted_and_counted(blocks, null.residual, rng)
    ranking = sorted(fits, key=lambda fit: -fit.log_bayes_factor)
    count = len(np.unique(observed.measurements.placement))
    # Placements that are not sought one by one were tests too: those that are stood out among them.
    tests += max(count - MOST_PLACEMENTS, 0)
    selection = Selection(
        first=first,
        calibration=calibration,
        tolerances=search.tolerances,
        complete=True,
        fit=null,
        null=null,
        alternatives=(),
        runners_up=(),
        lack_of_fit=lack_of_fit(exact),
        p=min((sidak(fit.p, tests) for fit in ranking), default=1.0),
        tests=tests,
        undetectable=tuple(fit.candidate for fit in ranking if not fit.detectable),
        weak=weakly_detectable(fits, single_level(LEVEL, tests)),
    )
    progress(1)
    if selection.lacks_fit:
        selection = _selected(search, selection, calibration, (), progress)
    progress(1)
    return selection


def select_without(search: CandidateSearch, selection: Selection, dropped: Sequence[str]) -> Selection:
    """Select again, beginning with the effects that were selected but for some.

    Args:
        search: without the dropped ones among its candidates.
        dropped: labels of effects that do not hold.
    """
    terms = tuple(term for term in selection.fit.terms if term.label not in dropped)
    left = search.tried(terms, selection.first) if terms else None
    if left is None:
        return _selected(search, selection, selection.first, ())
    calibration = search.calibrated(left)
    return _selected(search, selection, calibration, at_estimate(left.terms, calibration))


def _selected(
    search: CandidateSearch,
    selection: Selection,
    calibration: SelfCalibration,
    terms: tuple[Fitted, ...],
    progress: Callable[[int], None] = lambda count: None,
) -> Selection:
    """Add effects to some terms, whose calibration is given, until none is decisive."""
    found = _forward(search, selection.null, calibration, terms, selection.tests, progress)
    if len(found.terms) == MOST_TERMS and not search.budget.spent:
        found = _begun_otherwise(search, selection, calibration, terms, found, progress)
    calibration, terms, complete = found
    calibration, terms = with_unusual_members(search, calibration, terms)
    fit, _ = search.fits(calibration, terms)
    others = [alternatives_of(search, fit, k) for k in range(len(terms))]
    selection = replace(
        selection,
        calibration=calibration,
        complete=complete,
        fit=fit,
        alternatives=tuple(near for near, _ in others),
        runners_up=tuple(ranked for _, ranked in others),
        ended=str(search.budget) if search.budget.spent else "",
    )
    if selection.unexplained:
        return selection
    near = (judged_again(search, calibration, fit, k, each) for k, (each, _) in enumerate(others))
    return replace(selection, alternatives=tuple(near))


def _begun_otherwise(
    search: CandidateSearch,
    selection: Selection,
    start: SelfCalibration,
    terms: tuple[Fitted, ...],
    found: Chosen,
    progress: Callable[[int], None],
) -> Chosen:
    """Search again without the effect that was chosen first, and return what has more evidence.

    Where all effects that may be adopted do not suffice, the first may have stood for several others: for two
    plays, the best single effect is none of them.

    Args:
        start, terms: where the search began. found: how it ended.
    """
    known = {term.label for term in terms}
    first = next((term.label for term in found.terms if term.label not in known), None)
    if first is None:
        return found
    fewer = replace(search, candidates=[one for one in search.candidates if one.label != first])
    again = _forward(fewer, selection.null, start, terms, selection.tests, progress)
    if again.complete:  # unless the first is decisive in addition
        again = _forward(search, selection.null, again.calibration, again.terms, selection.tests, progress)
    judged = [search.tried(one.terms, start) for one in (found, again)]
    order = [
        (False, -np.inf) if one is None else (one.steady and one.possible, one.evidence) for one in judged
    ]
    return again if order[1] > order[0] else found


def _forward(
    search: CandidateSearch,
    null: JointFit,
    calibration: SelfCalibration,
    terms: tuple[Fitted, ...],
    tests: float,
    progress: Callable[[int], None],
) -> Chosen:
    """Add the best candidate, or pair, while it is decisive."""
    before = []
    while len(terms) < MOST_TERMS and not search.budget.spent:
        plain = search.tried(terms, calibration)
        before_all = search.evidence(calibration, terms, calibration) if plain is None else plain.evidence
        near = search.best(calibration, terms)
        # A large effect distorts the members so far that it hides among them.
        afresh = [] if terms else search.shortest(null)
        every = search.judged_of(terms, near, afresh, calibration)
        progress(1)
        decisive = [one for one in every if is_decisive(one, before_all, tests)]
        if not decisive and len(terms) + 2 <= MOST_TERMS:
            pairs = search.pairs(calibration, terms)
            decisive = [one for one in pairs if is_decisive(one, before_all, tests, together=2)]
        if not decisive:
            return Chosen(calibration, terms, complete=True)
        best = _without_idle(search, best_by_itself(search, decisive, calibration), calibration)
        if {term.label for term in best.terms} in before:
            break
        before.append({term.label for term in best.terms})
        calibration, terms = _at_best_times(search, search.calibrated(best), best.terms)
    return Chosen(calibration, terms, complete=search.budget.spent)


def best_by_itself(search: CandidateSearch, judged: Sequence[Judged], start: SelfCalibration) -> Judged:
    """Return the best by the evidence, those near it compared by the covariance that is their own.

    In that of the start, a wide family of compliances may have made noise of the loads of what a softer joint
    then seems to explain.
    """
    best = max(judged, key=lambda one: (one.steady, one.evidence))
    near = [one for one in judged if one.steady == best.steady and one.evidence > best.evidence - NEAR]
    if len(near) == 1:
        return best
    return max(near, key=lambda one: search.evidence(search.calibrated(one), one.terms, start))


def _without_idle(search: CandidateSearch, best: Judged, start: SelfCalibration) -> Judged:
    """Eliminate terms that the newest has made idle.

    The evidence for effects that did not come to rest says little of the others: they are judged again where
    these do.
    """
    best = search.without_idle(best, start)
    if best.steady:
        return best
    rests = search.calibrated(best)
    again = search.tried(best.terms, rests)
    return best if again is None else search.without_idle(again, rests)


def _at_best_times(
    search: CandidateSearch, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> tuple[SelfCalibration, tuple[Fitted, ...]]:
    """Search for all times again, given everything else that is known, until none moves.

    A time was chosen when other effects were still missing, which a wrong time imitates.

    Args:
        calibration: with the terms.
    """
    terms = at_estimate(terms, calibration)
    for _ in range(MOST_TERMS):
        data = calibrated_data(search.observed, calibration)
        moved = terms
        for k, term in enumerate(terms):
            if (timed := term.candidate.time_parameter) is None:
                continue
            again = at_best_time(joint_fit(data, moved[:k] + moved[k + 1 :]), term)
            if again.values[timed] != term.values[timed]:
                moved = (*moved[:k], again, *moved[k + 1 :])
        if moved is terms or search.budget.spent:
            break
        before, after = search.tried(terms, calibration), search.tried(moved, calibration)
        if before is None or after is None or not after.possible or after.evidence <= before.evidence:
            break
        calibration = search.calibrated(after)
        terms = at_estimate(after.terms, calibration)
    return calibration, terms


def is_decisive(found: Judged, before: float, tests: float, together: int = 1) -> bool:
    """Return whether the last effects gain more than noise would.

    Args:
        before: ln of the evidence without them.
        tests: effective number of independent tests among single candidates.
        together: how many effects were added at once.
    """
    gain = found.evidence - before
    decisive = gain >= together * DECISIVE
    return decisive and _chance(found.calibration, gain, tests**together, together) <= LEVEL


def _chance(found: SelfCalibration, gain: float, tests: float, together: int) -> float:
    """Compute the probability that noise alone gains as much by its last effects, over all candidates.

    The gain in ln of the evidence becomes that of the likelihood at the estimate: what the prior of
    `size_prior` takes from it is given back, most where a size is several times as large as plausible.
    """
    likelihood, count = gain, 0
    for last, error in zip(found.effects[-together:], found.effect_errors[-together:], strict=True):
        free = FreeEffect(last)
        volume, pull = np.maximum(free.prior_sd / error, 1.0), free.sizes / free.prior_sd
        likelihood += float(np.log(volume).sum() + 0.5 * pull @ pull) - free.log_tail
        count += max(len(free), 1)
    return sidak(float(chi2_sf(2 * max(likelihood, 0.0), count)), tests)


def _may_be_usual(calibration: SelfCalibration, one: CalibratedFamily) -> bool:
    """Return whether the likelihood admits that a family is as wide as its tolerance.

    Every family is tested, so each at its share of the level. The interval of a spread does not tell: where
    the readings hardly show the family, the likelihood is far from a normal one.
    """
    _, owner = mixing_of(calibration.all)
    mine = owner == [each.family.name for each in calibration.families].index(one.family.name)
    solved, count = calibration.solved, len(calibration.families)
    known = {*calibration.problem.known, *np.flatnonzero(mine).tolist()}
    held = replace(calibration.problem, known=tuple(sorted(known)))
    usual = np.where(mine, 1.0, solved.spreads)
    found, least = (reml.fit(held, (solved.scales, spreads)).value for spreads in (solved.spreads, usual))
    return float(chi2_sf(2 * max(least - found, 0.0), 1)) > LEVEL / count


def calibrated_with_best(
    search: CandidateSearch, terms: Sequence[Fitted], start: SelfCalibration
) -> SelfCalibration:
    """Calibrate with some effects, of which every one is chosen again, the others being kept.

    Another effect takes its place if the evidence for it is decisively better.
    """
    out = tuple(terms)
    instances = [term.instance for term in out]
    found = first_calibration(search.observed, search.tolerances, instances, start)
    if not out:
        return found
    data = calibrated_data(search.observed, found)
    for k in range(len(out)):
        adopted = joint_fit(data, out[:k] + out[k + 1 :])
        short = shortlist(adopted, search.ranked(adopted))
        own = fit_in_addition(adopted, out[k])
        if short and short[0].log_bayes_factor > own.log_bayes_factor + DECISIVE:
            out = (*out[:k], short[0], *out[k + 1 :])
    if [term.label for term in out] == [term.label for term in terms]:
        return found
    try:
        return self_calibrate(search.observed, search.tolerances, [term.instance for term in out], found)
    except np.linalg.LinAlgError:  # another choice by linear columns that no calibration bears out
        return found


def alternatives_of(
    search: CandidateSearch, found: JointFit, k: int
) -> tuple[tuple[Fitted, ...], tuple[Fitted, ...]]:
    """List what else would explain what term k explains, and the best of all by linear predictions."""
    others, term = found.without(k), found.terms[k]
    ranked = search.ranked(others)
    out = shortlist(others, ranked)
    if term.label not in [one.label for one in out]:
        out.append(replace(term, log_bayes_factor=fit_in_addition(others, term).log_bayes_factor))
    best = tuple(one for one in ranked[:RANKED] if one.detectable)
    return tuple(sorted(out, key=lambda one: -one.log_bayes_factor)), best


def judged_again(
    search: CandidateSearch,
    calibration: SelfCalibration,
    found: JointFit,
    k: int,
    alternatives: tuple[Fitted, ...],
) -> tuple[Fitted, ...]:
    """Compare the best alternatives of term k with it while families and noise are estimated with each.

    Those of the adopted term have made room for it: the family of tares is narrow if a tare was adopted, but
    has to be wide if a gain of the same cell explains the readings, and the other way round. A family that
    would be too wide with an alternative counts against it. The only member of a family is not judged again:
    it would stay in that family, and explain the readings from there.
    """
    if not found.terms[k].candidate.target:
        return alternatives
    search, terms = replace(search, widest=WIDEST), found.terms
    own = next(one for one in alternatives if one.label == terms[k].label)
    plain = search.tried(terms, calibration)
    least = max(alternatives[0].log_bayes_factor, own.log_bayes_factor) - NEAR
    others = [one for one in alternatives if one is not own and one.log_bayes_factor > least][:AGAIN]
    out = {one.label: one for one in alternatives}
    for one in others if plain is not None else ():
        judged = search.tried((*terms[:k], one, *terms[k + 1 :]), calibration)
        if plain is not None and judged is not None and judged.possible and judged.steady:
            more = judged.evidence - plain.evidence
            out[one.label] = replace(one, log_bayes_factor=own.log_bayes_factor + more)
    return tuple(sorted(out.values(), key=lambda one: -one.log_bayes_factor))
