"""Carry out one case and compare the result of the discovery with the hidden effect."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.hidden_effects.hiding import LEFT_OUT, OUTSIDE, SCATTER, Case, Trial, World, draw_trial
from studies.hidden_effects.outside_faults import Description
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.discover import AMBIGUOUS, CALIBRATED, DESCRIBED, NAMED, Discovery, discover
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.discovery.law_candidates import is_law
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, split_label
from tulip_testbed.effects.laws.grammar import CATALOGUED, Sentence
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.sim.sensors import PRESETS

LEAST_STANDING = 0.75  # of a plan's postures: a laboratory in which more fall would not go on
MOST_TRIES = 20


@dataclass(frozen=True)
class Found:
    """One effect of a discovery.

    Attributes:
        label: as on the command line. values: of its parameters [SI].
        alike: labels of all explanations of its gap, the best first.
        said: what errs, and as a function of what, of a law or of an effect that says as much.
    """

    label: str
    values: tuple[float, ...]
    alike: tuple[str, ...] = ()
    said: tuple[Description, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """One case and what was said of it.

    Attributes:
        hidden: labels. values: of their parameters [SI].
        twins: for every hidden effect labels of what can look like it.
        right: of a fault outside the catalogue, its right descriptions.
        failed: why there was no data set, or "".
        verdict: of the discovery, or "refused". found: its effects, the best first.
        calibrated: its ordinary imperfections, that with the most standard errors first.
        sizes, members, base: whether the 95 % interval of each size of a hidden effect that was said, of each
            ordinary imperfection that was adopted, of each base parameter holds the truth.
        seconds: of CPU.
    """

    case: Case
    hidden: tuple[str, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()
    twins: tuple[tuple[str, ...], ...] = ()
    right: tuple[Description, ...] = ()
    failed: str = ""
    verdict: str = ""
    found: tuple[Found, ...] = ()
    calibrated: tuple[Found, ...] = ()
    sizes: tuple[bool, ...] = ()
    members: tuple[bool, ...] = ()
    base: tuple[bool, ...] = ()
    seconds: float = 0.0

    @property
    def isolable(self) -> bool:
        """Whether nothing else in the catalogue can look like what is hidden."""
        return not any(self.twins)

    @property
    def names(self) -> list[str]:
        """Return the labels that were found first for every gap."""
        return [one.label for one in self.found]

    @property
    def flagged(self) -> bool:
        """Whether a gap was seen."""
        return self.verdict != "none"

    @property
    def shows(self) -> bool:
        """Whether a gap is seen that ordinary imperfections do not explain, or the clearest one is right."""
        return self.verdict not in ("none", CALIBRATED) or self.right_first

    @property
    def in_set(self) -> bool:
        """Whether the hidden effect is among the explanations, or is the clearest ordinary imperfection."""
        return self._clearest or (self._told and self._held(0))

    @property
    def right_first(self) -> bool:
        """Whether the hidden effect is the first explanation, or the clearest ordinary imperfection."""
        return self._clearest or (self._told and self.names[:1] == list(self.hidden) and self._held(0))

    @property
    def exact(self) -> bool:
        """Whether all that was hidden is named first, and nothing else."""
        every = all(self._held(k) for k in range(len(self.hidden)))
        return self._told and set(self.names) == set(self.hidden) and every

    @property
    def wrong(self) -> bool:
        """Whether a single cause is reported, and it is wrong."""
        lawful = self.case.arm in (OUTSIDE, LEFT_OUT)
        return (self.verdict == NAMED and not self.exact) or (self.verdict == DESCRIBED and not lawful)

    @property
    def open(self) -> bool:
        """Whether no wrong cause is reported where the catalogue lacks the right one: a law's is a guess."""
        twins = self.case.arm == LEFT_OUT and self._told and set(self.names) <= set(self.twins[0])
        return twins or self.verdict in ("unknown", DESCRIBED)

    @property
    def law_right(self) -> bool:
        """Whether the first description of a fault outside the catalogue is right."""
        if self.verdict not in (NAMED, DESCRIBED):
            return False
        first = [pair for one in self.found for pair in one.said][:1]
        return any(what == w and of in ("*", o) for w, o in first for what, of in self.right)

    @property
    def _told(self) -> bool:
        return self.verdict in (NAMED, AMBIGUOUS)

    @property
    def _clearest(self) -> bool:
        """Whether the clearest ordinary imperfection is the hidden effect, with its sign."""
        if self.verdict != CALIBRATED or not self.calibrated or len(self.hidden) != 1 or not self.values:
            return False
        first = self.calibrated[0]
        return first.label == self.hidden[0] and any(
            a * b > 0 for a, b in zip(first.values, self.values[0], strict=True)
        )

    def _held(self, k: int) -> bool:
        """Whether a gap's explanations hold hidden effect `k`, with the true choice if it was fitted."""
        label = self.hidden[k]
        return any(
            label in one.alike
            and (one.label != label or _choice(label, one.values) == _choice(label, self.values[k]))
            for one in self.found
        )


