"""From measurements to a verdict: named, ambiguous, unknown, or none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.discovery.equivalence import equivalent, refit_with_alternatives
from tulip_testbed.discovery.held_out import HeldOut, check_placements, held_out
from tulip_testbed.discovery.joint_fit import Data, JointFit
from tulip_testbed.discovery.patterns import Pattern, in_channels, patterns
from tulip_testbed.discovery.pure_error import PureError, pure_error, widened
from tulip_testbed.discovery.selection import LEVEL, Selection, select
from tulip_testbed.discovery.undetectable import Undetectable, undetectable
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_noise import Noise, noise_of
from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.robot import Robot

NAMED, AMBIGUOUS, UNKNOWN, NONE = "named", "ambiguous", "unknown", "none"
EXPLAINED = 0.95  # least part of the lack of fit that the effects of a verdict other than unknown explain
PREDICTS = 1.1  # times the noise on held-out placements, beyond which an explanation is refused
REPORTED_PATTERNS = 5


@dataclass(frozen=True)
class Discovery:
    """The effects that were found in an experiment.

    Attributes:
        verdict: named, ambiguous, unknown or none.
        observed, noise: the experiment. repeats: what its repeated postures say about the noise.
        selection: how the effects were selected. fit: the final one, through the laboratory.
        model_error: of the effects' predictions there, (m, 11, s + 1).
        adopted: effects that are added to the model; empty unless named.
        equivalents: the equivalent explanations of each term of the fit, the best first.
        undetectable: effects that the experiment cannot show.
        patterns: the least probable patterns in the residuals of the fit.
        where: the clearest pattern in the residuals without effects (of the fit, if the verdict is unknown).
        heldout: the residuals on held-out placements; None: not asked for.
        wall_s: duration [s].
    """

    verdict: str
    observed: Observation
    noise: Noise
    repeats: PureError
    selection: Selection
    fit: JointFit
    model_error: np.ndarray
    adopted: tuple[EffectInstance, ...]
    equivalents: tuple[tuple[Fitted, ...], ...]
    undetectable: tuple[Undetectable, ...]
    patterns: tuple[Pattern, ...]
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
        hold_out: cross-validate over placements.
        progress: called with 1 after every stage.

    Raises:
        InputError: measurements that do not fit the robot, or too few placements.
    """
    began = time.perf_counter()
    observed = observe(measurements, nominal_robot(robot, _support(measurements)))
    if hold_out:
        check_placements(measurements)
    stated = noise_of(observed)
    data = Data(observed, stated)

    def selected() -> tuple[Selection, PureError]:
        """Compare repeats with the effects removed: effects of the load differ between them as it does."""
        out = select(data, np.random.default_rng(seed), effects, progress)
        return out, pure_error(out.fit.linear.observed, out.fit.linear.theta, stated)

    selection, repeats = selected()
    wider = widened(selection.fit.linear.observed, stated, repeats)
    if wider is not stated:
        data = replace(data, noise=wider)
        selection, repeats = selected()
    fit, model_error = selection.fit, data.no_model_error(selection.fit.terms)
    equivalents: tuple[tuple[Fitted, ...], ...] = ()
    if fit.terms and through_laboratory:
        fit, model_error, equivalents = refit_with_alternatives(fit, selection.alternatives)
    elif fit.terms:
        equivalents = tuple(equivalent(a, t) for a, t in zip(selection.alternatives, fit.terms, strict=True))
    progress(1)
    left = patterns(fit.linear, fit.residual, fit.columns)
    validation = held_out(data, fit.terms, model_error) if hold_out else None
    verdict = _verdict(selection, fit, equivalents, left[0], validation)
    adopted = tuple(with_intervals(fit, k) for k in range(len(fit.terms)))
    progress(1)
    null, clearest = selection.null, left[0]
    if verdict in (NAMED, AMBIGUOUS):
        clearest = patterns(null.linear, null.residual, null.columns)[0]
    return Discovery(
        verdict=verdict,
        observed=observed,
        noise=data.noise,
        repeats=repeats,
        selection=selection,
        fit=fit,
        model_error=model_error,
        adopted=adopted if verdict == NAMED else (),
        equivalents=equivalents,
        undetectable=undetectable(null.linear, selection.undetectable),
        patterns=tuple(left[:REPORTED_PATTERNS]),
        where=f"{clearest.words} ({in_channels(clearest)})" if verdict != NONE else "",
        heldout=validation,
        wall_s=time.perf_counter() - began,
    )


def _support(measurements: Measurements) -> str:
    return "double" if (measurements.support == "double").all() else "right"


def _verdict(
    selection: Selection,
    fit: JointFit,
    equivalents: tuple[tuple[Fitted, ...], ...],
    clearest: Pattern,
    validation: HeldOut | None,
) -> str:
    if not fit.terms:
        return UNKNOWN if selection.lacks_fit else NONE
    explained = selection.null.chi_square - fit.chi_square
    unexplained = clearest.gain if clearest.p < LEVEL else 0.0
    if explained < EXPLAINED * (explained + unexplained) or shares_target(fit):
        return UNKNOWN
    if validation is not None and validation.after["AFTC"] > max(PREDICTS, validation.floor["AFTC"]):
        return UNKNOWN
    return AMBIGUOUS if any(len(several) > 1 for several in equivalents) else NAMED


def shares_target(fit: JointFit) -> bool:
    """Whether two effects act on one joint, cell or plate: rather one effect that the catalogue lacks."""
    targets = [term.candidate.target for term in fit.terms if term.candidate.target]
    return len(set(targets)) < len(targets)
