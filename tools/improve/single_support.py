"""Third way, continued: single-support postures added, by the linear covariance and not by experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.montecarlo.laboratory import stream_of
from identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from identification.reading_noise import cell_noise, placement_levers
from identification.statistics import correlations, standard_errors
from sim.measurements import Measurements, PosturePlan
from sim.model import load_model
from sim.rig import Rig
from sim.sensors import Sensors, averaged_sd
from sim.static_laboratory import prepare, run_static
from tools.improve.output import BLUE, GREEN, ORANGE, Rows, panels, save
from tools.improve.postures import PER_PLACEMENT
from tools.improve.repeat import repeat, rms
from tools.study import part_of, rows_of

Block = tuple[np.ndarray, np.ndarray]  # rows of H and the covariance of their errors, one placement


def predicted(blocks: list[Block], seen: np.ndarray) -> np.ndarray:
    """Covariance of generalised least squares, (H' V^-1 H)^-1, of the parameters `seen`."""
    information = sum(h[:, seen].T @ np.linalg.solve(v, h[:, seen]) for h, v in blocks)
    return np.linalg.inv(information)


def double_blocks(
    rig: Rig, measured: Measurements, parameters: BaseParameters, value: np.ndarray
) -> list[Block]:
    """H and V of every placement of measured double-support postures."""
    s = rig.sensors
    levers = placement_levers(measured) * np.array([*s.mark_sd, *s.placement_sd])
    own = _cell_sd(rig) ** 2 * cell_noise(measured) + _encoders(rig, parameters, value, measured.joint_angles)
    matrix = parameters.regressor(measured.joint_angles)
    return [
        _block(matrix[rows], own[rows], levers[rows])
        for rows in (measured.placement == number for number in np.unique(measured.placement))
    ]


def single_blocks(
    rig: Rig, angles: np.ndarray, cells: np.ndarray, parameters: BaseParameters, value: np.ndarray
) -> list[Block]:
    """H and V of every five postures on the right foot, read by the right plate alone.

    Args:
        cells: the right plate's cells in the base frame, (4, 2) [m].
    """
    model = load_model(rig.robot)
    weight = float(-model.opt.gravity[2] * model.body_subtreemass[0])
    matrix = parameters.regressor(angles)
    cop = matrix @ value
    arm = (cells - cop[:, None]) / weight
    own = _cell_sd(rig) ** 2 * np.einsum("mca,mcb->mab", arm, arm) + _encoders(rig, parameters, value, angles)
    x, y = (cop - cells.mean(axis=0)).T
    levers = np.zeros((len(angles), 2, 3))
    levers[:, 0, 0] = levers[:, 1, 1] = 1.0
    levers[:, 0, 2], levers[:, 1, 2] = -y, x
    levers *= np.array(rig.sensors.mark_sd)
    groups = np.array_split(np.arange(len(angles)), max(len(angles) // PER_PLACEMENT, 1))
    return [_block(matrix[g], own[g], levers[g]) for g in groups] if len(angles) else []


def study(
    rig: Rig,
    pool: PosturePlan,
    one_foot: np.ndarray,
    arms: list[tuple[int, int]],
    seed: int,
    runs: int,
) -> tuple[Rows, Rows]:
    """A row a plan, and a row a parameter with its standard error by every plan.

    Args:
        pool: double-support postures. one_foot: angles of single-support ones, (m, n_joints).
        arms: number of planned double-support and of single-support postures.
        runs: of a Monte Carlo of the first arm, which has to be double support alone: what the
            prediction is held against.
    """
    parameters = base_parameters(rig.robot, support="right")
    value = parameters.values(standard_parameters(load_model(rig.robot)))
    double = base_parameters(rig.robot)
    order = [parameters.names.index(name) for name in double.names]  # the others: single support alone
    prepared = prepare(rig, _first(pool, max(count for count, _ in arms)))
    measured = run_static(prepared, [stream_of(seed, 0)])[0].measurements
    cells = measured.cells[0] + prepared.boards[0, 0, :2]
    rows: Rows = []
    for count, single in arms:
        mine = rows_of(measured, measured.placement <= count // PER_PLACEMENT)
        blocks = double_blocks(rig, mine, parameters, value)
        blocks += single_blocks(rig, one_foot[:single], cells, parameters, value)
        seen = np.arange(len(value)) if single else np.array(order)
        rows.append({"double": count, "single": single} | _row(blocks, seen, order, value))
        if not rows[1:]:
            held = repeat(rig, _first(pool, count), double, runs, seed)
            root = 1e3 * rms(held.full.off)
            predicted_mm = 1e3 * standard_errors(predicted(blocks, seen))
            ratio = root / predicted_mm
            print(
                f"\nMonte Carlo of {count} + 0, {len(held.rows)} runs: RMS error over predicted s.e. "
                f"{ratio.min():.2f} to {ratio.max():.2f}, mean {ratio.mean():.3f} "
                f"(Monte Carlo error of one: {1 / np.sqrt(2 * len(held.rows)):.2f})"
            )
    errors: Rows = [{"number": k + 1, "name": name} for k, name in enumerate(double.names)]
    for entry in rows:
        for parameter, error in zip(errors, entry.pop("errors"), strict=True):
            parameter[f"se_{entry['double']}+{entry['single']}_mm"] = float(error)
    return rows, errors


def _row(blocks: list[Block], seen: np.ndarray, order: list[int], value: np.ndarray) -> dict[str, Any]:
    matrix = np.concatenate([h for h, _ in blocks])[:, seen]
    covariance = predicted(blocks, seen)
    at = [int(np.flatnonzero(seen == k)[0]) for k in order]
    error = standard_errors(covariance)[at]
    alike = np.linalg.inv(matrix.T @ matrix)
    same = 4.16e-3 * standard_errors(alike)[at]  # the paper's sigma for every reading
    rho = correlations(alike)[np.ix_(at, at)]
    with np.errstate(divide="ignore"):
        well = (error / np.abs(value[order]) < 0.15).sum()
    rest = np.setdiff1d(seen, order)
    return {
        "parameters": len(seen),
        "condition_number": float(np.linalg.cond(matrix)),
        "correlation_12_13": float(rho[11, 12]),
        "correlation_15_16": float(rho[14, 15]),
        "median_se_mm": 1e3 * float(np.median(error)),
        "worst_se_mm": 1e3 * float(error.max()),
        "well": int(well),
        "median_se_equal_sigma_mm": 1e3 * float(np.median(same)),
        "worst_se_equal_sigma_mm": 1e3 * float(same.max()),
        "swing_foot_z_se_mm": 1e3 * float(np.sqrt(covariance[-1, -1])) if len(rest) else float("nan"),
        "errors": 1e3 * error,
    }


def _block(matrix: np.ndarray, own: np.ndarray, levers: np.ndarray) -> Block:
    size = 2 * len(own)
    rows = np.arange(size).reshape(-1, 2)
    covariance = np.zeros((size, size))
    covariance[rows[:, :, None], rows[:, None, :]] = own
    flat = levers.reshape(size, -1)
    return matrix.reshape(size, -1), covariance + flat @ flat.T


def _cell_sd(rig: Rig) -> float:
    s: Sensors = rig.sensors
    return averaged_sd(s.cell_repeatability, s.cell_noise, s.cell_resolution, _samples(rig))


def _encoders(rig: Rig, parameters: BaseParameters, value: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Covariance of the modelled CoM by the encoders' errors, (m, 2, 2) [m2]."""
    s: Sensors = rig.sensors
    sd = averaged_sd(s.encoder_repeatability, s.encoder_noise, s.encoder_resolution, _samples(rig))
    slope = sd * (parameters.slope(angles) @ value)
    return slope @ slope.mT


def _samples(rig: Rig) -> int:
    return round(rig.protocol.window * rig.sensors.sample_rate)


def _first(pool: PosturePlan, count: int) -> PosturePlan:
    return part_of(pool, pool.placement <= count // PER_PLACEMENT)


def draw(errors: Rows, shown: list[tuple[int, int]], path: Path) -> None:
    """Predicted standard error of every parameter by the plans `shown`: double, single."""
    figure, (ax,) = panels(1, 5.6)
    for (double, single), marker, colour in zip(shown, "osD", (BLUE, ORANGE, GREEN), strict=False):
        values = [r[f"se_{double}+{single}_mm"] for r in errors]
        ax.plot(values, range(len(errors)), marker, color=colour, label=f"{double} double + {single} single")
    labels = [f"{r['number']} {r['name'].replace('_', ' ')}" for r in errors]
    ax.set_yticks(range(len(errors)), labels, fontsize=8)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.set_xticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
    ax.minorticks_off()
    ax.set_xlabel("predicted standard error, mm (wii)")
    figure.legend(loc="outside upper center", ncols=1, frameon=False, fontsize=9)
    save(figure, path)
