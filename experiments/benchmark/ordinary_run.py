"""One case of an ordinary world carried out: draw a laboratory, measure, discover, compare with the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.calibration.self_calibration import self_calibrate, usual_tolerances
from tulip_testbed.discovery.candidate_search import calibrated_data
from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.detectability import single_level
from tulip_testbed.discovery.discover import discover
from tulip_testbed.discovery.evidence import effective_tests
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.discovery.unusual_members import STANDS_OUT
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance, effect_label
from tulip_testbed.effects.random_effects import draw_of_kind
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.experiments.benchmark import judged
from tulip_testbed.experiments.benchmark.case_outcome import Outcome
from tulip_testbed.experiments.benchmark.cases import OUTSIDE_ARM, Case
from tulip_testbed.experiments.benchmark.ordinary_cases import CLEAR, PRIOR, SCATTER, TWICE
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.scoreboard import angles, visible, wanted
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.sensors import PRESETS

ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass, see `sim.random_robots`
SCATTERED = (0.5, 3.0)  # times the data sheet's placement_sd
AMPLITUDES = (1.0, 4.0)  # of faults that the catalogue lacks, times the typical one
CLEARLY = (1.0, 2.0)  # times the least size that is clear
LEAST_STANDING = 0.75  # of a plan's postures: a laboratory in which more fall would not go on
MULTIPLE = 4.0  # of the minimum detectable size
MOST_PRIORS = 4.0  # s.d.: no larger effect is hidden
MOST_TRIES = 20


@dataclass(frozen=True)
class Trial:
    """A laboratory and what is wrong with it.

    Attributes:
        hidden: effects of the catalogue. label: of a fault outside of it, or "".
        twins: for every hidden effect labels of what can look like it.
    """

    laboratory: Laboratory
    hidden: tuple[EffectInstance, ...] = ()
    label: str = ""
    twins: tuple[tuple[str, ...], ...] = ()


def carry_out(case: Case, run: int, seed: int, preset: str, robot: Robot, plan: PosturePlan) -> Outcome:
    """Draw what a case leaves open, measure, discover, compare with the truth.

    Args:
        run: number of the case: its random streams depend on it and `seed` alone.
    """
    drawing, laboratory, discovering = np.random.SeedSequence(seed, spawn_key=(3, run)).spawn(3)
    rng = np.random.default_rng(drawing)
    known = Outcome(run, case.arm, case.kinds, 0.0, case.dynamics, imperfect=case.imperfect)
    failed = ""
    for stream in laboratory.generate_state(MOST_TRIES).tolist():
        try:
            trial = _trial(case, stream, preset, robot, plan, rng)
            measured = trial.laboratory.run(
                plan, stream, "dynamics" if case.dynamics else "statics", workers=1
            ).measurements
            if len(np.unique(measured.posture)) < LEAST_STANDING * len(plan):
                raise InputError(f"only {len(measured)} of {len(plan)} postures stand")
        except InputError as error:  # the robot falls, or the effect cannot be built on this robot
            failed = str(error)
            continue
        break
    else:
        return replace(known, failed=failed)
    known = replace(
        known,
        multiple=MULTIPLE if case.arm in (CLEAR, TWICE) else 0.0,
        hidden=tuple(one.label for one in trial.hidden) or ((trial.label,) if trial.label else ()),
        values=tuple(one.values for one in trial.hidden),
        twins=trial.twins,
        rows=len(measured),
    )
    if case.arm == SCATTER:  # the data sheet does not know how the plates scatter
        measured = replace(
            measured, sensors=replace(measured.sensors, placement_sd=PRESETS[preset].placement_sd)
        )
    began = time.process_time()
    try:
        found = discover(measured, robot, int(discovering.generate_state(1)[0]))
    except InputError:
        return replace(known, verdict="refused")
    return replace(
        known,
        cpu_s=time.process_time() - began,
        wall_s=found.wall_s,
        verdict=found.verdict,
        found=judged.found_effects(found),
        calibrated=judged.calibrated_members(found),
        coverage=tuple(c for one in trial.hidden for c in judged.covered(found, one, of_time=False)),
        times=tuple(c for one in trial.hidden for c in judged.covered(found, one, of_time=True)),
        members=judged.members_covered(found, trial.laboratory.hidden),
        base=judged.base_covered(found, trial.laboratory.true_base_parameters(plan)),
    )


def _trial(
    case: Case, stream: int, preset: str, robot: Robot, plan: PosturePlan, rng: np.random.Generator
) -> Trial:
    rig = preset_rig(preset, robot)
    if case.arm == SCATTER:
        return Trial(Laboratory(robot, preset, nominal=_scattered(rig, float(rng.uniform(*SCATTERED)))))
    spread = float(rng.uniform(*ROBOTS))
    rig = edited(rig, edit_of(robot.model, draw_robot(robot.model, spread, rng)))
    members = ordinary_members(rig, rng) if case.imperfect else ()
    if case.arm == OUTSIDE_ARM:
        rig, label = _outside(case.kinds[0], rig, rng)
        return Trial(Laboratory(robot, preset, hidden=members, nominal=rig), label=label)
    faults: tuple[EffectInstance, ...] = ()
    twins: tuple[tuple[str, ...], ...] = ()
    if case.arm == PRIOR:
        numbers = tuple(int(number) for number in np.unique(plan.placement))
        faults = (draw_of_kind(catalogue()[case.kinds[0]], robot, numbers, rng),)
    elif case.arm in (CLEAR, TWICE):
        without = Laboratory(robot, preset, hidden=members, nominal=rig).run(plan, stream, "statics")
        observed = observe(without.measurements, nominal_robot(robot))
        faults, twins = _clear(case.kinds[0], 1 + (case.arm == TWICE), observed, rng)
    labels = {one.label for one in faults}
    hidden = (*(one for one in members if one.label not in labels), *faults)
    return Trial(Laboratory(robot, preset, hidden=hidden, nominal=rig), faults, twins=twins)


def _scattered(rig: Rig, factor: float) -> Rig:
    (px, py, pa), (mx, my, ma) = factor * np.array([rig.sensors.placement_sd, rig.sensors.mark_sd])
    return replace(rig, sensors=replace(rig.sensors, placement_sd=(px, py, pa), mark_sd=(mx, my, ma)))


def _outside(name: str, rig: Rig, rng: np.random.Generator) -> tuple[Rig, str]:
    (fault,) = [one for one in OUTSIDE if one.name == name]
    number = int(rng.integers(1000))
    size = fault.amplitude * float(np.exp(rng.uniform(*np.log(AMPLITUDES))))
    size *= 1.0 if fault.positive else float(rng.choice([-1.0, 1.0]))
    return fault.inject(rig, number, size), f"{effect_label(name, str(number))}={size:.3g}"


def _clear(
    kind: str, count: int, observed: Observation, rng: np.random.Generator
) -> tuple[tuple[EffectInstance, ...], tuple[tuple[str, ...], ...]]:
    """Draw effects of one kind, on different targets, that this laboratory shows beyond its imperfections.

    Args:
        observed: the laboratory without them.

    Raises:
        InputError: no plausible size of this kind is clear.
    """
    linear = calibrated_data(observed, self_calibrate(observed)).null.linear
    columns = candidate_columns(linear, candidates(observed))
    level = single_level(LEVEL, effective_tests([columns], rng))
    every = zip(columns.candidates, columns.projected, strict=True)
    bases = [[visible(candidate, column) for column in each] for candidate, each in every]
    tolerance = usual_tolerances(observed, None).value.get(kind, 0.0)
    own = [k for k, one in enumerate(columns.candidates) if one.effect.name == kind]
    chosen, twins = [], []
    for k in rng.permutation(own).tolist():
        candidate = columns.candidates[k]
        point = int(rng.integers(len(candidate.settings)))
        column = columns.projected[k][point]
        sizes = _clear_sizes(candidate, column, wanted(candidate, level), tolerance, rng)
        if sizes is None:
            continue
        signal = column @ sizes if len(sizes) else column[:, 0]
        near = angles(signal, columns.candidates, bases)
        twins.append(tuple(label for label, a in near.items() if a < ISOLABLE and label != candidate.label))
        chosen.append(EffectInstance(candidate.effect, candidate.target, candidate.values(sizes, point)))
        if len(chosen) == count:
            return tuple(chosen), tuple(twins)
    raise InputError(f"{kind}: no plausible size is clear in this laboratory")


def _clear_sizes(
    candidate: Candidate, column: np.ndarray, least: float, tolerance: float, rng: np.random.Generator
) -> np.ndarray | None:
    """Draw sizes that are clear; None: they would be implausible."""
    if not candidate.effect.sizes:
        return np.zeros(0) if np.linalg.norm(column) >= MULTIPLE * least else None
    along = candidate.prior * rng.standard_normal(len(candidate.prior))
    along = np.where(candidate.positive, np.abs(along), along)
    length = max(float(np.linalg.norm(column @ along)), 1e-300)
    beyond = STANDS_OUT * tolerance / float(np.abs(along).max())
    sizes = along * max(MULTIPLE * least / length, beyond) * float(rng.uniform(*CLEARLY))
    return sizes if (np.abs(sizes) <= MOST_PRIORS * candidate.prior).all() else None
