"""From measurements to a verdict: none, calibrated, named, described, ambiguous or unknown."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.special import ndtri

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.calibration.calibration_result import CalibratedFamily, SelfCalibration
from tulip_testbed.calibration.families import TOLERANCES, Family
from tulip_testbed.calibration.self_calibration import as_log_shows, usual_tolerances, with_independent_rows
from tulip_testbed.discovery.candidate_search import DECISIVE, CandidateSearch, first_calibration
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.detectability import Undetectable, undetectable
from tulip_testbed.discovery.effect_intervals import as_calibrated, with_intervals
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.held_out import HeldOut, check_placements, held_out
from tulip_testbed.discovery.joint_fit import JointFit
from tulip_testbed.discovery.law_candidates import is_law, law_candidates
from tulip_testbed.discovery.law_search import LawSelection, left_to_laws, select_laws
from tulip_testbed.discovery.loose_parts import hidden_joints, speaks_of
from tulip_testbed.discovery.patterns import Pattern, in_channels, patterns
from tulip_testbed.discovery.pure_error import PureError, pure_error
from tulip_testbed.discovery.selection import LEVEL, Selection, select, select_without
from tulip_testbed.discovery.unusual_members import STANDS_OUT, SURE
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.laws.grammar import sentence_of
from tulip_testbed.effects.laws.misread import misread_by
from tulip_testbed.effects.motion_effects import MOTION_EFFECTS
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.regressor import regression, with_cad_where_needed
from tulip_testbed.identification.residual_noise import Noise
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot

Verdict = Literal["none", "calibrated", "named", "described", "ambiguous", "unknown"]
NONE: Verdict = "none"
CALIBRATED: Verdict = "calibrated"
NAMED: Verdict = "named"
DESCRIBED: Verdict = "described"
AMBIGUOUS: Verdict = "ambiguous"
UNKNOWN: Verdict = "unknown"
ADOPTED = (NAMED, DESCRIBED)  # verdicts whose effects are added to the model
REPORTED_PATTERNS, RUNNERS_UP = 5, 5
CROWD = 3  # members of a family; with half of it or more, they are no exceptions
# Of a plausible size; below it an effect without a family is ordinary: nothing stands quite still. Assumed.
NEGLIGIBLE = 0.05
CERTAIN = float(ndtri(0.999))  # s.e. by which an effect has to lie beyond its family's spread
# Standard errors, r.m.s., by which laws that do as well may differ in the base parameters. On five
# development faults they differed by 0.4 at most or by 10.
AGREEING = 1.0


@dataclass(frozen=True)
class Discovery:
    """The effects that were found in an experiment.

    Attributes:
        verdict: none, calibrated, named, described, ambiguous or unknown.
        observed, noise: the experiment. repeats: what its repeated postures say about the noise.
        selection: how the effects were selected. fit: of them, with the sizes of self-calibration.
        effects: numbers of the terms of the fit that stand out of their families or belong to none.
        adopted: effects and laws that are added to the model; empty unless named or described.
        calibrated: ordinary imperfections that are added to the model, with intervals; empty unless named,
            described or calibrated.
        families: spreads and members of the families; empty if there is no gap.
        equivalents: the equivalent explanations of each term of the fit, the best first.
        undetectable: effects that the experiment cannot show.
        patterns: the least probable patterns in the residuals of the fit.
        where: the clearest pattern in the residuals without effects (of the fit, if the verdict is unknown).
        reasons: why the verdict is unknown, in sentences.
        heldout: the residuals on held-out placements; None: not asked for.
        wall_s: duration [s].
    """

    verdict: Verdict
    observed: Observation
    noise: Noise
    repeats: PureError
    selection: Selection
    fit: JointFit
    effects: tuple[int, ...]
    adopted: tuple[EffectInstance, ...]
    calibrated: tuple[EffectInstance, ...]
    families: tuple[CalibratedFamily, ...]
    equivalents: tuple[tuple[Fitted, ...], ...]
    undetectable: tuple[Undetectable, ...]
    patterns: tuple[Pattern, ...]
    where: str
    reasons: tuple[str, ...]
    heldout: HeldOut | None
    wall_s: float

    @property
    def corrections(self) -> tuple[EffectInstance, ...]:
        """Return what the new nominal laboratory has: effects, and imperfections that are not zero."""
        found = self.adopted + tuple(member for member in self.calibrated if clear_of_zero(member))
        return tuple(one for one in found if one.effect not in MOTION_EFFECTS)

    @cached_property
    def explanations(self) -> tuple[Explanation, ...]:
        """Return the explanations of all gaps, those of one gap together, its best first."""
        return tuple(
            Explanation(self._instance(k, fitted), fitted.log_bayes_factor, k + 1)
            for k in self.effects
            for fitted in self.equivalents[k]
        )

    @property
    def negligible(self) -> tuple[Fitted, ...]:
        """Return the effects without a family that are fitted, but too small to be named."""
        return tuple(
            replace(term, log_bayes_factor=same.log_bayes_factor)
            for k, term in enumerate(self.fit.terms)
            if k not in self.effects and term.candidate.effect.name not in TOLERANCES
            for same in self.equivalents[k]
            if same.label == term.label
        )

    def _instance(self, k: int, explanation: Fitted) -> EffectInstance:
        """Return an explanation of term k, with the sizes of self-calibration if it is that term."""
        is_the_term = explanation.label == self.fit.terms[k].label
        return with_intervals(self.fit, k) if is_the_term else explanation.instance

    def runners_up(self, k: int) -> list[Fitted]:
        """Return the best explanations of gap `k` that are not as good as its best one, by predictions."""
        left = {one.label for one in self.equivalents[k]}
        others: dict[str, Fitted] = {}
        for lists in (self.selection.alternatives, self.selection.runners_up):
            for one in lists[k] if k < len(lists) else ():
                if one.label not in left and one.log_bayes_factor > 0:
                    others.setdefault(one.label, one)
        return sorted(others.values(), key=lambda one: -one.log_bayes_factor)[:RUNNERS_UP]


def clear_of_zero(member: EffectInstance) -> bool:
    """Return whether the interval of a value leaves zero out."""
    return any(i is not None and not i[0] <= 0 <= i[1] for i in member.intervals)


def discover(
    measurements: Measurements,
    robot: Robot,
    seed: int = 0,
    tolerances: Mapping[str, float] | None = None,
    hold_out: bool = True,
    source: str = "measurements",
    calibration: SelfCalibration | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> Discovery:
    """Find what the nominal model lacks.

    Args:
        seed: of the bootstrap that calibrates the level.
        tolerances: of families of ordinary imperfections, in place of those that fit the sensors [SI]; zero:
            exact.
        hold_out: cross-validate over placements.
        source: of the measurements, for messages.
        calibration: of these measurements without effects and with these tolerances, if it is at hand.
        progress: called with 1 after every stage.

    Raises:
        InputError: measurements that do not fit the robot, too few placements or postures, or an unknown
            family.
    """
    nominal = nominal_robot(robot, common_support(measurements.support))
    data = regression(nominal.parameters, measurements, robot, source)
    assert data.observed is not None
    observed = with_cad_where_needed(data.observed, data)
    if hold_out:
        check_placements(measurements)
    try:
        observed, found = as_log_shows(observed, tolerances)
        if observed.noise_in_time is not None:
            observed, found, calibration = with_independent_rows(observed), None, None
        search = CandidateSearch.of(observed, tolerances)
        first = calibration or found or first_calibration(search.observed, tolerances)
        return _discover(search, first, seed, hold_out, progress)
    except np.linalg.LinAlgError:
        raise InputError(
            f"{source}: found {len(measurements)} rows of which no calibration converges; expected a smaller "
            "fault or more postures: look at the preflight (`check`)"
        ) from None


def _discover(
    search: CandidateSearch,
    first: SelfCalibration,
    seed: int,
    hold_out: bool,
    progress: Callable[[int], None],
) -> Discovery:
    began, rng = time.perf_counter(), np.random.default_rng(seed)
    selection = select(search, first, rng, progress)
    # A law speaks of places in one laboratory, so none is searched for in several experiments together.
    joined = search.observed.measurements.experiments
    laws = [] if joined else law_candidates(selection.first.without_members(search.observed))
    hidden = hidden_joints(selection.fit.linear.smoothed, selection.fit.terms)
    laws = [] if search.budget.spent else [law for law in laws if not speaks_of(law, hidden)]
    found, searched = None, bool(laws) and left_to_laws(search, selection, laws)
    described = select_laws(search, selection, laws, rng) if searched else None
    progress(1)
    if described is not None and described.better:
        found = _described(described, hold_out)
    if found is None:
        found = _listed(search, selection, hold_out)
        if found.verdict == UNKNOWN and laws and not (searched or search.budget.spent):
            described = select_laws(search, found.selection, laws, rng)
        if found.verdict == UNKNOWN and described is not None and not (searched and described.better):
            found = _described(described, hold_out) or found
    progress(1)
    return replace(found, wall_s=time.perf_counter() - began)


def _listed(search: CandidateSearch, selection: Selection, hold_out: bool) -> Discovery:
    """Reach a verdict with the effects of the catalogue.

    An effect for which no evidence is left together with the others is dropped, and the search is repeated.
    """
    fitted = _fitted(selection)
    while not selection.unexplained and (lost := fitted.lost) and not search.budget.spent:
        search = replace(search, candidates=[c for c in search.candidates if c.label not in lost])
        selection = select_without(search, selection, lost)
        fitted = _fitted(selection)
    validation = held_out(search, selection.calibration, fitted.fit.terms) if hold_out else None
    return _concluded(search, selection, fitted, validation)


def _described(laws: LawSelection, hold_out: bool) -> Discovery | None:
    """Reach a verdict with laws; None: they are not confirmed."""
    search, selection = laws.search, laws.selection
    if selection.unexplained:
        return None
    fitted = _fitted(selection)
    validation = held_out(search, selection.calibration, fitted.fit.terms) if hold_out else None
    found = _concluded(search, selection, fitted, validation)
    if found.verdict == UNKNOWN:
        return None
    if found.verdict == DESCRIBED and laws.disagreement > AGREEING:
        reason = (
            "Laws that explain the readings equally well differ by "
            f"{laws.disagreement:.0f} standard errors in the base parameters, so none is adopted: "
            f"{', '.join(dict.fromkeys(one.label for k in found.effects for one in found.equivalents[k]))}."
        )
        found = replace(found, verdict=UNKNOWN, adopted=(), calibrated=(), reasons=(reason,))
    return found


@dataclass(frozen=True)
class _Fitted:
    """The selected effects.

    Attributes:
        fit: of a selection, with the sizes of self-calibration.
        standing: numbers of the terms that are no members of a family, or too large for theirs.
        equivalents: see `Discovery`.
    """

    fit: JointFit
    standing: tuple[int, ...]
    equivalents: tuple[tuple[Fitted, ...], ...]

    @property
    def outside(self) -> tuple[int, ...]:
        """Return the numbers of the standing terms that are decisive."""
        return tuple(k for k in self.standing if self.equivalents[k][0].log_bayes_factor > DECISIVE)

    @property
    def lost(self) -> list[str]:
        """Return the labels of those that are not."""
        return [self.fit.terms[k].label for k in self.standing if k not in self.outside]


def _fitted(selection: Selection) -> _Fitted:
    fit = as_calibrated(selection.fit, selection.calibration)
    near = tuple(_equivalent(a, t) for a, t in zip(selection.alternatives, fit.terms, strict=True))
    standing = [k for k, term in enumerate(fit.terms) if stands_out(selection, term, fit.errors[k])]
    return _Fitted(fit, tuple(standing), near)


def _equivalent(alternatives: tuple[Fitted, ...], adopted: Fitted) -> tuple[Fitted, ...]:
    """Return the alternatives within `DECISIVE` of the best, and the adopted one in any case.

    Args:
        alternatives: the best first.
    """
    least = alternatives[0].log_bayes_factor - DECISIVE
    return tuple(a for a in alternatives if a.log_bayes_factor > least or a.label == adopted.label)


def _concluded(
    search: CandidateSearch, selection: Selection, fitted: _Fitted, validation: HeldOut | None
) -> Discovery:
    """Reach a verdict; `validation` is None where it was not asked for."""
    began, observed, fit = time.perf_counter(), search.observed, fitted.fit
    outside, equivalents = fitted.outside, fitted.equivalents
    left = patterns(fit.linear, fit.residual, fit.columns)
    laws = [fit.terms[k].candidate.target for k in outside if is_law(fit.terms[k].candidate)]
    holds = validation is not None and validation.holds
    hidden = hidden_joints(fit.linear.smoothed, fit.terms) if holds else set[str]()
    clearest = next((one for one in left if not _is_rest(one, hidden)), left[0])
    tolerated = holds and (_inexact(laws, clearest, observed) or _is_rest(clearest, hidden))
    names = [fit.terms[k].candidate.effect.name for k in outside]
    absent = () if outside else selection.calibration.absent
    reasons = _reasons(selection, None if tolerated else clearest, validation, fitted.lost)
    reasons = (*_crowded(names, selection.calibration.families), *map(_negative, absent), *reasons)
    verdict = _verdict(selection, reasons, [equivalents[k] for k in outside], bool(laws))
    adopted = tuple(with_intervals(fit, k) for k in range(len(fit.terms)))
    null = selection.null
    if verdict in (*ADOPTED, AMBIGUOUS, CALIBRATED):
        clearest = patterns(null.linear, null.residual, null.columns)[0]
    families = selection.calibration.families if selection.lacks_fit else ()
    ordinary = [a for k, a in enumerate(adopted) if k not in outside and a.effect.name in TOLERANCES]
    ordinary += [instance for family in families for instance in family.determined_instances]
    return Discovery(
        verdict=verdict,
        observed=observed,
        noise=fit.data.noise,
        repeats=pure_error(fit.linear.observed, fit.linear.theta, fit.data.noise),
        selection=selection,
        fit=fit,
        effects=outside,
        adopted=tuple(adopted[k] for k in outside) if verdict in ADOPTED else (),
        calibrated=tuple(ordinary) if verdict in (*ADOPTED, CALIBRATED) else (),
        families=families,
        equivalents=equivalents,
        undetectable=undetectable(null.linear, selection.undetectable),
        patterns=tuple(left[:REPORTED_PATTERNS]),
        where=f"{clearest.words} ({in_channels(clearest)})" if verdict != NONE else "",
        reasons=reasons,
        heldout=validation,
        wall_s=time.perf_counter() - began,
    )


def _inexact(laws: Sequence[str], clearest: Pattern, observed: Observation) -> bool:
    """Return whether a pattern may be what laws leave that are not exact.

    That another reading errs than those that the laws blame contradicts them.
    """
    blamed = {name for law in laws for name in misread_by(observed, sentence_of(law))}
    return bool(laws) and (not clearest.reading or clearest.reading in blamed)


def _is_rest(pattern: Pattern, hidden: set[str]) -> bool:
    """Return whether a pattern of the legs' closure may be where the links of hidden joints rest."""
    return bool(hidden) and (pattern.reading in hidden or (pattern.channel == "C" and not pattern.reading))


