"""Add random postures on the stance foot alone to those on both feet (third way, continued)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np

from studies.improve.output import BLUE, GREEN, ORANGE, Rows, log_axis, panels, save
from studies.improve.postures import PER_PLACEMENT
from studies.improve.prediction import predicted_covariance
from studies.improve.repeat import monte_carlo_error, repeat, rms
from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.montecarlo.laboratory_runs import stream_of
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, roll_pitch_yaw
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, correlations, standard_errors
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_ranges
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

PAIRS = ((12, 13), (15, 16))
AT_ONCE = 50_000
MOST_ROUNDS = 400
MARGIN = 0.02  # m, of the CoM's projection inside the sole
MOST_TORQUE = 0.8  # of the drives' limits: what tracking errors and sag may still need
LIFTED = 0.01  # m, of the swing sole's lowest corner over the floor


def one_foot_postures(robot: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw feasible joint angles uniformly within the joints' ranges, (count, n_joints) [rad].

    A posture is feasible if the CoM is over the stance sole with a margin, the torso and its height are
    within the planning ranges, the swing foot is lifted and on its own side, and the static torques are
    within 80 % of the drives' limits. Other collisions of links are not checked.

    Raises:
        InputError: hardly any draw is feasible.
    """
    model, nominal = robot.model, nominal_robot(robot)
    value = base_parameters(robot, support="right").values(standard_parameters(model))
    regressor = base_parameters(robot, support="right").regressor
    low, high = joint_ranges(model).T
    kept: list[np.ndarray] = []
    for _ in range(MOST_ROUNDS):
        angles = rng.uniform(low, high, (AT_ONCE, len(low)))
        com = regressor(angles) @ value
        sole = nominal.soles[0]
        inside = (com > sole.min(axis=0) + MARGIN) & (com < sole.max(axis=0) - MARGIN)
        angles, com = angles[inside.all(axis=1)], com[inside.all(axis=1)]
        fits = _stands_well(robot, nominal, angles)
        limits = torque_limits(robot)
        kept += [
            q
            for q, point in zip(angles[fits], com[fits], strict=True)
            if (np.abs(holding_torques(robot, model, q, point)) <= MOST_TORQUE * limits).all()
        ]
        if len(kept) >= count:
            return np.array(kept[:count])
    raise InputError(
        f"found {len(kept)} postures on one foot in {MOST_ROUNDS * AT_ONCE} draws, expected {count}"
    )


def holding_torques(robot: Robot, model: mujoco.MjModel, angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Compute the torques that hold the robot on its stance foot, (n_joints,) [N m].

    Args:
        point: centre of pressure, (2,) [m]; below the centre of mass.
    """
    data = mujoco.MjData(model)
    chain = ClosedChain(model, robot)
    data.qpos[:7], data.qpos[chain.qpos] = chain.base_pose(angles), angles
    mujoco.mj_forward(model, data)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, np.append(point, 0.0), model.body(robot.stance_foot).id)
    weight = -model.opt.gravity * model.body_subtreemass[0]
    return (data.qfrc_bias - jacobian.T @ weight)[chain.dofs]


def _stands_well(robot: Robot, nominal: Nominal, angles: np.ndarray) -> np.ndarray:
    """Return whether torso and swing foot are within their ranges, (m,)."""
    ranges, tree, base = planning_ranges(robot), nominal.parameters.tree, nominal.parameters.base
    rotations = link_rotations(tree, base, angles)
    positions = frame_positions(tree, base, rotations, -nominal.points[0])
    roll, pitch, yaw = roll_pitch_yaw(rotations[:, 0]).T
    foot, place = rotations[:, nominal.swing_frame], positions[:, nominal.swing_frame]
    corners = np.column_stack([nominal.soles[1], np.full(4, nominal.points[1][2])])
    height = place[:, 2, None] + np.einsum("mb,cb->mc", foot[:, 2], corners)
    side = place[:, 1] + foot[:, 1] @ nominal.points[1]
    within = [
        _inside(roll, ranges.torso_roll),
        _inside(pitch, ranges.torso_pitch),
        _inside(yaw, ranges.torso_yaw),
        positions[:, 0, 2] >= ranges.least_height,
        height.min(axis=1) >= LIFTED,
        side >= ranges.swing_y[0],
    ]
    return np.all(within, axis=0)


def _inside(value: np.ndarray, interval: tuple[float, float]) -> np.ndarray:
    return (value >= interval[0]) & (value <= interval[1])


def mixed_plan(pool: PosturePlan, double: int, one_foot: np.ndarray) -> PosturePlan:
    """Join the first postures of the pool and those on one foot, five a placement.

    Args:
        one_foot: joint angles, (m, n_joints) [rad].
    """
    first = pool.take(pool.placement <= double // PER_PLACEMENT)
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
    """Return a row for each plan, and a row for each parameter with its RMS error by every plan.

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
    """Draw the RMS error of every parameter by the plans `shown`: double, single."""
    figure, (ax,) = panels(1, 5.6)
    for (double, single), marker, colour in zip(shown, "osD", (BLUE, ORANGE, GREEN), strict=False):
        values = [r[f"rms_{double}+{single}_mm"] for r in errors]
        ax.plot(values, range(len(errors)), marker, color=colour, label=f"{double} double + {single} single")
    labels = [f"{r['number']} {r['name'].replace('_', ' ')}" for r in errors]
    ax.set_yticks(range(len(errors)), labels, fontsize=8)
    ax.invert_yaxis()
    log_axis(ax, "x", (1, 3, 10, 30, 100))
    ax.set_xlabel("RMS error, mm (wii)")
    figure.legend(loc="outside upper center", ncols=1, frameon=False, fontsize=9)
    save(figure, path)
