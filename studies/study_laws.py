"""Laws for faults that nobody listed (docs/studies/laws.md; half a minute a case).

Every laboratory has a random robot, and half of them ordinary imperfections. Outside faults are drawn at a
multiple of the smallest size that such a laboratory shows. The right answers, what errs and as a function of
what, are in studies/law_answers.py. The part `opened` runs every fault of
tulip_testbed/experiments/benchmark/unseen_faults.py once. They were unseen until they showed what the first
search for laws lacked; since then they are development faults. The part `unseen` does the same with
tulip_testbed/experiments/benchmark/second_unseen_faults.py, which were opened when everything was fixed.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from studies.law_answers import ANSWERS, Answers, is_right, said_by
from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.candidate_search import calibrated_data
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.detectability import noncentrality, single_level
from tulip_testbed.discovery.discover import ADOPTED, CALIBRATED, DESCRIBED, Discovery, discover
from tulip_testbed.discovery.evidence import effective_tests
from tulip_testbed.discovery.law_candidates import is_law
from tulip_testbed.discovery.refit import simulated, without_noise
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance, injected
from tulip_testbed.effects.instruments import effects_on
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.benchmark.ordinary_run import LEAST_STANDING, _clear
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE, Outside
from tulip_testbed.experiments.benchmark.score import Figure, median, rate
from tulip_testbed.experiments.benchmark.second_unseen_faults import ANSWERS as SECOND_ANSWERS
from tulip_testbed.experiments.benchmark.second_unseen_faults import SECOND
from tulip_testbed.experiments.benchmark.unseen_faults import ANSWERS as UNSEEN_ANSWERS
from tulip_testbed.experiments.benchmark.unseen_faults import UNSEEN
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot

PRESETS = ("force-plate", "wii")
# Faults that all are run once, and how much larger the seed is with which they are drawn.
DOZENS = {"opened": (UNSEEN, 1000), "unseen": (SECOND, 2000)}
SETTINGS = Settings(seed=7000, only=(*PRESETS, *DOZENS))
OUTSIDE_ARM, CATALOGUE, NOTHING = "outside", "catalogue", "nothing"
FULL = {OUTSIDE_ARM: 5, CATALOGUE: 60, NOTHING: 60}  # cases of a fault, of the other arms
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass
MULTIPLES = (4.0, 16.0)  # of the minimum detectable size
TRIAL = 0.1  # of a fault's typical amplitude, to measure what it shows
MOST_TRIES = 10
EVERY_ANSWER = {**ANSWERS, **UNSEEN_ANSWERS, **SECOND_ANSWERS}
BIASED = 1.0  # standard error: a bias that ought to be removed


@dataclass(frozen=True)
class Case:
    """One laboratory and what discovery said of it.

    Attributes:
        arm: "outside", "catalogue" or "nothing". name: of the fault or the effect that is hidden.
        size: of the fault [its unit]. multiple: of the minimum detectable size.
        answers: that are right. failed: why there is no case, or "".
        verdict: of the discovery. adopted: effects and laws.
        first: (what, of) of the laws, and of effects of the catalogue that say as much, in order.
        also: of the laws that do as well.
        before, after, floor: r.m.s. of held-out residuals over their noise. closed: whether every channel is
            within chance.
        bias: r.m.s. over the base parameters in standard errors before and after; None: below `BIASED`.
        cpu_s: of the discovery.
    """

    arm: str
    name: str
    preset: str
    run: int
    size: float = 0.0
    multiple: float = 0.0
    answers: Answers = ()
    failed: str = ""
    verdict: str = ""
    adopted: tuple[str, ...] = ()
    first: tuple[tuple[str, str], ...] = ()
    also: tuple[tuple[str, str], ...] = ()
    before: float = np.nan
    after: float = np.nan
    floor: float = np.nan
    closed: bool = False
    bias: tuple[float, float] | None = None
    cpu_s: float = 0.0

    @property
    def right_first(self) -> bool:
        """Whether the first law's what and of are right, or those of an effect of the catalogue."""
        return self.verdict in ADOPTED and any(is_right(one, self.answers) for one in self.first[:1])

    @property
    def in_set(self) -> bool:
        """Whether a law or one that does as well is right."""
        told = (*self.first, *self.also)
        return self.verdict in ADOPTED and any(is_right(one, self.answers) for one in told)

    @property
    def wrong(self) -> bool:
        """Return whether a single cause is reported, and it is wrong."""
        return self.verdict in ADOPTED and not self.in_set


