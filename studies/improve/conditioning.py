"""Compare plans of different condition numbers by their errors (third way)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import bootstrap, rankdata

from studies.improve.output import BLACK, BLUE, GREEN, ORANGE, RED, SKY, Rows, log_axis, panels, save
from studies.improve.prediction import predicted_covariance
from studies.improve.repeat import monte_carlo_error, repeat, rms
from tulip_testbed.experiments.montecarlo.laboratory_runs import stream_of
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

PLACEMENTS = 10  # of each plan
RANDOM, EACH = 24, 2  # random plans, and plans by exchange of each kind
DRAWS, TRIALS = 2000, 1500  # of sets of placements, and of exchanges
TICKS = {
    "condition_number": [500, 1000, 2000, 4000, 8000],
    "mean_se": [8, 16, 32, 64],
    "predicted_se_mm": [50, 100, 200, 400],
    "rms": [50, 100, 200, 400],
}
KINDS = {
    "random": ("o", BLUE),
    "least condition number": ("s", ORANGE),
    "least scaled condition number": ("D", GREEN),
    "least mean s.e.": ("^", RED),
    "largest condition number": ("v", SKY),
}

Criterion = Callable[[np.ndarray], float]


def condition_number(matrix: np.ndarray) -> float:
    """Compute the condition number of H, the paper's objective (eq. 9)."""
    return float(np.linalg.cond(matrix))


def scaled_condition_number(matrix: np.ndarray) -> float:
    """Compute it with columns of unit length: at most sqrt(p) times the least of any scaling.

    Reference: van der Sluis (1969).
    """
    return float(np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)))


def mean_standard_error(matrix: np.ndarray) -> float:
    """Compute the RMS standard error for independent errors of unit s.d., sqrt(trace((H'H)^-1) / p)."""
    return float(np.sqrt((np.linalg.svd(matrix, compute_uv=False) ** -2.0).mean()))


CRITERIA: dict[str, Criterion] = {
    "condition_number": condition_number,
    "scaled_condition_number": scaled_condition_number,
    "mean_se": mean_standard_error,
}


def placement_blocks(parameters: BaseParameters, pool: PosturePlan) -> np.ndarray:
    """Return the regressor of each placement, (placements, 2 postures, p); all have as many postures."""
    matrix = stacked_regressor(parameters, pool.joint_angles)
    count = len(np.unique(pool.placement))
    return matrix.reshape(count, -1, matrix.shape[1])


def random_choices(blocks: np.ndarray, placements: int, tries: int, rng: np.random.Generator) -> np.ndarray:
    """Draw sets of placements, sorted by the condition number of their regressor, (tries, placements)."""
    drawn = np.array([rng.choice(len(blocks), placements, replace=False) for _ in range(tries)])
    return drawn[np.argsort([condition_number(joined(blocks, chosen)) for chosen in drawn])]


def joined(blocks: np.ndarray, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Stack the regressors of some placements, (rows, p)."""
    return blocks[np.asarray(chosen)].reshape(-1, blocks.shape[2])


def exchanged(
    blocks: np.ndarray,
    start: np.ndarray,
    criterion: Criterion,
    trials: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Exchange placements at random and keep each exchange that lowers the criterion (Fedorov 1972)."""
    chosen, best = start.copy(), criterion(joined(blocks, start))
    for _ in range(trials):
        trial = chosen.copy()
        trial[rng.integers(len(trial))] = rng.integers(len(blocks))
        if len(set(trial)) == len(trial) and (value := criterion(joined(blocks, trial))) < best:
            chosen, best = trial, value
    return chosen


def plan_of(pool: PosturePlan, chosen: np.ndarray) -> PosturePlan:
    """Return the plan of some placements, given by their index."""
    return pool.take(np.isin(pool.placement, np.unique(pool.placement)[chosen]))


def choose(
    pool: PosturePlan, parameters: BaseParameters, rng: np.random.Generator
) -> list[tuple[str, PosturePlan]]:
    """Choose random plans over their whole range of condition numbers, and plans by exchange.

    Returns:
        kind and plan.
    """
    blocks = placement_blocks(parameters, pool)
    drawn = random_choices(blocks, PLACEMENTS, DRAWS, rng)
    ranks = np.linspace(0, len(drawn) - 1, RANDOM).round().astype(int)
    chosen = [("random", drawn[k]) for k in ranks]
    condition = CRITERIA["condition_number"]
    goals = {
        "least condition number": condition,
        "least scaled condition number": CRITERIA["scaled_condition_number"],
        "least mean s.e.": CRITERIA["mean_se"],
        "largest condition number": lambda matrix: -condition(matrix),
    }
    for kind, goal in goals.items():
        for _ in range(EACH):
            start = drawn[rng.integers(len(drawn))]
            chosen.append((kind, exchanged(blocks, start, goal, TRIALS, rng)))
    return [(kind, plan_of(pool, placements)) for kind, placements in chosen]


def study(
    rig: Rig,
    plans: list[tuple[str, PosturePlan]],
    parameters: BaseParameters,
    runs: int,
    seed: int,
) -> Rows:
    """Return for each plan the criteria of its angles, the s.e. predicted by one run, the errors of all."""
    rows = []
    for k, (kind, plan) in enumerate(plans):
        matrix = stacked_regressor(parameters, plan.joint_angles)
        (one,) = run_statics(solve_plan(rig, plan), [stream_of(seed + k, 0)])
        value = parameters.values(one.truth.standard)
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
    """Correlate the ranks of each criterion and of the errors, over random plans and over all of one size."""
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
    """Compute Spearman's correlation."""
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
    """Draw the errors, of all parameters together and of the median one, over each criterion."""
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
        log_axis(ax, "x", TICKS[criterion])
        if error == "rms":
            log_axis(ax, "y", TICKS["rms"])
        ax.set_xlabel(labels[criterion])
        ax.set_ylabel(errors[error] if criterion == "condition_number" else "")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), frameon=False, fontsize=9)
    save(figure, path)
