"""Compare the simplified model with the full one: added bias against saved variance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.improve.output import BLUE, GREEN, ORANGE, RED, Rows, log_axis, panels, save
from studies.improve.repeat import Model, Repeated, monte_carlo_error, repeat, rms
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig

COLOURS = (BLUE, ORANGE, GREEN, RED)
TICKS = (0.2, 0.3, 0.5, 1, 2)


def study(
    arms: dict[str, tuple[Rig, PosturePlan, int]],
    spreads: list[float],
    new: np.ndarray,
    parameters: BaseParameters,
    seed: int,
) -> Rows:
    """Return a row for each arm and spread; all arms have the same robots.

    Args:
        arms: laboratory, plan and number of robots by name.
        spreads: of the random true robots, `sim.random_robots`.
        new: joint angles at which the CoP is predicted, not measured before, (m, n_joints) [rad].
    """
    matrix = stacked_regressor(parameters, new)
    rows = []
    for name, (rig, plan, robots) in arms.items():
        for spread in spreads:
            found = repeat(rig, plan, parameters, robots, seed, spread)
            rows.append({"arm": name, "spread": spread} | _row(found, matrix))
    return rows


def _row(found: Repeated, matrix: np.ndarray) -> dict[str, float | int]:
    full, simple = found.full, found.simplified
    kept = np.isin(full.numbers, simple.numbers)
    both = np.stack([full.off[:, kept], simple.off])
    winners = (rms(both[1]) < rms(both[0])).sum()
    predicted = np.stack([_prediction(matrix, full, full.truth), _prediction(matrix, simple, full.truth)])
    pairs = [np.concatenate(list(errors), axis=1) for errors in (both, predicted)]
    ratios = [_ratio(errors) for errors in pairs]
    mc = [monte_carlo_error(_ratio, errors) for errors in pairs]
    lost = full.truth[:, ~kept]
    return {
        "dropped_true_rms_mm": 1e3 * float(np.sqrt((lost**2).mean())),
        "full_rms_mm": 1e3 * float(np.sqrt((both[0] ** 2).mean())),
        "simplified_rms_mm": 1e3 * float(np.sqrt((both[1] ** 2).mean())),
        "ratio": ratios[0],
        "ratio_mc": mc[0],
        "simplified_better_for": int(winners),
        "full_prediction_mm": 1e3 * float(np.sqrt((predicted[0] ** 2).mean())),
        "simplified_prediction_mm": 1e3 * float(np.sqrt((predicted[1] ** 2).mean())),
        "prediction_ratio": ratios[1],
        "prediction_ratio_mc": mc[1],
        "simplified_coverage95": _coverage(simple),
        "full_coverage95": _coverage(full),
        "robots": len(found.rows),
    }


def _prediction(matrix: np.ndarray, model: Model, truth: np.ndarray) -> np.ndarray:
    """Compute the RMS distance of predicted and true CoP over the postures in each run, (runs, 1) [m]."""
    off = matrix[:, model.numbers - 1] @ model.value.T - matrix @ truth.T
    return np.sqrt(2 * (off**2).mean(axis=0))[:, None]


def _ratio(pairs: np.ndarray) -> float:
    """Compute the geometric mean over k of RMS error, simplified over full; full first, (runs, 2 k)."""
    full, simple = np.split(rms(pairs), 2)
    return float(np.exp(np.log(simple / full).mean()))


def _coverage(model: Model) -> float:
    """Compute the share of true values within 1.96 reported standard errors [%]."""
    return 100 * float((np.abs(model.off) < 1.96 * model.error).mean())


def crossings(rows: Rows) -> Rows:
    """Find the spread at which both models are equal, by log-linear interpolation of the ratio."""
    table = []
    for arm in dict.fromkeys(r["arm"] for r in rows):
        mine = [r for r in rows if r["arm"] == arm]
        entry = {"arm": arm}
        for key in ("ratio", "prediction_ratio"):
            entry[f"{key}_is_1_at_spread"] = _crossing(
                np.log([r["spread"] for r in mine]), np.log([r[key] for r in mine]), mine
            )
        table.append(entry)
    return table


def _crossing(x: np.ndarray, y: np.ndarray, rows: Rows) -> str:
    if y[0] > 0:
        return f"below {rows[0]['spread']}"
    if y[-1] < 0:
        return f"above {rows[-1]['spread']}"
    k = int(np.argmax(y > 0))
    at = x[k - 1] - y[k - 1] * (x[k] - x[k - 1]) / (y[k] - y[k - 1])
    return f"{np.exp(at):.3f}"


def draw(rows: Rows, path: Path) -> None:
    """Draw the ratio of the errors over the spread of the robots."""
    figure, (errors, predictions) = panels(2, 4.2)
    spreads = sorted({r["spread"] for r in rows})
    for number, arm in enumerate(dict.fromkeys(r["arm"] for r in rows)):
        mine = [r for r in rows if r["arm"] == arm]
        for ax, key in ((errors, "ratio"), (predictions, "prediction_ratio")):
            ax.errorbar(
                [r["spread"] for r in mine],
                [r[key] for r in mine],
                [r[f"{key}_mc"] for r in mine],
                fmt="os^Dv"[number % 5] + "-",
                color=COLOURS[number % 4],
                label=arm,
            )
    for ax, title in ((errors, "the 13 kept parameters"), (predictions, "CoP predicted at new postures")):
        log_axis(ax, "x", spreads)
        log_axis(ax, "y", TICKS)
        ax.axhline(1, color="black", linewidth=1)
        ax.set_xlabel("spread of the true robots (s.d. of ln mass)")
        ax.set_ylabel("RMS error, simplified over full")
        ax.set_title(title, fontsize=10)
        for side, text, anchor in ((1.03, "full model better", "bottom"), (0.97, "simplified better", "top")):
            ax.text(0.02, side, text, transform=ax.get_yaxis_transform(), va=anchor, fontsize=8)
        ax.set_ylim(TICKS[0], TICKS[-1])
    errors.legend(frameon=False, fontsize=9)
    save(figure, path)
