"""Which effects explain an experiment: forward steps, looked back upon, and what else would do as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from experiments.discovery.candidates import Candidate, candidates, columns
from experiments.discovery.evidence import Field, Score, adjusted, family, field, score, scores
from experiments.discovery.fit import Fit, Term, fit, search
from experiments.discovery.laboratory import refit
from experiments.discovery.linear import Linear, linear_model
from experiments.discovery.noise import Noise
from experiments.effects.effect import Effect
from experiments.effects.seen import Seen

LEVEL = 0.005  # of the effects' family, and of the four channels together: 0.01 in all
DECISIVE = 3.0  # ln of the Bayes factor below which two explanations are alike
SHORTLIST = 12
WITHIN = 15.0  # ln of the Bayes factor by linear columns, of what is looked at again without linearising
MOST_TERMS = 4
STEPS_IN_TIME = 60


@dataclass(frozen=True)
class Rival:
    """An explanation of one gap, beside the adopted one.

    Attributes:
        log_bayes_factor: against no effect, the other adopted ones being there.
    """

    term: Term
    log_bayes_factor: float

    @property
    def label(self) -> str:
        return self.term.candidate.label


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
        tests: how many independent tests the catalogue is worth here.
    """

    found: Fit
    before: Fit
    rivals: tuple[tuple[Rival, ...], ...]
    gaps: tuple[Gap, ...]
    alarm: float
    undetectable: tuple[Candidate, ...]
    tests: float


def gaps_of(seen: Seen, noise: Noise) -> tuple[Gap, ...]:
    """Every channel by itself."""
    out = []
    for channel in "AFTC":
        linear = linear_model(seen, noise, channel)
        size, freedom = float(linear.residual @ linear.residual), linear.freedom
        if freedom > 0:
            out.append(Gap(channel, size, freedom, float(chi2.sf(size, freedom))))
    return tuple(out)