def stands_out(selection: Selection, term: Fitted, error: np.ndarray) -> bool:
    """Whether an effect is surely too large for a member of its family, or not negligible if it has none.

    Args:
        error: standard errors of its sizes, (s,).
    """
    if not len(term.sizes):
        return True
    effect, name = term.candidate.effect, term.candidate.effect.name
    size = np.abs(term.sizes)
    tolerances = usual_tolerances(selection.null.data.observed, selection.tolerances)
    tolerance = tolerances.value.get(name, 0.0)
    if not tolerance and any(TOLERANCES.get(name, ())):  # stated as exact: whatever is there is no part of it
        return True
    if not tolerance:
        return bool((size - SURE * error > NEGLIGIBLE * term.candidate.prior).any())
    spreads = [one.spread for one in selection.calibration.families if one.family.name == name]
    usual = max([1.0, *spreads]) * Family(effect, tolerance, (term.candidate.target,)).sizes
    # Evidence alone does not tell it from its family: the size has to be known too.
    return bool(((size - SURE * error > STANDS_OUT * usual) & (size - CERTAIN * error > usual)).any())


def _reasons(
    selection: Selection, clearest: Pattern | None, validation: HeldOut | None, lost: Sequence[str] = ()
) -> tuple[str, ...]:
    """Say why what was found does not suffice; empty: it does. No `clearest`: what is left is tolerated."""
    if not selection.lacks_fit:
        return ()
    out = []
    if clearest is not None and clearest.p < LEVEL:
        out.append(f"A pattern remains: {clearest.words} ({in_channels(clearest)}).")
    if lost and not selection.unexplained:
        out.append(f"Together with the others, the evidence for {listed(lost)} is gone.")
    out += selection.unexplained
    if validation is not None and not validation.holds:
        bad = [key for key in validation.after if validation.after[key] > validation.floor[key]]
        out.append(
            "Placements that took no part in the fit are predicted worse than chance allows "
            f"({', '.join('all channels' if key == 'AFTC' else f'channel {key}' for key in bad)})."
        )
    return tuple(out)


def _crowded(names: Sequence[str], families: Sequence[CalibratedFamily]) -> list[str]:
    """Say of which families so many members stand out that one cause is likelier than all of these."""
    out = []
    for one in families:
        count, others = names.count(one.family.name), len(one.family.targets)
        if count >= max(CROWD, others):
            out.append(
                f"{count} of {count + others} members of the family {one.family.name} stand out at once: one "
                "cause that the catalogue lacks is likelier."
            )
    return out


def _negative(family: str) -> str:
    return f"Members of the family {family} would be negative beyond doubt, which they cannot be."


def _verdict(
    selection: Selection, reasons: tuple[str, ...], equivalents: list[tuple[Fitted, ...]], described: bool
) -> Verdict:
    if not selection.lacks_fit:
        return NONE
    if reasons:
        return UNKNOWN
    if not equivalents:
        return CALIBRATED
    if any(len(set(map(_cause, several))) > 1 for several in equivalents):
        return AMBIGUOUS
    return DESCRIBED if described else NAMED


def _cause(one: Fitted) -> str:
    """Return what errs by a law, regardless of its quantity and shape, or the effect."""
    return one.candidate.target.partition("/")[0] if is_law(one.candidate) else one.label
