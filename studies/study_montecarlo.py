"""Calibration by Monte Carlo, statics beside dynamics, wrong data sheets: docs/calibration.md's tables.

Every arm is resumable: its runs stay in the folder given by --out.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pyarrow.dataset
from scipy.stats import ks_2samp

from studies.runner import header, row, shipped_plan
from studies.study_estimators import scaled
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.calibration_report import report
from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.collect import collect
from tulip_testbed.experiments.montecarlo.engine import engine
from tulip_testbed.experiments.montecarlo.laboratory_runs import Laboratory, Run, laboratory
from tulip_testbed.experiments.montecarlo.run_columns import Job, Layout, layout_of
from tulip_testbed.experiments.montecarlo.summary import summarise
from tulip_testbed.experiments.terminal import progress
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot

SEED = 401
LEVEL = 0.01  # of all comparisons of statics and dynamics together


@dataclass(frozen=True)
class Arm:
    """One Monte Carlo.

    Attributes:
        sheet: factor by which the s.d. that the manifest states are wrong.
        placements: how many of the shipped plan, all if None.
        spread: of random robots, or None.
    """

    name: str
    preset: str
    runs: int
    estimator: str = DEFAULT
    sheet: float = 1.0
    dynamics: bool = False
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
    Arm(f"wii, {name}", "wii", 30, dynamics=name == "dynamics", placements=10)
    for name in ("dynamics", "statics")
]


def with_sheet(
    inner: Laboratory, factor: float, streams: Sequence[np.random.SeedSequence]
) -> list[Run | str]:
    """The same runs, with s.d. in the manifest that are wrong by a factor."""
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


def carry_out(arm: Arm, seed: int, folder: Path, workers: int) -> tuple[dict[str, Any], Path, Layout]:
    """Run what is missing of an arm; its report, and where its runs lie."""
    robot = load_robot()
    scenario = Scenario(preset_rig(arm.preset, robot), shipped_plan(robot, arm.placements), seed, arm.preset)
    parameters = base_parameters(robot)
    layout = layout_of(robot, parameters)
    place = folder / arm.name.replace(", ", "-").replace(" ", "-")
    place.mkdir(parents=True, exist_ok=True)
    chunks = Chunks(place, arm.runs, 1 if arm.dynamics else 25)
    if chunks.missing():
        inner = laboratory(scenario, arm.spread, arm.dynamics)
        wrong = inner if arm.sheet == 1 else partial(with_sheet, inner, arm.sheet)
        job = Job(wrong, robot, parameters, layout, arm.estimator, seed)
        with engine(workers, None), progress(arm.name, arm.runs) as advance:
            collect(chunks, job, advance)
    return report(summarise(chunks, layout), layout, arm.estimator), place, layout


def extremes(rows: list[dict[str, Any]]) -> list[str]:
    """Largest bias over s.e., range of the ratio, of the coverage [%] and, shown apart, of the median."""
    ratio = np.array([r["standard_error_ratio"] for r in rows])
    coverage = 100 * np.array([r["coverage95"] for r in rows])
    bias = np.array([r["bias"] / r["standard_error"] for r in rows])
    return [
        f"{bias[np.abs(bias).argmax()]:+.3f}",
        f"{ratio.min():.3f} to {ratio.max():.3f}",
        f"{coverage.min():.1f} to {coverage.max():.1f}",
    ]


def compare(arms: list[tuple[Path, Layout]]) -> list[str]:
    """Kolmogorov and Smirnov's test for every estimate, sigma, condition number and count of rows."""
    tables = [pyarrow.dataset.dataset(place).to_table().to_pandas() for place, _ in arms]
    columns = [f"full.value.{n}" for n in arms[0][1].numbers]
    columns += [f"full.se.{n}" for n in arms[0][1].numbers]
    columns += ["full.sigma", "full.condition_number", "full.residual_mean", "full.residual_max", "rows"]
    chances = {name: ks_2samp(*(table[name] for table in tables)).pvalue for name in columns}
    least = sorted(chances, key=lambda name: chances[name])[:3]
    limit = LEVEL / len(columns)
    lines = [
        row(name, *(f"{t[name].mean():.5g} +- {t[name].std():.2g}" for t in tables), f"{chances[name]:.3g}")
        for name in [*least, "full.sigma", "full.condition_number", "rows"]
    ]
    differ = [name for name, chance in chances.items() if chance < limit]
    return [*lines, "", f"{len(columns)} comparisons, each at {limit:.2g}: {differ or 'none'} differ"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/study-montecarlo"))
    parser.add_argument("--workers", type=int, default=joblib.cpu_count())
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", choices=("calibration", "dynamics"), help="one of the two parts")
    options = parser.parse_args()
    if options.only != "dynamics":
        print(header("arm", "runs", "model", "worst bias / s.e.", "s.d. / s.e.", "95 % coverage", "verdict"))
        tables = {}
        for k, arm in enumerate(ARMS):
            found, _, _ = carry_out(arm, options.seed + k, options.out, options.workers)
            tables[arm.name] = found
            for model, rows in (
                ("full", found["parameters"]),
                ("simplified", found["simplified"]["parameters"]),
            ):
                verdict = found["verdict"] + (", shown" if found["shown"] else "") if model == "full" else ""
                print(row(arm.name, arm.runs, model, *extremes(rows), verdict), flush=True)
        for preset in ("wii", "force-plate"):
            print(f"\n{preset}, full model\n")
            print(
                header("nr", "bias / s.e.", "s.d. / s.e.", "coverage %", "least squares: ratio", "coverage %")
            )
            pairs = (tables[f"{preset}, {name}"]["parameters"] for name in ("default", "least squares"))
            for ours, plain in zip(*pairs, strict=True):
                print(
                    row(
                        ours["number"],
                        f"{ours['bias'] / ours['standard_error']:+.3f}",
                        f"{ours['standard_error_ratio']:.3f}",
                        f"{100 * ours['coverage95']:.1f}",
                        f"{plain['standard_error_ratio']:.3f}",
                        f"{100 * plain['coverage95']:.1f}",
                    )
                )
    if options.only != "calibration":
        print("\n" + header("30 runs each, 50 postures", "dynamics", "statics", "p"))
        seeds = (options.seed, options.seed + 100)
        places = [
            carry_out(a, s, options.out, options.workers)[1:] for a, s in zip(DYNAMIC, seeds, strict=True)
        ]
        print("\n".join(compare(places)))


if __name__ == "__main__":
    main()