def explain(
    seen: Seen,
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
    among = candidates(seen, effects)
    before = fit(seen, noise, ())
    gaps = gaps_of(seen, noise)
    board = field(before.linear, among)
    tests = family(board, rng)
    ranked = scores(board, before.residual)
    undetectable = tuple(s.candidate for s in ranked if not s.visible)
    alarm = min(adjusted(s.p, tests) for s in ranked) if ranked else 1.0
    progress(1)
    found = before
    if alarm < LEVEL or min(gap.p for gap in gaps) < LEVEL / len(gaps):
        found = _forward(seen, noise, among, before, ranked, tests, through_laboratory, progress)
    rivals = tuple(_alternatives(seen, noise, among, found, k) for k in range(len(found.terms)))
    progress(1)
    return Explanation(found, before, rivals, gaps, alarm, undetectable, tests)


def _forward(
    seen: Seen,
    noise: Noise,
    among: list[Candidate],
    found: Fit,
    ranked: list[Score],
    tests: float,
    through_laboratory: bool,
    progress: Callable[[int], None],
) -> Fit:
    """Add the best explanation as long as one is decisive, look back after every step."""
    exact = not through_laboratory
    while len(found.terms) < MOST_TERMS:
        best = _best(found, ranked)
        if best is None or best.log_bayes_factor < DECISIVE or _chance(found, best, ranked, tests) > LEVEL:
            break
        if found.terms and not exact:
            found, _ = refit(seen, noise, found)
            ranked, exact = _ranked_after(found, among), True
            continue
        tried = _look_back(seen, noise, fit(seen, noise, (*found.terms, best.term)))
        progress(1)
        if {t.candidate.label for t in tried.terms} == {t.candidate.label for t in found.terms}:
            break
        found, exact = tried, not through_laboratory
        ranked = _ranked_after(found, among)
    return _alone(seen, noise, found) if through_laboratory else found


def _alone(seen: Seen, noise: Noise, found: Fit) -> Fit:
    """Of two effects of one target, the one that the laboratory shows to do the work of both.

    A formula that misses part of its effect leaves something for its neighbour.
    """
    targets = [term.candidate.target for term in found.terms]
    for target in {t for t in targets if t and targets.count(t) > 1}:
        mine = [term for term in found.terms if term.candidate.target == target]
        others = tuple(term for term in found.terms if term.candidate.target != target)
        both, _ = refit(seen, noise, found)
        singles = [refit(seen, noise, fit(seen, noise, (*others, term)))[0] for term in mine]
        best = max(singles, key=lambda single: single.log_bayes_factor)
        if best.log_bayes_factor > both.log_bayes_factor - DECISIVE:
            found = best
    return found


def _best(found: Fit, ranked: list[Score]) -> Rival | None:
    """The best of a ranking, the foremost looked at again without linearising."""
    rivals = _again(found, ranked)
    return rivals[0] if rivals else None


def _again(found: Fit, ranked: list[Score]) -> list[Rival]:
    """The foremost of a ranking with their sizes found without linearising, the best first."""
    if not ranked or not np.isfinite(ranked[0].log_bayes_factor):
        return []
    near = [s for s in ranked if s.log_bayes_factor > 0.8 * ranked[0].log_bayes_factor - WITHIN and s.visible]
    out = []
    for s in near[:SHORTLIST]:
        term, price = _in_time(found.linear, s, found.residual, found.columns)
        tried = search(_about(found), (term,))
        out.append(Rival(tried.terms[0], tried.log_bayes_factor - price))
    return sorted(out, key=lambda rival: -rival.log_bayes_factor)


def _about(found: Fit) -> Linear:
    """The freed experiment, in which what is adopted already may still change its sizes."""
    linear = found.linear
    if not found.columns.shape[1]:
        return linear
    basis = np.linalg.qr(found.columns)[0]
    whole = np.concatenate([linear.basis, basis], axis=1)
    residual = found.residual - basis @ (basis.T @ found.residual)
    return replace(linear, basis=np.linalg.qr(whole)[0], residual=residual)


def _in_time(linear: Linear, s: Score, residual: np.ndarray, taken: np.ndarray) -> tuple[Term, float]:
    """A term at its best time, and what the choice costs: ln of the number of times there were.

    A change in time is between two postures; the grid is too coarse to say between which.
    """
    candidate = s.candidate
    timed = [k for k, p in enumerate(candidate.effect.parameters) if p.grid and not p.choices]
    price = float(np.log(len(candidate.settings)))
    if not timed:
        return Term(candidate, s.point, s.sizes), price
    part = np.unique(linear.seen.part)
    middles = (part[1:] + part[:-1]) / 2
    grid = candidate.effect.parameters[timed[0]].grid
    middles = middles[(middles >= min(grid)) & (middles <= max(grid))]
    if not len(middles):
        return Term(candidate, s.point, s.sizes), price
    chosen = candidate.settings[s.point]
    near = middles[np.argsort(np.abs(middles - chosen[timed[0]]))[:STEPS_IN_TIME]]
    settings = np.repeat(chosen[None], len(near), axis=0)
    settings[:, timed[0]] = near
    finer = replace(candidate, settings=settings)
    basis = np.linalg.qr(taken)[0] if taken.shape[1] else None
    points = []
    for point in range(len(near)):
        column = linear.project(columns(linear, finer, point))
        points.append(column if basis is None else column - basis @ (basis.T @ column))
    best = score(finer, points, residual)
    return Term(finer, best.point, best.sizes), float(np.log(len(middles)))


def _chance(found: Fit, best: Rival, ranked: list[Score], tests: float) -> float:
    """Probability of as large a gain by chance, over the catalogue.

    By linear columns or without linearising, whichever explains more: there sizes are drawn to zero.
    """
    about = _about(found)
    gain = float(about.residual @ about.residual) - search(about, (best.term,)).chi_square
    p = float(chi2.sf(max(gain, 0.0), max(len(best.term.sizes), 1)))
    (linear,) = (s.p for s in ranked if s.candidate.label == best.label)
    return adjusted(min(p, linear), tests)


def _ranked_after(found: Fit, among: list[Candidate]) -> list[Score]:
    """All candidates against what the adopted ones leave."""
    have = {term.candidate.label for term in found.terms}
    linear = _about(found)
    board: Field = field(linear, [c for c in among if c.label not in have])
    return scores(board, linear.residual)


def _look_back(seen: Seen, noise: Noise, found: Fit) -> Fit:
    """Take out every term that is not decisive beside the others."""
    while len(found.terms) > 1:
        worth = []
        for k in range(len(found.terms)):
            others = fit(seen, noise, found.terms[:k] + found.terms[k + 1 :])
            worth.append(search(_about(others), (found.terms[k],)).log_bayes_factor)
        least = int(np.argmin(worth))
        if worth[least] >= DECISIVE:
            return found
        found = fit(seen, noise, found.terms[:least] + found.terms[least + 1 :])
    return found


def _alternatives(seen: Seen, noise: Noise, among: list[Candidate], found: Fit, k: int) -> tuple[Rival, ...]:
    """What else would explain what term k does, the others staying; the best first."""
    others = fit(seen, noise, found.terms[:k] + found.terms[k + 1 :])
    linear = _about(others)
    have = {term.candidate.label for term in others.terms}
    board = field(linear, [c for c in among if c.label not in have])
    rivals = _again(others, scores(board, linear.residual))
    term = found.terms[k]
    if term.candidate.label not in {rival.label for rival in rivals}:
        rivals.append(Rival(term, search(linear, (term,)).log_bayes_factor))
    return tuple(sorted(rivals, key=lambda rival: -rival.log_bayes_factor))
