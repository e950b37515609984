"""From measurements to a verdict: named, ambiguous, unknown, or none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.discovery.candidates import Candidate, columns
from tulip_testbed.discovery.fit import Fit, Term, search
from tulip_testbed.discovery.held_out import HeldOut, check_placements, held_out
from tulip_testbed.discovery.linear_model import nuisances, weighing
from tulip_testbed.discovery.patterns import Pattern, in_channels, patterns
from tulip_testbed.discovery.pure_error import PureError, pure_error, widened
from tulip_testbed.discovery.ranking import Rival
from tulip_testbed.discovery.rivals import alike, settle
from tulip_testbed.discovery.selection import LEVEL, Explanation, explain
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import packed, unpacked
from tulip_testbed.identification.residual_noise import Noise, noise_of
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot

NAMED, AMBIGUOUS, UNKNOWN, NONE = "named", "ambiguous", "unknown", "none"
CLOSED = 0.95  # part of a gap whose explanation is kept although a pattern is left of it
PREDICTS = 1.1  # times the noise on held-out placements: an explanation that leaves more is none
QUANTILE = 1.959964
TOLD_PATTERNS = 5
TIME_GAIN = 3.84  # chi-square with one degree of freedom, 95 %


@dataclass(frozen=True)
class Unseen:
    """An effect that these postures cannot show.

    Attributes:
        parameter: number of the base parameter that it would bias most, from 1; 0: none.
        bias: of it, for a size of one prior s.d. [m].
    """

    label: str
    parameter: int
    bias: float


@dataclass(frozen=True)
class Discovery:
    """What was found in an experiment.

    Attributes:
        verdict: named, ambiguous, unknown or none.
        observed, noise, repeats: the experiment, its noise, and what repeated postures say of it.
        explanation: how it was searched. found: the fit through the laboratory.
        bend: what the laboratory adds to the predictions, (m, 11, s + 1).
        adopted: what is added to the model; empty unless named.
        rivals: for every term, what explains it as well.
        unseen: what these postures cannot show.
        left: the clearest patterns in what is left after it, the least probable first.
        where: the clearest pattern of the gap (of what is left, where the verdict is unknown).
        heldout: the gap on held-out placements; None: too few placements.
        wall_s: [s].
    """

    verdict: str
    observed: Observation
    noise: Noise
    repeats: PureError
    explanation: Explanation
    found: Fit
    bend: np.ndarray
    adopted: tuple[EffectInstance, ...]
    rivals: tuple[tuple[Rival, ...], ...]
    unseen: tuple[Unseen, ...]
    left: tuple[Pattern, ...]
    where: str
    heldout: HeldOut | None
    wall_s: float


def discover(
    measurements: Measurements,
    robot: Robot,
    seed: int = 0,
    effects: dict[str, Effect] | None = None,
    through_laboratory: bool = True,
    hold_out: bool = True,
    progress: Callable[[int], None] = lambda count: None,
) -> Discovery:
    """Find what the nominal model lacks.

    Args:
        seed: of the bootstrap that calibrates the level.
        effects: the catalogue by name; all of it if None.
        through_laboratory: fit the sizes through the static laboratory.
        hold_out: show the gap on held-out placements.
        progress: called with 1 after every stage.

    Raises:
        InputError: measurements that do not fit the robot, or too few placements.
    """
    began = time.perf_counter()
    observed = observe(measurements, nominal_robot(robot, _support(measurements)))
    if hold_out:
        check_placements(measurements)
    stated = noise_of(observed)
    noise = stated

    def searched() -> tuple[Explanation, PureError]:
        """Repeats are freed of what was found: effects of the load differ between them as it does."""
        rng = np.random.default_rng(seed)
        told = explain(observed, noise, rng, effects, through_laboratory, progress)
        return told, pure_error(told.found.linear.observed, told.found.linear.theta, stated)

    explanation, repeats = searched()
    wider = widened(explanation.found.linear.observed, stated, repeats)
    if wider is not stated:
        noise = wider
        explanation, repeats = searched()
    found, bend = explanation.found, np.zeros((len(observed), 11, 1))
    rivals: tuple[tuple[Rival, ...], ...] = ()
    if found.terms and through_laboratory:
        found, bend, rivals = settle(observed, noise, found, explanation.rivals)
    elif found.terms:
        bend = np.zeros((len(observed), 11, sum(len(t.sizes) for t in found.terms) + 1))
        rivals = tuple(alike(r, t) for r, t in zip(explanation.rivals, found.terms, strict=True))
    progress(1)
    left = patterns(found.linear, found.residual, found.columns)
    heldout = held_out(observed, noise, found.terms, bend) if hold_out else None
    verdict = _verdict(explanation, found, rivals, left[0], heldout)
    adopted = tuple(instance_of(term, found, k) for k, term in enumerate(found.terms))
    progress(1)
    before = patterns(explanation.before.linear, explanation.before.residual, explanation.before.columns)
    clearest = left[0] if verdict == UNKNOWN and found.terms else before[0]
    return Discovery(
        verdict=verdict,
        observed=observed,
        noise=noise,
        repeats=repeats,
        explanation=explanation,
        found=found,
        bend=bend,
        adopted=adopted if verdict == NAMED else (),
        rivals=rivals,
        unseen=tuple(unseen(explanation, c) for c in explanation.undetectable),
        left=tuple(left[:TOLD_PATTERNS]),
        where=f"{clearest.words} ({in_channels(clearest)})" if verdict != NONE else "",
        heldout=heldout,
        wall_s=time.perf_counter() - began,
    )


def _support(measurements: Measurements) -> str:
    return "double" if (measurements.support == "double").all() else "right"


def _verdict(
    explanation: Explanation,
    found: Fit,
    rivals: tuple[tuple[Rival, ...], ...],
    left: Pattern,
    heldout: HeldOut | None,
) -> str:
    if not found.terms:
        gap = explanation.alarm < LEVEL or min(g.p for g in explanation.gaps) < LEVEL / len(explanation.gaps)
        return UNKNOWN if gap else NONE
    explained = explanation.before.chi_square - found.chi_square
    unexplained = left.gain if left.p < LEVEL else 0.0
    if explained < CLOSED * (explained + unexplained) or crowded(found):
        return UNKNOWN
    if heldout is not None and heldout.after["AFTC"] > max(PREDICTS, heldout.floor["AFTC"]):
        return UNKNOWN
    return AMBIGUOUS if any(len(alternatives) > 1 for alternatives in rivals) else NAMED


def crowded(found: Fit) -> bool:
    """Whether two effects are needed on one joint, cell or plate: rather one that the catalogue lacks."""
    targets = [term.candidate.target for term in found.terms if term.candidate.target]
    return len(set(targets)) < len(targets)


def instance_of(term: Term, found: Fit, k: int) -> EffectInstance:
    """A fitted term with its 95 % intervals."""
    first = sum(len(other.sizes) for other in found.terms[:k])
    spread = np.sqrt(np.diag(found.covariance))[first : first + len(term.sizes)]
    effect = term.candidate.effect
    intervals: list[tuple[float, float] | None] = [None] * len(effect.parameters)
    for at, size, sd, positive in zip(effect.sizes, term.sizes, spread, term.candidate.positive, strict=True):
        low = size - QUANTILE * sd
        intervals[at] = (float(max(low, 0.0) if positive else low), float(size + QUANTILE * sd))
    for at, parameter in enumerate(effect.parameters):
        if parameter.grid and not parameter.choices:
            intervals[at] = _times(found, k, at)
    return EffectInstance(effect, term.candidate.target, term.values, tuple(intervals))


def _times(found: Fit, k: int, at: int) -> tuple[float, float]:
    """Times between postures at which a change explains nearly as much as at the best."""
    term, observed = found.terms[k], found.linear.observed
    part = np.unique(observed.part)
    middles = (part[1:] + part[:-1]) / 2
    here = int(np.abs(middles - term.values[at]).argmin())
    # About the freed experiment the term's own change is gone; it is put back by its prediction.
    shown = replace(found.linear, observed=_with(term, observed), smooth=_with(term, found.linear.smooth))
    shown = replace(shown, residual=shown.at(shown.observed))

    def worth(index: int) -> float:
        settings = term.candidate.settings[[term.point]].copy()
        settings[:, at] = middles[index]
        tried = Term(replace(term.candidate, settings=settings), 0, term.sizes)
        return search(shown, (tried,)).chi_square

    best = worth(here)
    low = high = here
    while low > 0 and worth(low - 1) < best + TIME_GAIN:
        low -= 1
    while high < len(middles) - 1 and worth(high + 1) < best + TIME_GAIN:
        high += 1
    return float(part[low]), float(part[high + 1])


def _with(term: Term, observed: Observation) -> Observation:
    """Readings to which an effect is put back, to first order."""
    return unpacked(observed, 2 * packed(observed) - packed(term.removed(observed)))


def unseen(explanation: Explanation, candidate: Candidate) -> Unseen:
    """What an effect that leaves no residual does to the base parameters, at one prior s.d. of its size."""
    linear = explanation.before.linear
    if not candidate.effect.sizes:
        return Unseen(candidate.label, 0, 0.0)
    known = np.vstack([linear.white(nuisances(linear.smooth, "AFTC")), weighing(linear.smooth)[None]])
    effect = columns(linear, candidate, 0) * candidate.prior
    pushed = np.linalg.lstsq(known, np.vstack([effect, np.zeros((1, effect.shape[1]))]), rcond=None)[0]
    moved = pushed[: len(linear.theta)]
    if not np.abs(moved).max(initial=0.0) > 0:
        moved = _other_robot(linear.observed, candidate)[:, None]
    at = np.unravel_index(np.abs(moved).argmax(), moved.shape)
    if not moved[at]:
        return Unseen(candidate.label, 0, 0.0)
    return Unseen(candidate.label, int(at[0]) + 1, float(np.abs(moved[at])))


def _other_robot(observed: Observation, candidate: Candidate) -> np.ndarray:
    """How far the base parameters of the robot with the effect are from the nominal ones, (p,) [m]."""
    sizes = np.zeros(len(candidate.prior))
    sizes[0] = candidate.prior[0]
    rig = candidate.effect.inject(
        preset_rig("ideal", observed.nominal.robot), candidate.target, candidate.values(sizes)
    )
    if rig.edit is None:
        return np.zeros(len(observed.nominal.value))
    try:
        return true_base_parameters(rig, _support(observed.measurements)) - observed.nominal.value
    except InputError:  # soles that are no plane any more: not the robot's
        return np.zeros(len(observed.nominal.value))
