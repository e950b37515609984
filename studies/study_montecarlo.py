"""Measure the coverage of the estimators by Monte Carlo (docs/studies/coverage.md; hours, resumable).

The part `coverage` includes wrong data sheets and random robots; `dynamics` compares runs in statics with
runs in the full dynamics.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.dataset
from scipy.stats import ks_2samp

from studies.runner import Settings, header, row, shipped_plan
from studies.study_estimators import scaled
from tulip_testbed.cli.terminal import progress
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.coverage import ParameterCoverage
from tulip_testbed.experiments.montecarlo.laboratory_runs import Source, source_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, montecarlo_file
from tulip_testbed.experiments.montecarlo.montecarlo_result import Settings as RunSettings
from tulip_testbed.experiments.montecarlo.montecarlo_run import collect
from tulip_testbed.experiments.montecarlo.run_columns import Layout, RunChunks, RunJob, layout_of, read_runs
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.robot import load_robot

SETTINGS = Settings(seed=401, only=("coverage", "dynamics"))
LEVEL = 0.01  # of all comparisons of statics and dynamics together


@dataclass(frozen=True)
class Arm:
    """One Monte Carlo.

    Attributes:
        sheet: factor by which the s.d. in the manifest are wrong.
        placements: number of placements of the shipped plan; None: all.
        spread: of random robots; None: the nominal robot.
    """

    name: str
    preset: str
    runs: int
    estimator: str = MIXED_MODEL
    sheet: float = 1.0
    engine: str = "statics"
    spread: float | None = None
    placements: int | None = None


ARMS = [
    *(Arm(f"{preset}, default", preset, 5000) for preset in ("wii", "force-plate")),
    *(Arm(f"{preset}, least squares", preset, 2000, "least-squares") for preset in ("wii", "force-plate")),
    *(
        Arm(f"{preset}, sheet x {factor:g}", preset, 2000, sheet=factor)
        for preset in ("wii", "force-plate")
        for factor in (2.0, 0.5)
    ),
    Arm("wii, random robots", "wii", 2000, spread=0.1),
]
# A third of the plan: a run in full dynamics takes a minute.
DYNAMIC = [
    Arm(f"wii, {engine}", "wii", 30, engine=engine, placements=10) for engine in ("dynamics", "statics")
]


def with_sheet(
    inner: Source, factor: float, streams: Sequence[np.random.SeedSequence]
) -> list[Outcome | str]:
    """Carry out runs with all s.d. in the manifest wrong by a factor."""
    return [
        outcome
        if isinstance(outcome, str)
        else dataclasses.replace(
            outcome,
            measurements=dataclasses.replace(
                outcome.measurements, sensors=scaled(outcome.measurements.sensors, factor)
            ),
        )
        for outcome in inner(streams)
    ]


def carry_out(arm: Arm, seed: int, settings: Settings) -> tuple[MonteCarlo, Path, Layout]:
    """Carry out the missing runs of an arm; return its result, and the folder and layout of its runs."""
    robot, runs = load_robot(), settings.count(arm.runs)
    parameters = base_parameters(robot)
    layout = layout_of(robot, parameters)
    place = settings.folder("montecarlo") / arm.name.replace(", ", "-").replace(" ", "-")
    place.mkdir(exist_ok=True)
    asked = RunSettings(runs, seed, arm.estimator, arm.spread, arm.engine, imperfections=0)
    chunks = RunChunks(place, runs, asked.chunk)
    laboratory, plan = Laboratory(robot, arm.preset), shipped_plan(robot, arm.placements)
    if chunks.missing():
        inner = source_of(laboratory, plan, arm.spread, arm.engine)
        wrong = inner if arm.sheet == 1 else partial(with_sheet, inner, arm.sheet)
        job = RunJob(wrong, robot, parameters, layout, arm.estimator, seed)
        with progress(arm.name, runs) as advance:
            collect(chunks, job, advance, settings.workers)
    document = montecarlo_file(laboratory, plan, asked)
    return MonteCarlo.of(read_runs(chunks, layout), layout, document, plan=plan, robot=robot), place, layout


def extremes(rows: list[ParameterCoverage]) -> list[str]:
    """Return the largest bias over s.e. and the ranges of the ratio and of the coverage [%]."""
    ratio = np.array([row.standard_error_ratio for row in rows])
    coverage = 100 * np.array([row.coverage95 for row in rows])
    bias = np.array([row.bias / row.standard_error for row in rows])
    return [
        f"{bias[np.abs(bias).argmax()]:+.3f}",
        f"{ratio.min():.3f} to {ratio.max():.3f}",
        f"{coverage.min():.1f} to {coverage.max():.1f}",
    ]


def compare(arms: list[tuple[Path, Layout]]) -> Iterator[str]:
    """Test by Kolmogorov and Smirnov whether any estimate, standard error or count of rows differs.

    Yields:
        lines of the three closest columns and of the rows, then the result of all tests.
    """
    tables = [pyarrow.dataset.dataset(place).to_table().to_pandas() for place, _ in arms]
    columns = [f"full.value.{n}" for n in arms[0][1].numbers]
    columns += [*(f"full.se.{n}" for n in arms[0][1].numbers), "rows"]
    chances = {name: ks_2samp(*(table[name] for table in tables)).pvalue for name in columns}
    least = sorted(chances, key=lambda name: chances[name])[:3]
    limit = LEVEL / len(columns)
    for name in [*least, "rows"]:
        means = (f"{t[name].mean():.5g} +- {t[name].std():.2g}" for t in tables)
        yield row(name, *means, f"{chances[name]:.3g}")
    differ = [name for name, chance in chances.items() if chance < limit]
    yield f"\n{len(columns)} comparisons, each at {limit:.2g}: {differ or 'none'} differ"


def coverage(settings: Settings) -> Iterator[str]:
    """Yield a table of all arms and, for each preset, one of all parameters."""
    yield header("arm", "runs", "model", "worst bias / s.e.", "s.d. / s.e.", "95 % coverage", "verdict")
    tables = {}
    for k, arm in enumerate(ARMS):
        result, _, _ = carry_out(arm, settings.seed + k, settings)
        tables[arm.name] = result.parameters
        yield row(arm.name, result.runs, "full", *extremes(result.parameters), result.verdict)
        yield row(arm.name, result.runs, "simplified", *extremes(result.simplified.parameters), "")
    for preset in ("wii", "force-plate"):
        yield f"\n{preset}, full model\n"
        yield header("nr", "bias / s.e.", "s.d. / s.e.", "coverage %", "least squares: ratio", "coverage %")
        pairs = (tables[f"{preset}, {name}"] for name in ("default", "least squares"))
        for ours, plain in zip(*pairs, strict=True):
            yield row(
                ours.number,
                f"{ours.bias / ours.standard_error:+.3f}",
                f"{ours.standard_error_ratio:.3f}",
                f"{100 * ours.coverage95:.1f}",
                f"{plain.standard_error_ratio:.3f}",
                f"{100 * plain.coverage95:.1f}",
            )


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of the parts."""
    if "coverage" in settings.only:
        yield from coverage(settings)
    if "dynamics" in settings.only:
        runs = settings.count(DYNAMIC[0].runs)
        yield "\n" + header(f"{runs} runs each, 50 postures", "dynamics", "statics", "p")
        seeds = (settings.seed, settings.seed + 100)
        yield from compare([carry_out(a, s, settings)[1:] for a, s in zip(DYNAMIC, seeds, strict=True)])
