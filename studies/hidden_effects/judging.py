"""Carry out one case and compare what the tool says with the truth."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from studies.hidden_effects.hiding import LEAST_STANDING, ONE, TWO, Case, Truth, draw_trial, hidden_kinds
from studies.hidden_effects.laboratories import USUAL, Built
from studies.hidden_effects.readings import Values
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.discover import AMBIGUOUS, DESCRIBED, NAMED, Discovery, discover
from tulip_testbed.discovery.law_candidates import is_law
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, split_label
from tulip_testbed.effects.laws.grammar import CATALOGUED
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.robot import Robot

SURE = ("none", "calibrated", "named", "described")  # verdicts that say that the model is complete
REFUSED = "refused"
MOST_TRIES = 8


@dataclass(frozen=True)
class Found:
    """One effect of a discovery: label, values [SI], and what errs by a law or by an effect that says it."""

    label: str
    values: Values = ()
    errs: str = ""


@dataclass(frozen=True)
class Outcome:
    """One case and what was said of it.

    Attributes:
        run: number of the case. failed: why there was no data set, or "".
        verdict: of the discovery, or `REFUSED`. found: its effects, the best first.
        sizes, members: whether the 95 % interval of each adopted size, and of each member that the data
            determine, holds the truth, by effect.
        base: errors of the base parameters after the tool's own correction, in standard errors.
        held: whether their 95 % intervals hold the truth.
        seconds: of CPU of the discovery.
    """

    case: Case
    run: int
    truth: Truth = field(default_factory=Truth)
    failed: str = ""
    verdict: str = ""
    found: tuple[Found, ...] = ()
    sizes: Mapping[str, tuple[bool, ...]] = field(default_factory=dict)
    members: Mapping[str, tuple[bool, ...]] = field(default_factory=dict)
    base: tuple[float, ...] = ()
    held: tuple[bool, ...] = ()
    seconds: float = 0.0

    @property
    def named(self) -> tuple[Found, ...]:
        """Return what is named, perhaps with others that are alike."""
        return self.found if self.verdict in (NAMED, AMBIGUOUS, DESCRIBED) else ()

    @property
    def alike(self) -> bool:
        """Whether all that is hidden is of one kind."""
        return len(set(self.case.kinds)) == 1

    @property
    def first(self) -> bool:
        """Whether what is hidden is the first that is named."""
        return any(self._hidden(one) for one in self.named[:1])

    @property
    def both(self) -> bool:
        """Whether all that is hidden is named, and nothing wrong."""
        found = {one.label for one in self.named if self._hidden(one)}
        return found == set(self.truth.hidden) and not self.wrong

    @property
    def wrong(self) -> bool:
        """Whether a cause is reported as certain, and it is wrong."""
        return self.verdict in (NAMED, DESCRIBED) and not all(map(self._right, self.found))

    def _right(self, one: Found) -> bool:
        """Whether it is hidden, an ordinary member that stands out, or a law of what errs."""
        targets = {split_label(label)[1] for label in self.truth.hidden} - {""}
        errs = {one.errs, one.label} & set(self.truth.culprits) or one.errs.partition(":")[2] in targets
        return self._hidden(one) or one.label in self.truth.large or bool(errs)

    def _hidden(self, one: Found) -> bool:
        """Whether an effect is hidden, with the true choice among several things, such as swapped cells."""
        if one.label not in self.truth.hidden:
            return False
        parameters = catalogue()[split_label(one.label)[0]].parameters
        both = (one.values, self.truth.hidden[one.label])
        said, true = ({v for p, v in zip(parameters, values, strict=True) if p.choices} for values in both)
        return said == true


def drawn(
    case: Case, run: int, seed: int, robot: Robot, plan: PosturePlan
) -> tuple[Case, Built, Truth, Measurements, int]:
    """Draw what a case leaves open and measure; return also a seed for the discovery.

    Where no effect of its kinds shows, others take their places.

    Args:
        run: number of the case: its random streams depend on it and `seed` alone.

    Raises:
        InputError: every robot falls, or no effect of the kind shows.
    """
    drawing, laboratory, discovering = np.random.SeedSequence(seed, spawn_key=(3, run)).spawn(3)
    rng, failed = np.random.default_rng(drawing), ""
    for stream in laboratory.generate_state(MOST_TRIES).tolist():
        try:
            built, truth = draw_trial(case, robot, plan, stream, rng)
            measured = built.measured(plan, stream, case.dynamics)
        except InputError as error:
            failed = str(error)
            if case.arm in (ONE, TWO):
                other = dict(zip(case.kinds, rng.permutation(hidden_kinds()).tolist(), strict=False))
                case = replace(case, kinds=tuple(other[kind] for kind in case.kinds))
            continue
        if len(np.unique(measured.posture)) >= LEAST_STANDING * len(plan):
            return case, built, truth, measured, int(discovering.generate_state(1)[0])
        failed = f"only {len(measured)} of {len(plan)} postures stand"
    raise InputError(failed)


@one_blas_thread
def carry_out(case: Case, run: int, seed: int, robot: Robot, plan: PosturePlan) -> Outcome:
    """Draw, measure, discover, correct as the tool says, identify, compare with the truth."""
    try:
        case, built, truth, measured, discovering = drawn(case, run, seed, robot, plan)
    except InputError as error:
        return Outcome(case, run, failed=str(error))
    began, known = time.process_time(), Outcome(case, run, truth)
    try:
        found = discover(measured, robot, discovering)
        known = replace(known, seconds=time.process_time() - began)
        calibration = identify(measured, robot, adopted=found.adopted).calibration
    except InputError as error:
        return replace(known, verdict=REFUSED, found=(Found(str(error)),))
    assert calibration is not None
    off = calibration.theta - true_base_parameters(built.physical)
    off /= np.sqrt(np.diag(calibration.covariance))
    adopted = {one.label: one for one in found.adopted}
    members = {
        one.family.name: tuple(
            held
            for member, known in zip(
                one.instances, one.determined.reshape(len(one.family.targets), -1), strict=True
            )
            if member.label not in adopted
            for held in _held(member, built, known.tolist())
        )
        for one in calibration.families
        if one.family.name in USUAL  # zeros wander in other ways than by the waves of their families
    }
    return replace(
        known,
        verdict=found.verdict,
        found=said(found),
        sizes={label: _held(one, built) for label, one in adopted.items() if label in built.effects},
        members=members,
        base=tuple(off.tolist()),
        held=tuple((np.abs(off) <= t_ppf(0.975, calibration.interval_dof)).tolist()),
    )


def said(found: Discovery) -> tuple[Found, ...]:
    """Return the effects of a discovery, the best first."""
    terms = [found.fit.terms[k] for k in found.effects]
    return tuple(Found(t.label, tuple(t.values), _errs(t.candidate)) for t in terms)


def _held(one: EffectInstance, built: Built, known: Sequence[bool] = ()) -> tuple[bool, ...]:
    """Return whether the intervals of an effect's numbers, or of those that are known, hold the truth."""
    truth = built.effects.get(one.label, (0.0,) * len(one.values))
    every = zip(one.intervals, truth, known or [True] * len(truth), strict=True)
    return tuple(bool(i[0] <= value <= i[1]) for i, value, sure in every if i is not None and sure)


def _errs(candidate: Candidate) -> str:
    if is_law(candidate):
        return candidate.target.split("/")[0]
    kinds = [kind for (kind, _, _), name in CATALOGUED.items() if name == candidate.effect.name]
    return f"{kinds[-1]}:{candidate.target}" if kinds else ""
