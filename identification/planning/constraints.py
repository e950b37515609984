"""All constraints on a posture as inequalities g(u) >= 0, with derivatives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.identification.link_clearances import clearances
from tulip_testbed.identification.planning.closed_chain import (
    DESIGN,
    Chain,
    cross,
    holding_torques,
    point_jacobian,
    solve_chain,
)
from tulip_testbed.identification.planning.footing import PLAN, footing_slopes
from tulip_testbed.identification.planning.problem import PlanningProblem

NEAREST = 12  # pairs of links of a posture that are constrained
BEYOND = 0.02  # m: links that are farther from each other than needed by this count as being there
# Units of the inequalities: a value of one corresponds to this margin.
LENGTH, ANGLE, FORCE, TORQUE = 0.01, 0.1, 10.0, 0.1  # m, rad, N, share of the limit
# By a constraint's first word: the unit of its inequality, the readable unit and its size.
QUANTITIES = {
    "joint": (ANGLE, "deg", float(np.rad2deg(1))),
    "torso": (ANGLE, "deg", float(np.rad2deg(1))),
    "cell": (FORCE, "N", 1.0),
    "foot": (FORCE, "N", 1.0),
    "torque": (TORQUE, "% of limit", 100.0),
    "torques": (TORQUE, "% of limit", 100.0),
}
DISTANCE = (LENGTH, "mm", 1e3)
REACHED = 1e-9  # m, rad: a larger residual of an equation means that the targets are out of reach
UNREACHED = 10.0  # violation of all inequalities of a posture out of reach


def quantity_of(constraint: str) -> tuple[float, str, float]:
    """Return the unit of a constraint's inequality, its readable unit and the size of this."""
    return QUANTITIES.get(constraint.split()[0], DISTANCE)


