"""Third way, continued: postures on the stance foot alone added to those on both feet."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from studies.improve.output import BLUE, GREEN, ORANGE, Rows, panels, save
from studies.improve.postures import PER_PLACEMENT
from studies.improve.prediction import predicted_covariance
from studies.improve.repeat import monte_carlo_error, repeat, rms
from studies.runner import part_of
from tulip_testbed.experiments.montecarlo.laboratory_runs import stream_of
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, correlations, standard_errors
from tulip_testbed.sim.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

PAIRS = ((12, 13), (15, 16))


def mixed_plan(pool: PosturePlan, double: int, one_foot: np.ndarray) -> PosturePlan:
    """The pool's first postures, then those on one foot, five a placement.

    Args:
        one_foot: joint angles, (m, n_joints) [rad].
    """
    first = part_of(pool, pool.placement <= double // PER_PLACEMENT)
    count = len(one_foot)
    return dataclasses.replace(
        first,
        joint_angles=np.vstack([first.joint_angles, one_foot]),
        posture=np.arange(1, double + count + 1),
        placement=np.append(first.placement, first.placement[-1] + 1 + np.arange(count) // PER_PLACEMENT),
        support=np.append(first.support, np.full(count, "right")),
        swing_pose=np.vstack([first.swing_pose, np.tile(first.swing_pose[0], (count, 1))]),
        torques=np.vstack([first.feed_forward, np.zeros_like(one_foot)]),
    )


def study(
    rig: Rig, pool: PosturePlan, one_foot: np.ndarray, arms: list[tuple[int, int]], seed: int, runs: int
) -> tuple[Rows, Rows]:
    """A row a plan, and a row a parameter with its RMS error by every plan.

    Args:
        pool: double-support postures. one_foot: angles of single-support ones, (m, n_joints).
        arms: number of planned double-support and of single-support postures.
    """
    names = base_parameters(rig.robot).names
    errors: Rows = [{"number": k + 1, "name": name} for k, name in enumerate(names)]
    rows: Rows = []
    for double, single in arms:
        plan = mixed_plan(pool, double, one_foot[:single])
        parameters = base_parameters(rig.robot, support="right" if single else "double")
        value = parameters.values(standard_parameters(rig.robot.model))
        measured = run_statics(solve_plan(rig, plan), [stream_of(seed, 0)])[0].measurements
        stated = 1e3 * standard_errors(predicted_covariance(rig, measured, parameters, value))
        found = repeat(rig, plan, parameters, runs, seed)
        off = found.full.off[:, : len(names)]  # the same 25 in either support
        root = 1e3 * rms(off)
        matrix = stacked_regressor(parameters, plan.joint_angles)
        rho = correlations(np.linalg.inv(matrix.T @ matrix))
        with np.errstate(divide="ignore"):
            well = 100 * root / np.abs(1e3 * value[: len(names)]) < WELL_IDENTIFIED
        rows.append(
            {
                "double": double,
                "single": single,
                "measured": float(found.rows.mean()),
                "condition_number": float(np.linalg.cond(matrix)),
                **{f"correlation_{a}_{b}": float(rho[a - 1, b - 1]) for a, b in PAIRS},
                "median_rms_mm": float(np.median(root)),
                "median_rms_mc": 1e3 * monte_carlo_error(lambda e: float(np.median(rms(e))), off),
                "worst_rms_mm": float(root.max()),
                "rms_below_15": int(well.sum()),
                "median_predicted_mm": float(np.median(stated[: len(names)])),
                "worst_predicted_mm": float(stated[: len(names)].max()),
                "swing_foot_z_rms_mm": float(1e3 * rms(found.full.off)[-1]) if single else "",
                "runs": len(found.rows),
            }
        )
        for entry, error in zip(errors, root, strict=True):
            entry[f"rms_{double}+{single}_mm"] = float(error)
    return rows, errors


def draw(errors: Rows, shown: list[tuple[int, int]], path: Path) -> None:
    """RMS error of every parameter by the plans `shown`: double, single."""
    figure, (ax,) = panels(1, 5.6)
    for (double, single), marker, colour in zip(shown, "osD", (BLUE, ORANGE, GREEN), strict=False):
        values = [r[f"rms_{double}+{single}_mm"] for r in errors]
        ax.plot(values, range(len(errors)), marker, color=colour, label=f"{double} double + {single} single")
    labels = [f"{r['number']} {r['name'].replace('_', ' ')}" for r in errors]
    ax.set_yticks(range(len(errors)), labels, fontsize=8)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.set_xticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
    ax.minorticks_off()
    ax.set_xlabel("RMS error, mm (wii)")
    figure.legend(loc="outside upper center", ncols=1, frameon=False, fontsize=9)
    save(figure, path)
