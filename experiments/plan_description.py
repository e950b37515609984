"""Predictions from a plan's file alone: condition number, standard errors, correlations, margins."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table, united_links
from tulip_testbed.experiments.plan_clearances import clearance_table, clearances_of
from tulip_testbed.experiments.planning_run import joined
from tulip_testbed.experiments.usable_plan import planned_parameters
from tulip_testbed.identification.base_parameters import BaseParameters, common_support, standard_parameters
from tulip_testbed.identification.feasibility import predicted_cell_loads, predicted_foot_loads
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning.one_foot import from_other_foot, single_support_margins
from tulip_testbed.identification.planning.optimal_plan import smallest_margins
from tulip_testbed.identification.planning.problem import Problem, planning_problem
from tulip_testbed.identification.reading_noise import ReadingNoise, cell_noise, placement_levers
from tulip_testbed.identification.statistics import (
    HIGH_CORRELATION,
    WELL_IDENTIFIED,
    high_correlations,
    relative_standard_errors,
    standard_errors,
)
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.data import base_foot, feet_in_contact
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, joint_names, sole_point
from tulip_testbed.sim.scene import boards_under, nominal_plates

LARGE_SHARE = 1000.0  # % of a nominal value: it is near zero


def described_plan(
    robot: Robot, plan: PosturePlan, preset: str, taken: PosturePlan | None = None
) -> dict[str, Any]:
    """Return the description of a plan as JSON.

    Args:
        preset: of the sensors, "wii" or "force-plate"; the standard errors are those of generalised least
            squares with its s.d., for the nominal robot, if every posture can be held.
        taken: postures measured before; all but the margins are of both together.

    Raises:
        InputError: postures on the left foot, or a scene that cannot be.
    """
    new = plan
    plan = plan if taken is None else joined([taken, plan])
    rig, parameters = preset_rig(preset, robot), planned_parameters(robot, plan)
    model = robot.model
    nominal = parameters.values(standard_parameters(model))
    matrix = regressor_by_mujoco(robot, plan.joint_angles, parameters, plan.support)
    rows = matrix.reshape(-1, len(nominal))
    noise = reading_noise_of(rig, plan, parameters, nominal)
    covariance = np.linalg.inv(np.tensordot(matrix, noise.weights(matrix), axes=((0, 1), (0, 1))))
    errors = standard_errors(covariance)
    relative = relative_standard_errors(nominal, errors)
    pairs = high_correlations(np.linalg.inv(rows.T @ rows), np.arange(1, len(nominal) + 1), HIGH_CORRELATION)
    return {
        "condition_number": float(np.linalg.cond(rows)),
        "preset": preset,
        "sigma_mm": 1e3 * float(np.sqrt(noise.variance.mean())),
        "predicted_standard_error_mm": (1e3 * errors).tolist(),
        "predicted_relative_standard_error_percent": relative.tolist(),
        "well_identified": int((relative < WELL_IDENTIFIED).sum()),
        "correlations": [{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
        "margins": margins_of(robot, new),
        "clearances": clearances_of(robot, new),
    }


def regressor_by_mujoco(
    robot: Robot, joint_angles: np.ndarray, parameters: BaseParameters, support: np.ndarray
) -> np.ndarray:
    """Compute the base regressor by MuJoCo's kinematics, which planning does not use, (m, 2, p) [-].

    The CoM is W(q) phi / M with the standard parameters phi, W = [p_l, R_l] a link, and H theta with
    theta = B phi / M; so W = H B, and H = W B^+. Places are from the stance foot's sole point, in the axes of
    the foot that carries.
    """
    model = robot.model
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in joint_names(model)]
    point = sole_point(model, robot.stance_foot)
    stacked = np.empty((len(joint_angles), 2, 4 * (model.nbody - 1)))
    for k, (angles, carrying) in enumerate(zip(joint_angles, base_foot(support), strict=True)):
        data.qpos[:] = model.qpos0
        data.qpos[joints] = angles
        mujoco.mj_kinematics(model, data)
        foot = data.body(robot.stance_foot)
        base = data.body(robot.feet[carrying]).xmat.reshape(3, 3)
        places = (data.xpos[1:] - foot.xpos - foot.xmat.reshape(3, 3) @ point) @ base
        turns = base.T @ data.xmat[1:].reshape(-1, 3, 3)
        stacked[k] = np.concatenate([places[:, None], turns.mT], axis=1)[..., :2].reshape(-1, 2).T
    return stacked @ np.linalg.pinv(parameters.from_standard)


def planned_readings(rig: Rig, plan: PosturePlan, com: np.ndarray) -> Measurements:
    """Compute the readings of the plates by the nominal model, without noise.

    Args:
        com: nominal centre of mass in the plan view, (m, 2) [m].
    """
    robot, model = rig.robot, rig.robot.model
    plate = dataclasses.replace(nominal_plates(robot)[0], mass=0.0)  # tared
    weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
    feet, stands = plan.foot_poses, feet_in_contact(plan.support)
    boards = boards_under(rig, feet)
    cells = []
    for point, pair, board, on in zip(com, feet, boards, stands, strict=True):
        share, cop = predicted_foot_loads(point, pair[:, :2])
        if not on.all():
            share, cop = on.astype(float), np.where(on[:, None], point, board[:, :2])
        cells.append(predicted_cell_loads(share, cop, board, plate, weight))
    count = len(plan)
    return Measurements.from_arrays(
        header_of(rig),
        posture=plan.posture,
        placement=plan.placement,
        support=plan.support,
        window=np.full(count, rig.protocol.window),
        samples=np.full(count, round(rig.protocol.window * rig.sensors.sample_rate)),
        joint_angles=plan.joint_angles,
        cell_forces=np.array(cells),
        plate_poses=boards,
    )


def reading_noise_of(
    rig: Rig, plan: PosturePlan, parameters: BaseParameters, nominal: np.ndarray
) -> ReadingNoise:
    """Noise of the centre of pressure that the rig's sensors promise at planned postures."""
    com = nominal_robot(rig.robot, parameters.support).center_of_mass(plan.joint_angles, plan.support)
    readings = planned_readings(rig, plan, com)
    sheet = readings.sensors
    slope = (sheet.encoder_sd or 0.0) * (parameters.slope(plan.joint_angles, plan.support) @ nominal)
    own = (sheet.cell_sd or 0.0) ** 2 * cell_noise(readings, com) + slope @ slope.mT
    sd = np.array([*rig.sensors.mark_sd, *rig.sensors.placement_sd])
    return ReadingNoise(own, placement_levers(readings) * sd, plan.placement)