def study(settings: Settings) -> Iterator[str]:
    """Yield the figures of the development faults at each preset, and of the unseen ones."""
    for number, preset in enumerate(PRESETS):
        if preset in settings.only:
            calls = _calls(preset, settings.seed + number, settings)
            cases = settings.parallel(preset, carry_out, calls)
            yield from _report(preset, cases, settings)
            yield "\nCases:\n"
            yield from (f"- {describe(case)}" for case in cases)
    for part, (faults, later) in DOZENS.items():
        if part in settings.only:
            cases = []
            for run, fault in enumerate(faults):
                cases.append(carry_out(OUTSIDE_ARM, fault, PRESETS[0], settings.seed + later, run))
                yield f"- {describe(cases[-1])}"
            yield from _report(part, cases, settings)


def _calls(preset: str, seed: int, settings: Settings) -> list[tuple[Any, ...]]:
    """List the cases of all arms with the development faults, as arguments of `carry_out`."""
    kinds = [effect.name for effect in effects_on(None, statics=True)]
    order = np.random.default_rng(seed).permutation(len(kinds)).tolist()
    calls: list[tuple[Any, ...]] = [
        (OUTSIDE_ARM, fault, preset, seed, k * len(OUTSIDE) + j)
        for k in range(settings.count(FULL[OUTSIDE_ARM]))
        for j, fault in enumerate(OUTSIDE)
    ]
    calls += [
        (CATALOGUE, kinds[order[k % len(kinds)]], preset, seed, 10_000 + k)
        for k in range(settings.count(FULL[CATALOGUE]))
    ]
    return calls + [(NOTHING, "", preset, seed, 20_000 + k) for k in range(settings.count(FULL[NOTHING]))]


def _report(part: str, cases: Sequence[Case], settings: Settings) -> Iterator[str]:
    """Yield the table of some cases and keep them."""
    path = settings.folder("laws") / f"{part}.json"
    path.write_text(json.dumps([asdict(case) for case in cases]), encoding="utf-8")
    yield f"\n**{part}**, {len(cases)} cases, {sum(bool(c.failed) for c in cases)} without data\n"
    yield header("figure", "value", "95 % interval", "of", "must reach")
    for figure in figures(cases):
        if figure.count:
            yield _row(figure)


def figures(cases: Sequence[Case]) -> list[Figure]:
    """Compute all figures with exact intervals (Clopper and Pearson 1934)."""
    known = [case for case in cases if not case.failed]
    outside = [case for case in known if case.arm == OUTSIDE_ARM]
    catalogue = [case for case in known if case.arm == CATALOGUE]
    ordinary = [case for case in known if case.arm == NOTHING]
    biased = [1 - case.bias[1] / case.bias[0] for case in outside if case.bias is not None]
    return [
        rate("outside: gap closed to its chance level", (c.closed for c in outside), least=0.8),
        rate("outside: what and of, right first", (c.right_first for c in outside), least=0.75),
        rate("outside: right, in the set", (c.in_set for c in outside), least=0.9),
        median("outside: bias of the base parameters removed", biased, least=0.7),
        rate("outside: described", (c.verdict == DESCRIBED for c in outside)),
        rate("outside: confidently wrong", (c.wrong for c in outside), most=0.05),
        rate("catalogue is true: described", (c.verdict == DESCRIBED for c in catalogue), most=0.03),
        rate("ordinary: described or named", (c.verdict in ADOPTED for c in ordinary), most=0.03),
        median("CPU of a discovery [s], outside", (c.cpu_s for c in outside)),
    ]