def link_room(problem: PlanningProblem, chain: Chain, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the distances of the nearest pairs of links beyond what they must keep, in the wanted postures.

    The distances are in the order of the pairs, (m, s) [m], and their derivatives by the joint angles are
    (m, s, n). The nearest points are held fixed on their links, which is exact to first order. In postures
    that are not wanted, (m,) bool, all links count as far from each other.
    """
    pairs, kept = problem.pairs, min(NEAREST, len(problem.pairs.names))
    within, rows = problem.margins.link_clearance + BEYOND, np.flatnonzero(wanted)
    values = np.full((len(wanted), kept), BEYOND)
    slopes = np.zeros((len(wanted), kept, chain.joint_angles.shape[1]))
    if not kept:
        return values, slopes
    found = clearances(pairs, chain.rotations[rows], chain.positions[rows], within)
    room = found.distance - pairs.needed
    chosen = np.sort(np.argpartition(room, kept - 1, axis=1)[:, :kept], axis=1)
    values[rows] = np.take_along_axis(room, chosen, axis=1)
    place = np.full(room.shape, -1)
    np.put_along_axis(place, chosen, np.arange(kept), axis=1)
    slot = place[found.posture, found.pair]
    used = slot >= 0
    posture, frames = rows[found.posture[used]], pairs.frames[found.pair[used]]
    axes, pivots = chain.axes[posture], chain.pivots[posture]
    for sign, k in ((-1, 0), (1, 1)):
        arm = found.points[used, k, None] - pivots
        speed = (cross(axes, arm) * found.normal[used, None]).sum(axis=2)
        slopes[posture, slot[used]] += sign * speed * problem.moved[:, frames[:, k]].T
    return values, slopes


def leg_stretch(problem: PlanningProblem, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Return the shortening of hip to ankle against a straight knee, (m, legs) [m], and its derivative."""
    m, n = chain.joint_angles.shape
    room, slopes = np.empty((m, len(problem.legs))), np.empty((m, len(problem.legs), n))
    for k, (hip, ankle, length) in enumerate(problem.legs):
        line = chain.positions[:, ankle] - chain.positions[:, hip]
        distance = np.linalg.norm(line, axis=1)
        slope = point_jacobian(problem, chain, ankle) - point_jacobian(problem, chain, hip)
        room[:, k] = length - distance
        slopes[:, k] = -((line / distance[:, None])[:, None] @ slope)[:, 0]
    return room, slopes


@dataclass(frozen=True)
class Evaluated:
    """Evaluated postures; m postures, s inequalities, p base parameters.

    They are differentiated by v variables: on both feet by the nine of u, on one foot by the joint angles.

    Attributes:
        chain: joint angles and kinematics.
        names: the constraint of each inequality, (s,).
        inequalities: constraint values, feasible where at least 0, (m, s).
        inequality_jacobian: their derivatives, (m, s, v).
        regressor, regressor_slopes: R_b (eq. 6), (m, 2, p), and its derivative, (m, 2, p, 9) on both feet and
            (m, 2, n, p) on one.
    """

    chain: Chain
    names: tuple[str, ...]
    inequalities: np.ndarray
    inequality_jacobian: np.ndarray
    regressor: np.ndarray
    regressor_slopes: np.ndarray


@dataclass(frozen=True)
class Evaluation(Evaluated):
    """Evaluated postures on both feet.

    Attributes:
        design: design variables u, (m, 9) [m, rad, m, m, rad].
        reached: whether inverse kinematics succeeded, (m,) bool.
        joint_jacobian: dq/du, (m, n, 9).
        torque: drive torques that share the load between the feet as planned, (m, n) [N m].
    """

    design: np.ndarray
    reached: np.ndarray
    joint_jacobian: np.ndarray
    torque: np.ndarray


def stacked(problem: PlanningProblem, parts: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    """Return the fields of `Evaluated` about constraints, of which each has values, (m, k), and slopes."""
    values, slopes = (
        np.concatenate([part[k] / quantity_of(name)[0] for name, part in parts.items()], axis=1)
        for k in (0, 1)
    )
    names = tuple(name for name, (value, _) in parts.items() for _ in range(value.shape[1]))
    return {"names": names, "inequalities": values - problem.margins.rounding, "inequality_jacobian": slopes}


def evaluate(problem: PlanningProblem, design: np.ndarray, guess: np.ndarray) -> Evaluation:
    """Evaluate all postures at their design variables u.

    Args:
        design: CoM x, y, z, torso roll, pitch, yaw, swing foot x, y, yaw, (m, 9) [m, rad, m, m, rad].
        guess: joint angles near the solution, (m, n) [rad].
    """
    ranges, margins, parameters = problem.ranges, problem.margins, problem.parameters
    chain, left, dq = solve_chain(problem, design[:, :3], design[:, 3:6], design[:, 6:], guess)
    reached = left < REACHED
    angles = chain.joint_angles

    regressor = parameters.regressor(angles)
    by_angle = parameters.slope(angles)  # (m, 2, n, p)
    covariance, covariance_slope = _com_covariance(regressor, by_angle, problem.parameter_covariance)
    foot, foot_slope = footing_slopes(problem, np.column_stack([design[:, [0, 1, 6, 7, 8]], covariance]))
    by_design = np.zeros((len(design), PLAN, DESIGN))
    by_design[:, [0, 1, 2, 3, 4], [0, 1, 6, 7, 8]] = 1.0
    by_design[:, 5:8] = covariance_slope @ dq
    wrench = np.zeros((len(design), 6))
    wrench[:, 2:5] = foot.wrench
    torque, torque_by_angle, lines = holding_torques(problem, chain, wrench)
    torque_slope = torque_by_angle @ dq + lines[..., 2:5] @ (foot_slope.wrench @ by_design)

    names = parameters.tree.joints
    low, high = parameters.tree.joint_range[problem.between].T
    stay, turn = angles[:, problem.between], dq[:, problem.between]
    joints = np.stack([stay - low, high - stay], axis=2) - margins.joint
    slopes = np.stack([turn, -turn], axis=2)
    height = chain.positions[:, problem.torso, 2:] - ranges.least_height
    height_slope = point_jacobian(problem, chain, problem.torso)[:, 2:] @ dq

    limited = np.isfinite(problem.torques)
    limits = np.where(limited, problem.torques, 1.0)
    used, used_slope = torque / limits, torque_slope / limits[:, None]
    spare = margins.torque_share + np.stack([used, -used], axis=2)
    spare_slope = np.stack([used_slope, -used_slope], axis=2)
    room, room_slope = leg_stretch(problem, chain)
    link, link_slope = link_room(problem, chain, reached)
    straight = np.array([length for _, _, length in problem.legs])

    parts = {
        **{f"joint limit {names[j]}": (joints[:, k], slopes[:, k]) for k, j in enumerate(problem.between)},
        "least height": (height, height_slope),
        "stability margin": (foot.polygon - ranges.stability_margin, foot_slope.polygon @ by_design),
        "sole margin": (foot.soles - ranges.sole_margin, foot_slope.soles @ by_design),
        "cell load": (foot.cells - ranges.least_cell_load, foot_slope.cells @ by_design),
        "foot load": (foot.feet - margins.foot_load, foot_slope.feet @ by_design),
        "boards and feet": (foot.boards, foot_slope.boards @ by_design),
        **{f"torque {name}": (spare[:, j], spare_slope[:, j]) for j, name in enumerate(names) if limited[j]},
        "straight leg": (room - margins.stretch * straight, room_slope @ dq),
        "link clearance": (link, link_slope @ dq),
    }
    constrained = stacked(problem, parts)
    constrained["inequalities"][~reached], constrained["inequality_jacobian"][~reached] = -UNREACHED, 0.0
    return Evaluation(
        chain=chain,
        **constrained,
        regressor=regressor,
        regressor_slopes=np.einsum("mijp,mju->mipu", by_angle, dq, optimize=True),
        design=design,
        reached=reached,
        joint_jacobian=dq,
        torque=torque,
    )


def _com_covariance(
    regressor: np.ndarray, by_angle: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return covariances xx, xy, yy of the nominal CoM, (m, 3) [m2], and by joint angles, (m, 3, n)."""
    weighted = regressor @ spread
    covariance = weighted @ regressor.mT
    half = np.einsum("mijp,mkp->mikj", by_angle, weighted, optimize=True)
    slope = half + half.transpose(0, 2, 1, 3)
    rows, columns = [0, 0, 1], [0, 1, 1]
    return covariance[:, rows, columns], slope[:, rows, columns]
