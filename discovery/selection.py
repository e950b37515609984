"""Select the effects that explain an experiment: forward selection with backward elimination."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import Candidate, Fitted, candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.evidence import effective_tests, ranked, sidak
from tulip_testbed.discovery.joint_fit import Data, JointFit, joint_fit
from tulip_testbed.discovery.refit import refit
from tulip_testbed.discovery.shortlist import best_addition, fit_in_addition, shortlist
from tulip_testbed.effects.effect import Effect
from tulip_testbed.identification.distributions import chi2_sf

LEVEL = 0.005  # of the test of all effects, and of that of the four channels: 0.01 in all
DECISIVE = 3.0  # ln of the Bayes factor, below which two explanations are equivalent
MOST_TERMS = 4


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
        fit: of the selected effects. null: without any effect.
        alternatives: what else might explain each term, by predictions, the best first; itself among them.
        lack_of_fit: of each channel without any effect.
        p: probability of as strong an effect among noise alone, over all candidates.
        undetectable: candidates that the experiment cannot show.
    """

    fit: JointFit
    null: JointFit
    alternatives: tuple[tuple[Fitted, ...], ...]
    lack_of_fit: tuple[LackOfFit, ...]
    p: float
    undetectable: tuple[Candidate, ...]

    @property
    def lacks_fit(self) -> bool:
        """Whether the nominal model does not explain the experiment, at 1 % in all."""
        least = min(test.p for test in self.lack_of_fit)
        return self.p < LEVEL or least < LEVEL / len(self.lack_of_fit)


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
    data: Data,
    rng: np.random.Generator,
    effects: dict[str, Effect] | None = None,
    through_laboratory: bool = True,
    progress: Callable[[int], None] = lambda count: None,
) -> Selection:
    """Select the effects of an experiment.

    Args:
        rng: for the number of independent tests.
        effects: the catalogue by name; all of it if None.
        through_laboratory: before a second effect is added, fit the first one through the laboratory, which
            may explain by it what its prediction does not.
        progress: called with 1 after every step.
    """
    null, among = data.null, candidates(data.observed, effects)
    columns = candidate_columns(null.linear, among)
    search = _Search(null, among, ranked(columns, null.residual), effective_tests(columns, rng))
    selection = Selection(
        fit=null,
        null=null,
        alternatives=(),
        lack_of_fit=lack_of_fit(data),
        p=min((sidak(one.p, search.tests) for one in search.first), default=1.0),
        undetectable=tuple(one.candidate for one in search.first if not one.detectable),
    )
    progress(1)
    if selection.lacks_fit:
        found = _forward(search, through_laboratory, progress)
        alternatives = tuple(_alternatives(search, found, k) for k in range(len(found.terms)))
        selection = replace(selection, fit=found, alternatives=alternatives)
    progress(1)
    return selection


@dataclass(frozen=True)
class _Search:
    """What a selection needs at every step.

    Attributes:
        first: all candidates, ranked without any effect.
        tests: effective number of independent tests among them.
    """

    null: JointFit
    candidates: list[Candidate]
    first: list[Fitted]
    tests: float

    def ranked(self, adopted: JointFit) -> list[Fitted]:
        """Rank all other candidates in addition to the adopted terms."""
        if not adopted.terms:
            return self.first
        others = [candidate for candidate in self.candidates if candidate.label not in adopted.labels]
        linear = adopted.partialled_out
        return ranked(candidate_columns(linear, others), linear.residual)

    def p(self, adopted: JointFit, best: Fitted, ranking: list[Fitted]) -> float:
        """Compute the probability of as large a gain by chance, over all candidates.

        The gain is that by linear columns or without linearising, whichever is larger, because the latter
        shrinks sizes towards zero.
        """
        gain = fit_in_addition(adopted, best).gain
        p = float(chi2_sf(max(gain, 0.0), max(len(best.sizes), 1)))
        (linear,) = (one.p for one in ranking if one.label == best.label)
        return sidak(min(p, linear), self.tests)


def _forward(search: _Search, through_laboratory: bool, progress: Callable[[int], None]) -> JointFit:
    """Add the best candidate while it is decisive; after each step eliminate terms that are not."""
    found, ranking = search.null, search.first
    exact, model_error, before = not through_laboratory, None, []
    while len(found.terms) < MOST_TERMS:
        best = best_addition(found, ranking, model_error)
        if best is None or best[0].log_bayes_factor < DECISIVE or search.p(found, best[0], ranking) > LEVEL:
            break
        if found.terms and not exact:
            refitted, exact = refit(found), True
            if refitted[0] is not found:
                found, model_error = refitted
                ranking = search.ranked(found)
                continue
        tried = _backward(best[1] or joint_fit(found.data, (*found.terms, best[0])))
        progress(1)
        before.append(set(found.labels))
        if set(tried.labels) in before:
            break
        found, exact, model_error = tried, not through_laboratory, None
        ranking = search.ranked(found)
    found = _pairs_merged(search, found)
    return _one_effect_a_target(found) if through_laboratory else found


def _backward(found: JointFit) -> JointFit:
    """Eliminate the terms that are not decisive in addition to the others, the least decisive first."""
    while len(found.terms) > 1:
        factors = [
            fit_in_addition(found.without(k), term).log_bayes_factor for k, term in enumerate(found.terms)
        ]
        least = int(np.argmin(factors))
        if factors[least] >= DECISIVE:
            return found
        found = found.without(least)
    return found


def _pairs_merged(search: _Search, found: JointFit) -> JointFit:
    """Replace two terms by one that explains as much; forward selection may start with a look-alike."""
    pairs = list(combinations(found.terms, 2))
    enough = found.repeated.log_evidence - DECISIVE if pairs else 0.0
    for pair in pairs:
        others = joint_fit(found.data, [term for term in found.terms if term not in pair])
        best = best_addition(others, search.ranked(others))
        if best is None:
            continue
        single = best[1] or joint_fit(found.data, (*others.terms, best[0]))
        if single.log_evidence > enough:
            return _pairs_merged(search, single)
    return found


def _one_effect_a_target(found: JointFit) -> JointFit:
    """Of several effects on one target, keep the one that in the laboratory explains as much as all.

    A prediction that misses a part of its effect leaves something for a second effect on the same target.
    """
    targets = [term.candidate.target for term in found.terms]
    for target in sorted({t for t in targets if t and targets.count(t) > 1}):
        mine = [term for term in found.terms if term.candidate.target == target]
        others = tuple(term for term in found.terms if term.candidate.target != target)
        together, _ = refit(found)
        singles = [refit(joint_fit(found.data, (*others, term)))[0] for term in mine]
        best = max(singles, key=lambda single: single.log_evidence)
        if best.log_evidence > together.log_evidence - DECISIVE:
            found = best
    return found


def _alternatives(search: _Search, found: JointFit, k: int) -> tuple[Fitted, ...]:
    """List what else would explain what term k explains, with the other terms kept; the best first."""
    others, term = found.without(k), found.terms[k]
    out = shortlist(others, search.ranked(others))
    if term.label not in [one.label for one in out]:
        out.append(replace(term, log_bayes_factor=fit_in_addition(others, term).log_bayes_factor))
    return tuple(sorted(out, key=lambda one: -one.log_bayes_factor))