def _row(figure: Figure) -> str:
    need = f">= {figure.least:g}" if figure.least is not None else ""
    need = f"<= {figure.most:g}" if figure.most is not None else need
    interval = f"{figure.low:.2f} to {figure.high:.2f}"
    return row(figure.name, f"{figure.value:.2f}", interval, figure.count, need)


def describe(case: Case) -> str:
    """Tell a case in one line."""
    if case.failed:
        return f"{case.arm} {case.name}: {case.failed}"
    mark = {True: "right", False: "in set"}[case.right_first] if case.in_set else "-"
    bias = "" if case.bias is None else f", bias {case.bias[0]:.1f} -> {case.bias[1]:.1f} s.e."
    return (
        f"{case.arm} {case.name}={case.size:.2g} ({case.multiple:.0f} MDE, {case.answers[:1]}): "
        f"{case.verdict}, {mark}; {list(case.adopted)}, also {list(case.also)}; held-out {case.before:.2f} "
        f"-> {case.after:.2f} (chance {case.floor:.2f}, closed: {case.closed}){bias}; {case.cpu_s:.0f} s"
    )


@one_blas_thread
def carry_out(arm: str, hidden: Outside | str, preset: str, seed: int, run: int) -> Case:
    """Draw a laboratory, measure, discover, compare with the truth."""

    drawing, laboratory = np.random.SeedSequence(seed, spawn_key=(9, run)).spawn(2)
    rng = np.random.default_rng(drawing)
    name = hidden.name if isinstance(hidden, Outside) else hidden
    known = Case(arm, name, preset, run)
    robot = load_robot()
    plan, why = shipped_plan(robot), ""
    for stream in laboratory.generate_state(MOST_TRIES).tolist():
        try:
            with_fault, plain, known = _drawn(known, hidden, robot, plan, stream, rng)
            measured = with_fault.run(plan, stream, "statics", workers=1).measurements
            if len(np.unique(measured.posture)) < LEAST_STANDING * len(plan):
                raise InputError(f"only {len(measured)} of {len(plan)} postures stand")
        except InputError as error:  # the robot falls, or the fault cannot be built
            why = str(error)
            continue
        break
    else:
        return replace(known, failed=why)
    began = time.process_time()
    try:
        found = discover(measured, robot, seed)
    except InputError as error:
        return replace(known, verdict=f"refused: {error}")
    known = replace(known, cpu_s=time.process_time() - began)
    known = _said(known, found)
    if arm != OUTSIDE_ARM:
        return known
    return replace(known, bias=_bias(found, with_fault.rig, plain.rig, robot, plan))


def _drawn(
    known: Case, hidden: Outside | str, robot: Robot, plan: PosturePlan, stream: int, rng: np.random.Generator
) -> tuple[Laboratory, Laboratory, Case]:
    """Draw a laboratory with and without what is hidden."""
    rig = preset_rig(known.preset, robot)
    rig = edited(rig, edit_of(robot.model, draw_robot(robot.model, float(rng.uniform(*ROBOTS)), rng)))
    imperfect = known.arm == NOTHING or known.run % 2 == 0
    members = ordinary_members(rig, rng) if imperfect else ()
    plain = Laboratory(robot, known.preset, hidden=members, nominal=rig)
    if known.arm == NOTHING:
        return plain, plain, known
    measured = plain.run(plan, stream, "statics", workers=1).measurements
    if isinstance(hidden, str):
        (fault,), _ = _clear(hidden, 1, observe(measured, nominal_robot(robot)), rng)
        rest = tuple(one for one in members if one.label != fault.label)
        found = Laboratory(robot, known.preset, hidden=(*rest, fault), nominal=rig)
        return found, plain, replace(known, size=max(map(abs, fault.values)), answers=((fault.label, "*"),))
    number = int(rng.integers(1000))
    answers = tuple(sorted(EVERY_ANSWER[hidden.name](robot, number)))
    multiple = float(np.exp(rng.uniform(*np.log(MULTIPLES))))
    sign = 1.0 if hidden.positive else float(rng.choice([-1.0, 1.0]))
    size = sign * multiple * _least(hidden, number, measured, plain, plan, rng)
    faulty = hidden.inject(rig, number, size)
    found = Laboratory(robot, known.preset, hidden=members, nominal=faulty)
    return found, plain, replace(known, size=size, multiple=multiple, answers=answers)