def _choice(label: str, values: Sequence[float]) -> set[float]:
    """Return the choice among several things, such as two cells that are swapped."""
    parameters = catalogue()[split_label(label)[0]].parameters
    return {value for parameter, value in zip(parameters, values, strict=True) if parameter.choices}


@one_blas_thread
def carry_out(case: Case, run: int, seed: int, world: World) -> Outcome:
    """Draw what a case leaves open, measure, discover, compare with the truth.

    Args:
        run: number of the case: its random streams depend on it and `seed` alone.
    """
    drawing, laboratory, discovering = np.random.SeedSequence(seed, spawn_key=(3, run)).spawn(3)
    rng, robot, plan = np.random.default_rng(drawing), world.robot, world.plan
    failed, engine = "", "dynamics" if case.dynamics else "statics"
    for stream in laboratory.generate_state(MOST_TRIES).tolist():
        try:
            trial = draw_trial(case, world, stream, rng)
            measured = trial.laboratory.run(plan, stream, engine, workers=1).measurements
            if len(np.unique(measured.posture)) < LEAST_STANDING * len(plan):
                raise InputError(f"only {len(measured)} of {len(plan)} postures stand")
        except InputError as error:  # the robot falls, or the effect cannot be built on this robot
            failed = str(error)
            continue
        break
    else:
        return Outcome(case, failed=failed)
    if case.arm == SCATTER:  # the data sheet does not know how the plates scatter
        sheet = replace(measured.sensors, placement_sd=PRESETS[world.preset].placement_sd)
        measured = replace(measured, sensors=sheet)
    known = Outcome(
        case,
        hidden=tuple(one.label for one in trial.faults) or ((trial.label,) if trial.label else ()),
        values=tuple(one.values for one in trial.faults),
        twins=trial.twins,
        right=trial.right,
    )
    without = case.kinds if case.arm == LEFT_OUT else ()
    effects = {name: one for name, one in catalogue().items() if name not in without}
    began = time.process_time()
    try:
        found = discover(measured, robot, int(discovering.generate_state(1)[0]), effects)
    except InputError:
        return replace(known, verdict="refused")
    known = replace(known, seconds=time.process_time() - began)
    return _judged(known, trial, found, trial.laboratory.true_base_parameters(plan))


def _judged(known: Outcome, trial: Trial, found: Discovery, truth: np.ndarray) -> Outcome:
    """Add what a discovery said.

    Args:
        truth: base parameters, (p,) [m].
    """
    calibration = found.selection.calibration
    half = t_ppf(0.975, calibration.interval_dof) * np.sqrt(np.diag(calibration.covariance))
    hidden = {one.label: one.values for one in trial.laboratory.hidden}
    numbers = [
        (value, interval)
        for one in found.calibrated
        for value, interval in zip(
            hidden.get(one.label, len(one.values) * (0.0,)), one.intervals, strict=True
        )
        if interval is not None
    ]
    return replace(
        known,
        verdict=found.verdict,
        found=tuple(_found(found, k) for k in found.effects),
        calibrated=tuple(
            Found(one.label, one.values) for one in sorted(found.calibrated, key=_clearness, reverse=True)
        ),
        sizes=tuple(held for one in trial.faults for held in _sizes_held(found, one)),
        members=tuple(bool(low <= value <= high) for value, (low, high) in numbers),
        base=tuple((np.abs(calibration.theta - truth) <= half).tolist()),
    )


def _found(found: Discovery, k: int) -> Found:
    term = found.fit.terms[k]
    alike = tuple(one.label for one in found.equivalents[k])
    return Found(term.label, tuple(term.values), alike, _description(term.candidate))


def _clearness(one: EffectInstance) -> float:
    """Return the largest of an imperfection's values over the width of its interval."""
    known = [(v, i) for v, i in zip(one.values, one.intervals, strict=True) if i is not None]
    return max((abs(v) / max(high - low, 1e-300) for v, (low, high) in known), default=0.0)


def _sizes_held(found: Discovery, hidden: EffectInstance) -> list[bool]:
    """Return whether the interval of each size of a correctly named effect holds the truth."""
    if found.verdict not in (NAMED, AMBIGUOUS):
        return []
    named = [k for k in found.effects if found.fit.terms[k].label == hidden.label]
    every = [(with_intervals(found.fit, k).intervals[j], j) for k in named for j in hidden.effect.sizes]
    return [bool(i[0] <= hidden.values[j] <= i[1]) for i, j in every if i is not None]


def _description(candidate: Candidate) -> tuple[Description, ...]:
    """Return what errs as a function of what by a law, or by an effect that says what a law could."""
    if is_law(candidate):
        sentence = Sentence(*candidate.target.split("/"))
        return ((sentence.what, sentence.of),)
    as_law = [(kind, of) for (kind, of, _), name in CATALOGUED.items() if name == candidate.effect.name]
    return tuple((f"{kind}:{candidate.target}", of) for kind, of in as_law[-1:])