def margins_of(robot: Robot, plan: PosturePlan) -> dict[str, dict[str, Any]] | None:
    """Return the least margin of every constraint of `tulip plan optimal` over the postures.

    None where the robot has other than six joints a leg. Negative where a plan was not made to keep it, as
    a random one's.
    """
    try:
        problem = planning_problem(robot, nominal_plates(robot)[0], support=common_support(plan.support))
    except InputError:
        return None
    both = plan.support == "double"
    found = smallest_margins(problem, plan.take(both)) if both.any() else {}
    for support in ("right", "left"):
        if (one := plan.support == support).any():
            own = problem if support == "right" else from_other_foot(problem)
            found |= _single_margins(own, plan.take(one), f"{support} foot")
    return found


def _single_margins(problem: Problem, plan: PosturePlan, head: str) -> dict[str, dict[str, Any]]:
    least = {}
    for name, margin in single_support_margins(problem, plan.joint_angles, plan.swing_pose).items():
        row = int(margin.values.argmin())
        least[f"{head}: {name}"] = {
            "value": float(margin.values[row]),
            "unit": margin.unit,
            "posture": int(plan.posture[row]),
            "at": name,
        }
    return least


def plan_report(document: dict[str, Any], parameters: BaseParameters, plan: PosturePlan) -> list[Table | str]:
    """Return the tables and sentences of `described_plan`."""
    pairs, margins = document["correlations"], document["margins"]
    return [
        f"{document['well_identified']} of {len(parameters.names)} parameters would be well identified "
        f"(relative standard error below {WELL_IDENTIFIED:.0f} %), preset {document['preset']}, sigma "
        f"{document['sigma_mm']:.2f} mm.",
        prediction_table(document, parameters),
        correlation_table("full", [(p["a"], p["b"], p["rho"]) for p in pairs], parameters, plan.joint_angles)
        if pairs
        else NO_CORRELATION,
        "Margins are known for six joints a leg only." if margins is None else margin_table(margins),
        clearance_table(document["clearances"]),
    ]


def prediction_table(document: dict[str, Any], parameters: BaseParameters) -> Table:
    """Return the standard errors that a plan promises, of `described_plan`."""
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("s.e.", "mm", ".2f"),
        Column("of the nominal value", "%", ".1f"),
        Column("links", extra=True),
    )
    errors = document["predicted_standard_error_mm"]
    shares = document["predicted_relative_standard_error_percent"]
    rows = [
        [k, name, error, share if share < LARGE_SHARE else math.inf, united_links(parameters, k)]
        for k, (name, error, share) in enumerate(zip(parameters.names, errors, shares, strict=True), 1)
    ]
    title = f"Predicted standard errors, preset {document['preset']}, if every posture can be held"
    return Table(title, columns, rows, "-: the nominal value is near zero.")


def margin_table(margins: dict[str, dict[str, Any]]) -> Table:
    """Return the smallest margin of every constraint, of `margins_of`."""
    columns = (
        Column("constraint"),
        Column("margin", format=".3f"),
        Column("unit"),
        Column("posture", format="d"),
        Column("where"),
    )
    rows = [[name, m["value"], m["unit"], m["posture"], m["at"]] for name, m in margins.items()]
    return Table("Smallest margin of every constraint, beyond what `tulip plan optimal` keeps", columns, rows)


def trial_table(trials: list[dict[str, Any]]) -> Table:
    """Return the condition numbers of several trials with those of the paper's Table I."""
    columns = (
        Column("trial", format="d"),
        Column("seed", format="d"),
        Column("random", format=".1f"),
        Column("optimal", format=".1f"),
        Column("paper: random", format=".1f"),
        Column("paper: optimal", format=".1f"),
        Column("CPU time", "s", ".1f"),
    )
    names = ("seed", "initial_condition_number", "condition_number", "paper_initial", "paper", "cpu_s")
    rows = [[k, *(trial[name] for name in names)] for k, trial in enumerate(trials, 1)]
    note = "The paper does not publish its ranges, so only the orders of magnitude compare."
    return Table("Condition numbers of 50 postures, random and optimal (Table I)", columns, rows, note)