def _least(
    fault: Outside,
    number: int,
    measured: Measurements,
    plain: Laboratory,
    plan: PosturePlan,
    rng: np.random.Generator,
) -> float:
    """Return the least size that a test of one size would find with 90 % probability in this laboratory.

    The change by the fault is simulated without noise: a scene that is edited draws other random numbers.
    """
    robot = plain.robot
    observed = observe(measured, nominal_robot(robot))
    linear = calibrated_data(observed, self_calibrate(observed)).null.linear
    columns = candidate_columns(linear, candidates(observed))
    level = single_level(LEVEL, effective_tests([columns], rng))
    trial = TRIAL * fault.amplitude
    assert plain.nominal is not None
    rigs = plain.nominal, fault.inject(plain.nominal, number, trial)
    without, within = (_quiet(injected(rig, plain.hidden), plan, measured) for rig in rigs)
    change = residuals(observe(within, nominal_robot(robot)), linear.theta)
    change = change - residuals(observe(without, nominal_robot(robot)), linear.theta)
    signal = linear.project(linear.whitening(change[..., None]))
    length = float(np.linalg.norm(signal))
    if length < 1e-6:
        raise InputError("the fault shows nothing")
    return trial * float(np.sqrt(noncentrality(1, level))) / length


def _quiet(rig: Rig, plan: PosturePlan, measured: Measurements) -> Measurements:
    """Return the rows that were measured without noise; those of a repeated posture are alike."""
    found = simulated(without_noise(rig), plan)
    if missing := set(measured.posture.tolist()) - set(found.posture.tolist()):
        raise InputError(f"without noise the robot falls in postures {sorted(missing)}")
    rows = {number: row for row, number in enumerate(found.posture.tolist())}
    aligned = found.take(np.array([rows[number] for number in measured.posture.tolist()]))
    return replace(aligned, sensors=measured.sensors)


def _said(known: Case, found: Discovery) -> Case:
    """Add what a discovery said."""
    first, also = [], []
    for k in found.effects:
        term = found.fit.terms[k]
        first += said_by(term.candidate)
        if is_law(term.candidate):
            also += [pair for one in found.equivalents[k] for pair in said_by(one.candidate)]
    held = found.heldout
    adopting = found.verdict in (*ADOPTED, CALIBRATED)
    return replace(
        known,
        verdict=found.verdict,
        adopted=tuple(found.fit.terms[k].label for k in found.effects),
        first=tuple(first),
        also=tuple(one for one in dict.fromkeys(also) if one not in first),
        before=np.nan if held is None else held.before["AFTC"],
        after=np.nan if held is None else held.after["AFTC"],
        floor=np.nan if held is None else held.floor["AFTC"],
        closed=adopting and held is not None and held.holds,
    )


def _bias(
    found: Discovery, faulty: Rig, plain: Rig, robot: Robot, plan: PosturePlan
) -> tuple[float, float] | None:
    """Return the bias of the base parameters by the fault without and with what was adopted, without noise.

    The effect of ordinary imperfections is the same in both and is subtracted.
    """

    def estimate(rig: Rig, adopted: Sequence[EffectInstance] = ()) -> np.ndarray:
        quiet = replace(simulated(without_noise(rig), plan), sensors=header_of(rig).sensors)
        try:
            value = identify(quiet, robot, estimator=DEFAULT, adopted=adopted).full.value
        except InputError:  # a placement that stands no more
            return np.full(len(nominal_robot(robot).value), np.nan)
        return value - true_base_parameters(rig)

    noisy = identify(found.observed.measurements, robot, estimator=DEFAULT).full
    spread = np.sqrt(np.diag(noisy.clustered_covariance))
    start = estimate(plain)
    before = (estimate(faulty) - start) / spread
    if not np.abs(before).max() >= BIASED:
        return None
    after = (estimate(faulty, found.adopted) - start) / spread
    return float(np.sqrt((before**2).mean())), float(np.sqrt((after**2).mean()))
