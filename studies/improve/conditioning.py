"""Third way: better conditioned postures. How far does the condition number predict the errors?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import bootstrap, rankdata

from studies.improve.designs import CRITERIA, exchanged, placement_blocks, plan_of, random_choices
from studies.improve.output import BLACK, BLUE, GREEN, ORANGE, RED, SKY, Rows, panels, save
from studies.improve.prediction import predicted_covariance
from studies.improve.repeat import monte_carlo_error, repeat, rms
from tulip_testbed.experiments.montecarlo.laboratory_runs import stream_of
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

TICKS = {
    "condition_number": [500, 1000, 2000, 4000, 8000],
    "mean_se": [8, 16, 32, 64],
    "predicted_se_mm": [50, 100, 200, 400],
}
KINDS = {
    "random": ("o", BLUE),
    "least condition number": ("s", ORANGE),
    "least scaled condition number": ("D", GREEN),
    "least mean s.e.": ("^", RED),
    "largest condition number": ("v", SKY),
}


@dataclass(frozen=True)
class Size:
    """How large the study is: placements a plan, random plans, plans by exchange of each kind, trials."""

    placements: int = 10
    random: int = 24
    each: int = 2
    draws: int = 2000
    trials: int = 1500


def choose(
    pool: PosturePlan, parameters: BaseParameters, size: Size, rng: np.random.Generator
) -> list[tuple[str, PosturePlan]]:
    """Plans by kind: random ones over their whole range of condition numbers, others by exchange."""
    blocks = placement_blocks(parameters, pool)
    drawn = random_choices(blocks, size.placements, size.draws, rng)
    ranks = np.linspace(0, len(drawn) - 1, size.random).round().astype(int)
    chosen = [("random", drawn[k]) for k in ranks]
    condition = CRITERIA["condition_number"]
    goals = {
        "least condition number": condition,
        "least scaled condition number": CRITERIA["scaled_condition_number"],
        "least mean s.e.": CRITERIA["mean_se"],
        "largest condition number": lambda matrix: -condition(matrix),
    }
    for kind, goal in goals.items():
        for _ in range(size.each):
            start = drawn[rng.integers(len(drawn))]
            chosen.append((kind, exchanged(blocks, start, goal, size.trials, rng)))
    return [(kind, plan_of(pool, placements)) for kind, placements in chosen]


def study(
    rig: Rig,
    plans: list[tuple[str, PosturePlan]],
    parameters: BaseParameters,
    runs: int,
    seed: int,
) -> Rows:
    """A row a plan: criteria by its planned angles, predicted s.e. by one run, errors by all runs."""
    rows = []
    for k, (kind, plan) in enumerate(plans):
        matrix = stacked_regressor(parameters, plan.joint_angles)
        (one,) = run_statics(solve_plan(rig, plan), [stream_of(seed + k, 0)])
        value = parameters.values(one.standard)
        stated = predicted_covariance(rig, one.measurements, parameters, value)
        found = repeat(rig, plan, parameters, runs, seed + k)
        off = found.full.off
        rows.append(
            {
                "plan": kind,
                "postures": len(plan),
                **{name: criterion(matrix) for name, criterion in CRITERIA.items()},
                "predicted_se_mm": 1e3 * float(np.sqrt(np.diag(stated).mean())),
                "rms_mm": 1e3 * float(np.sqrt((off**2).mean())),
                "rms_mc": 1e3 * monte_carlo_error(lambda e: float(np.sqrt((e**2).mean())), off),
                "median_rms_mm": 1e3 * float(np.median(rms(off))),
                "median_rms_mc": 1e3 * monte_carlo_error(lambda e: float(np.median(rms(e))), off),
                "simplified_rms_mm": 1e3 * float(np.sqrt((found.simplified.off**2).mean())),
                "well": float(found.full.well.mean()),
                "measured": float(found.rows.mean()),
                "runs": len(found.rows),
            }
        )
    return rows


def predictions(rows: Rows, seed: int) -> Rows:
    """Rank correlation of each criterion with the errors, over random plans and over all of one size."""
    same = [r for r in rows if r["postures"] == rows[0]["postures"]]
    table = []
    for name in [*CRITERIA, "predicted_se_mm"]:
        for error in ("rms_mm", "median_rms_mm"):
            entry = {"criterion": name, "error": error}
            for which, chosen in (("random", [r for r in same if r["plan"] == "random"]), ("all", same)):
                pairs = np.array([[r[name], r[error]] for r in chosen])
                low, high = _interval(pairs, seed)
                entry |= {
                    which: f"{_rank(*pairs.T):+.2f}",
                    f"{which}_95": f"{low:+.2f} to {high:+.2f}",
                }
            table.append(entry)
    return table


def _rank(x: np.ndarray, y: np.ndarray) -> float:
    """Spearman's correlation."""
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])


def _interval(pairs: np.ndarray, seed: int) -> tuple[float, float]:
    found = bootstrap(
        tuple(pairs.T),
        _rank,
        paired=True,
        vectorized=False,
        n_resamples=500,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def draw(rows: Rows, path: Path) -> None:
    """Errors against each criterion: of all parameters together, and of the median one."""
    figure, axes = panels(3, 3.4, 2)
    labels = {
        "condition_number": "condition number of H",
        "mean_se": "root of trace (H'H)⁻¹ / 25",
        "predicted_se_mm": "predicted standard error of all 25, mm",
    }
    errors = {"rms": "RMS error of all 25, mm", "median_rms": "median of the 25 RMS errors, mm"}
    pairs = [(error, criterion) for error in errors for criterion in labels]
    for ax, (error, criterion) in zip(axes, pairs, strict=True):
        for kind in dict.fromkeys(r["plan"] for r in rows):
            chosen = [r for r in rows if r["plan"] == kind]
            marker, colour = KINDS.get(kind, ("*", BLACK))
            ax.errorbar(
                [r[criterion] for r in chosen],
                [r[f"{error}_mm"] for r in chosen],
                [r[f"{error}_mc"] for r in chosen],
                fmt=marker,
                color=colour,
                markersize=10 if marker == "*" else 5,
                elinewidth=1,
                label=kind if kind in KINDS else f"{kind} ({chosen[0]['postures']} postures)",
            )
        ax.set_xscale("log")
        if error == "rms":
            ax.set_yscale("log")
            ax.set_yticks([50, 100, 200, 400], ["50", "100", "200", "400"])
            ax.minorticks_off()
        ticks = TICKS[criterion]
        ax.set_xticks(ticks, [str(tick) for tick in ticks])
        ax.minorticks_off()
        ax.set_xlabel(labels[criterion])
        ax.set_ylabel(errors[error] if criterion == "condition_number" else "")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False, fontsize=9)
    save(figure, path)
