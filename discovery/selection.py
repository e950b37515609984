"""Which effects explain an experiment: forward steps, looked back upon, and what else would do as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.discovery.evidence import Field, Score, adjusted, family, field, scores
from tulip_testbed.discovery.fit import Fit, fit, search
from tulip_testbed.discovery.linear_model import linear_model
from tulip_testbed.discovery.ranking import Rival, about_fit, again, best_of, price, worth
from tulip_testbed.discovery.refit import refit
from tulip_testbed.effects.effect import Effect
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_noise import Noise

LEVEL = 0.005  # of the effects' family, and of the four channels together: 0.01 in all
DECISIVE = 3.0  # ln of the Bayes factor below which two explanations are alike
MOST_TERMS = 4


@dataclass(frozen=True)
class Gap:
    """One channel against its noise.

    Attributes:
        chi_square, freedom, p: of its residuals alone, the base parameters fitted to it.
    """

    channel: str
    chi_square: float
    freedom: int
    p: float


@dataclass(frozen=True)
class Explanation:
    """What was found.

    Attributes:
        found: the adopted terms, fitted. before: without any.
        rivals: for every term what else might explain it, by formulas, the best first; itself among them.
        gaps: by channel, before.
        alarm: probability of as strong an effect among noise alone, over all candidates.
        undetectable: candidates that these postures cannot show.
    """

    found: Fit
    before: Fit
    rivals: tuple[tuple[Rival, ...], ...]
    gaps: tuple[Gap, ...]
    alarm: float
    undetectable: tuple[Candidate, ...]


def gaps_of(observed: Observation, noise: Noise) -> tuple[Gap, ...]:
    """Every channel by itself."""
    out = []
    for channel in "AFTC":
        linear = linear_model(observed, noise, channel)
        size, freedom = float(linear.residual @ linear.residual), linear.freedom
        if freedom > 0:
            out.append(Gap(channel, size, freedom, float(chi2.sf(size, freedom))))
    return tuple(out)


def explain(
    observed: Observation,
    noise: Noise,
    rng: np.random.Generator,
    effects: dict[str, Effect] | None = None,
    through_laboratory: bool = True,
    progress: Callable[[int], None] = lambda count: None,
) -> Explanation:
    """Find the effects of an experiment.

    Args:
        effects: the catalogue by name; all of it if None.
        through_laboratory: before a second effect is taken on, see whether the laboratory explains by the
            first what its formula does not.
        progress: called with 1 after every step.
    """
    among = candidates(observed, effects)
    before = fit(observed, noise, ())
    gaps = gaps_of(observed, noise)
    board = field(before.linear, among)
    tests = family(board, rng)
    ranked = scores(board, before.residual)
    undetectable = tuple(s.candidate for s in ranked if not s.visible)
    alarm = min(adjusted(s.p, tests) for s in ranked) if ranked else 1.0
    progress(1)
    found = before
    if alarm < LEVEL or min(gap.p for gap in gaps) < LEVEL / len(gaps):
        found = _forward(observed, noise, among, before, ranked, tests, through_laboratory, progress)
    rivals = tuple(_alternatives(observed, noise, among, found, k) for k in range(len(found.terms)))
    progress(1)
    return Explanation(found, before, rivals, gaps, alarm, undetectable)


def _forward(
    observed: Observation,
    noise: Noise,
    among: list[Candidate],
    found: Fit,
    ranked: list[Score],
    tests: float,
    through_laboratory: bool,
    progress: Callable[[int], None],
) -> Fit:
    """Add the best explanation as long as one is decisive, look back after every step."""
    exact, bend, before = not through_laboratory, None, []
    while len(found.terms) < MOST_TERMS:
        best = best_of(observed, noise, found, ranked, bend)
        if best is None or best.log_bayes_factor < DECISIVE or _chance(found, best, ranked, tests) > LEVEL:
            break
        if found.terms and not exact:
            found, bend = refit(observed, noise, found)
            ranked, exact = _ranked_after(found, among), True
            continue
        tried = _look_back(observed, noise, fit(observed, noise, (*found.terms, best.term)))
        progress(1)
        before.append({t.candidate.label for t in found.terms})
        if {t.candidate.label for t in tried.terms} in before:
            break
        found, exact, bend = tried, not through_laboratory, None
        ranked = _ranked_after(found, among)
    found = _fewer(observed, noise, among, found)
    return _alone(observed, noise, found) if through_laboratory else found


def _fewer(observed: Observation, noise: Noise, among: list[Candidate], found: Fit) -> Fit:
    """Two terms replaced by one that explains as much: steps forward may have begun with a look-alike."""
    pairs = list(combinations(found.terms, 2))
    enough = worth(fit(observed, noise, found.terms)) - DECISIVE if pairs else 0.0
    for pair in pairs:
        others = fit(observed, noise, [term for term in found.terms if not any(term is one for one in pair)])
        best = best_of(observed, noise, others, _ranked_after(others, among))
        if best is None:
            continue
        single = fit(observed, noise, (*others.terms, best.term))
        if worth(single) > enough:
            return _fewer(observed, noise, among, single)
    return found


def _alone(observed: Observation, noise: Noise, found: Fit) -> Fit:
    """Of two effects of one target, the one that the laboratory shows to do the work of both.

    A formula that misses part of its effect leaves something for its neighbour.
    """
    targets = [term.candidate.target for term in found.terms]
    for target in sorted({t for t in targets if t and targets.count(t) > 1}):
        mine = [term for term in found.terms if term.candidate.target == target]
        others = tuple(term for term in found.terms if term.candidate.target != target)
        both, _ = refit(observed, noise, found)
        singles = [refit(observed, noise, fit(observed, noise, (*others, term)))[0] for term in mine]
        best = max(singles, key=worth)
        if worth(best) > worth(both) - DECISIVE:
            found = best
    return found


def _chance(found: Fit, best: Rival, ranked: list[Score], tests: float) -> float:
    """Probability of as large a gain by chance, over the catalogue.

    By linear columns or without linearising, whichever explains more: there sizes are drawn to zero.
    """
    about = about_fit(found)
    gain = float(about.residual @ about.residual) - search(about, (best.term,)).chi_square
    p = float(chi2.sf(max(gain, 0.0), max(len(best.term.sizes), 1)))
    (linear,) = (s.p for s in ranked if s.candidate.label == best.label)
    return adjusted(min(p, linear), tests)


def _ranked_after(found: Fit, among: list[Candidate]) -> list[Score]:
    """All candidates against what the adopted ones leave."""
    have = {term.candidate.label for term in found.terms}
    linear = about_fit(found)
    board: Field = field(linear, [c for c in among if c.label not in have])
    return scores(board, linear.residual)


def _look_back(observed: Observation, noise: Noise, found: Fit) -> Fit:
    """Take out every term that is not decisive beside the others."""
    while len(found.terms) > 1:
        factors = []
        for k in range(len(found.terms)):
            others = fit(observed, noise, found.terms[:k] + found.terms[k + 1 :])
            linear, term = about_fit(others), found.terms[k]
            factors.append(search(linear, (term,)).log_bayes_factor - price(linear, term.candidate))
        least = int(np.argmin(factors))
        if factors[least] >= DECISIVE:
            return found
        found = fit(observed, noise, found.terms[:least] + found.terms[least + 1 :])
    return found


def _alternatives(
    observed: Observation, noise: Noise, among: list[Candidate], found: Fit, k: int
) -> tuple[Rival, ...]:
    """What else would explain what term k does, the others staying; the best first."""
    others = fit(observed, noise, found.terms[:k] + found.terms[k + 1 :])
    linear = about_fit(others)
    have = {term.candidate.label for term in others.terms}
    board = field(linear, [c for c in among if c.label not in have])
    rivals = again(others, scores(board, linear.residual))
    term = found.terms[k]
    if term.candidate.label not in {rival.label for rival in rivals}:
        factor = search(linear, (term,)).log_bayes_factor - price(linear, term.candidate)
        rivals.append(Rival(term, factor))
    return tuple(sorted(rivals, key=lambda rival: -rival.log_bayes_factor))
