"""Simulate an experiment and write its measurements, apart from its truth."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import present
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.effects.random_effects import RANDOM, read_effects
from tulip_testbed.experiments.defaults import DEFAULT_SEED
from tulip_testbed.experiments.imperfections import check_imperfections, drawn, single_stream
from tulip_testbed.experiments.laboratory import Laboratory, tries
from tulip_testbed.experiments.proposed_experiment import EXPERIMENT_FILE, read_experiment
from tulip_testbed.experiments.truth_record import (
    DroppedPosture,
    check_places,
    usable_postures,
    write_experiment,
)
from tulip_testbed.experiments.usable_plan import plan_for
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.trajectory import runs
from tulip_testbed.sim.procedure import header_of


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """Outcome of a simulated experiment, without its truth.

    Attributes:
        measurements: folder. postures_planned, rows: how many there are.
        dropped: postures that could not be measured, or segments of which not all could.
        segments, seconds: how many motions were measured, and their time; None: postures were held.
    """

    measurements: str
    postures_planned: int
    rows: int
    dropped: tuple[DroppedPosture, ...]
    segments: int | None = None
    seconds: float | None = None

    def tables(self) -> list[Table | str]:
        if self.seconds is not None:
            cut = [f"  segment {one.posture} was cut: {one.reason or 'not told'}" for one in self.dropped]
            measured = f"{self.segments} segments, {self.seconds / 60:.1f} min, are {self.rows} rows."
            return [measured, *cut, f"Measurement folder: {self.measurements}"]
        reasons = [posture.reason for posture in self.dropped]
        usable = usable_postures(self.postures_planned, self.rows, reasons)
        return [*usable, f"Measurement folder: {self.measurements}"]


def simulate(
    laboratory: Laboratory,
    plan: PosturePlan | Path | None,
    out: Path,
    seed: int = DEFAULT_SEED,
    truth: Path | None = None,
    effects: Sequence[str] = (),
    imperfections: float = 0.0,
    robot_spread: float | None = None,
    experiment: Path | None = None,
    session: str | None = None,
    engine: str = "dynamics",
    workers: int | None = None,
    progress: Progress = silent,
) -> Simulation:
    """Simulate, see `tulip_testbed.simulate`; without a plan that of `experiment`, or the shipped one."""
    check_places(out, truth)
    secret = RANDOM in effects
    if secret and truth is None:
        raise InputError(
            "effects random: found no file for the truth, expected `truth=FILE`: nothing else would know it"
        )
    wanted, number = (None, 1) if experiment is None else read_experiment(experiment)
    if experiment is not None and plan is not None:
        raise InputError("experiment: found a plan besides, expected the plan of its own folder")
    if isinstance(plan, Path) and present(plan / EXPERIMENT_FILE):
        raise InputError(
            f"{plan}: found {EXPERIMENT_FILE}, expected it as `experiment={plan}`: a plain plan would leave "
            "its manipulations out"
        )
    made = plan if isinstance(plan, PosturePlan) else plan_for(laboratory.robot, plan or experiment)
    laboratory = _disturbed(laboratory, made, effects, seed, engine == "statics")
    check_imperfections(laboratory, imperfections)
    if robot_spread is not None:
        laboratory = dataclasses.replace(laboratory, random_robot=(robot_spread, seed))
    laboratory = drawn(laboratory, imperfections, single_stream(seed))
    if wanted is not None or session is not None:
        texts = () if wanted is None else wanted.manipulations
        there = "" if wanted is None else wanted.session
        laboratory = laboratory.manipulated(*texts, session=there if session is None else session)
    # The laboratory is that of the seed; its noise differs from experiment to experiment.
    noise = seed if number == 1 else int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    try:
        with progress("holding postures", tries(laboratory, made), 0) as advance:
            run = laboratory.run(made, noise, engine, workers, advance)
    except InputError:
        if not secret:
            raise
        raise InputError(
            "effects random: found an experiment that cannot be carried out with the effect that seed "
            f"{seed} draws, expected one that can; give another seed"
        ) from None
    write_experiment(out, truth, run)
    dropped = tuple(DroppedPosture(number, None if secret else why) for number, why in run.truth.dropped)
    made_of = (str(out), run.plan.postures, len(run.measurements), dropped)
    if run.samples is None:
        return Simulation(*made_of)
    segments = runs(run.samples.posture)
    return Simulation(*made_of, len(segments), sum(float(np.ptp(run.samples.time[s])) for s in segments))


def _disturbed(
    laboratory: Laboratory, plan: PosturePlan, effects: Sequence[str], seed: int, statics: bool
) -> Laboratory:
    """Hide effects in a laboratory; random ones are the seed's."""
    placements = np.unique(plan.placement).tolist()
    contacts = header_of(laboratory.rig).contacts
    hidden = read_effects(effects, laboratory.robot, placements, seed, statics, "effects", contacts)
    for text, instance in zip(effects, hidden, strict=True):
        try:
            laboratory = laboratory.with_effects(instance)
        except InputError:
            if text != RANDOM:
                raise
            raise InputError(
                "effects random: found a laboratory that cannot be built, expected one that can; give "
                "another seed"
            ) from None
    return laboratory
