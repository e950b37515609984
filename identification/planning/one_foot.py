"""All constraints on a posture on one foot, with derivatives by the joint angles.

They are written for the foot that the problem calls the stance foot. Standing on the left foot is standing
on the stance foot of the robot with its feet exchanged (`from_other_foot`).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from tulip_testbed.identification.feasibility import (
    edge_distances,
    inner_normals,
    place_polygon,
    predicted_cell_loads,
    support_polygon,
)
from tulip_testbed.identification.kinematics import roll_pitch_yaw
from tulip_testbed.identification.planning.closed_chain import (
    Chain,
    chain_at,
    com_jacobian,
    cross,
    holding_torques,
    open_chain_torques,
    point_jacobian,
    torso_turn,
)
from tulip_testbed.identification.planning.constraints import (
    Evaluated,
    leg_stretch,
    link_room,
    quantity_of,
    stacked,
)
from tulip_testbed.identification.planning.problem import PlanningProblem, planning_problem
from tulip_testbed.measurements import lay_boards
from tulip_testbed.sim.robot import Robot

LEAST_SD = 1e-9  # m, of the CoM, so that its slope is finite
# Values, (m, k), feasible where at least 0, and a function that differentiates them by the angles, (m, k, n).
Part = tuple[np.ndarray, Callable[[], np.ndarray]]


def from_other_foot(problem: PlanningProblem) -> PlanningProblem:
    """Return the problem of standing on the swing foot, which becomes the stance foot.

    The base parameters remain those of the given problem; their regressor becomes that of the centre of mass
    in the other foot's frame, since the rotations of all frames are then taken relative to that foot.
    """
    robot, ranges = problem.robot, problem.ranges
    there = planning_problem(
        with_feet_exchanged(robot),
        problem.plate,
        replace(
            ranges,
            swing_y=(-ranges.swing_y[1], -ranges.swing_y[0]),
            swing_yaw=(-ranges.swing_yaw[1], -ranges.swing_yaw[0]),
        ),
        problem.margins,
        support="right",
    )
    return replace(
        there,
        parameters=replace(problem.parameters, base=there.parameters.base),
        parameter_covariance=problem.parameter_covariance,
        value=problem.value,
        side=-problem.side,
    )


@lru_cache(maxsize=8)
def with_feet_exchanged(robot: Robot) -> Robot:
    return replace(robot, stance_foot=robot.swing_foot, swing_foot=robot.stance_foot)


def one_foot_constraints(problem: PlanningProblem, chain: Chain, swing: np.ndarray) -> dict[str, Part]:
    """Compute the constraints on postures on the stance foot [m, rad, N, or share of the limit].

    The board of the other foot lies under its last standing pose, (m, 3) [m, m, rad].
    """
    angles, ranges, margins = chain.joint_angles, problem.ranges, problem.margins
    low, high = problem.parameters.tree.joint_range.T
    used = open_chain_torques(problem, chain) / problem.torques
    spare = margins.torque_share + np.stack([used, -used], axis=2)
    height, side = _lifted(problem, chain)
    least_side = min(problem.side * y for y in ranges.swing_y)
    room, room_slope = leg_stretch(problem, chain)
    link, link_slope = link_room(problem, chain, np.ones(len(angles), bool))
    sole = support_polygon(problem.soles[0])
    apart, inward = edge_distances(chain.com[:, :2], sole), inner_normals(sole)
    sd, sd_slope = _uncertainty(problem, angles, inward)

    def plan_view() -> np.ndarray:
        return com_jacobian(problem, chain)[:, :2]

    def stops() -> np.ndarray:
        one = np.eye(angles.shape[1])
        return np.broadcast_to(np.concatenate([one, -one]), (len(angles), 2 * len(one), len(one)))

    def torques() -> np.ndarray:
        slope = holding_torques(problem, chain, np.zeros((len(angles), 6)))[1]
        rate = slope / problem.torques[:, None]
        return np.stack([rate, -rate], axis=2).reshape(len(angles), -1, len(low))

    def loads() -> np.ndarray:  # linear in the CoM's x and y
        steps = [_cell_loads(problem, chain.com + step, swing) - cells for step in np.eye(3)[:2]]
        return np.stack(steps, axis=2) @ plan_view()

    torso, torso_slope = _torso_room(problem, chain)
    cells = _cell_loads(problem, chain.com, swing)
    found = {
        "joint limits": (np.concatenate([angles - low, high - angles], axis=1) - margins.joint, stops),
        "torso range": (torso, torso_slope),
        "least height": (
            chain.positions[:, problem.torso, 2:] - ranges.least_height,
            lambda: point_jacobian(problem, chain, problem.torso)[:, 2:],
        ),
        "stability margin": (
            apart - margins.assurance * sd - ranges.stability_margin,
            lambda: inward @ plan_view() - margins.assurance * sd_slope(),
        ),
        "sole margin": (apart - ranges.sole_margin, lambda: inward @ plan_view()),
        "cell load": (cells - ranges.least_cell_load, loads),
        "torques": (spare.reshape(len(angles), -1), torques),
        "straight leg": (
            room - np.array([margins.stretch * leg[2] for leg in problem.legs]),
            lambda: room_slope,
        ),
        "link clearance": (link, lambda: link_slope),
        "swing foot lifted": (height[0] - margins.lifted, height[1]),
        "swing foot to its side": (side[0] - least_side, side[1]),
    }
    return {name: part for name, part in found.items() if part[0].shape[1]}


def single_support_margins(
    problem: PlanningProblem, angles: np.ndarray, swing: np.ndarray
) -> dict[str, np.ndarray]:
    """Compute the margin of every constraint for postures on the stance foot, (m,), in its readable unit.

    The board of the other foot lies under its last standing pose, (m, 3) [m, m, rad].
    """
    found = one_foot_constraints(problem, chain_at(problem, angles), swing)
    return {name: quantity_of(name)[2] * values.min(axis=1) for name, (values, _) in found.items()}


def evaluate_one_foot(problem: PlanningProblem, angles: np.ndarray, swing: np.ndarray) -> Evaluated:
    """Evaluate postures on the stance foot with all derivatives; arguments as `single_support_margins`."""
    chain = chain_at(problem, angles)
    found = one_foot_constraints(problem, chain, swing)
    return Evaluated(
        chain=chain,
        **stacked(problem, {name: (values, slopes()) for name, (values, slopes) in found.items()}),
        regressor=problem.parameters.regressor(angles),
        regressor_slopes=problem.parameters.slope(angles),
    )


def _torso_room(problem: PlanningProblem, chain: Chain) -> Part:
    """Return the margins of the torso's orientation to its ranges, (m, 6) [rad], and their slopes."""
    angles, (low, high) = roll_pitch_yaw(chain.rotations[:, problem.torso]), problem.ranges.torso.T

    def slopes() -> np.ndarray:
        turning = chain.axes.mT * problem.moved[:, problem.torso]
        rate = np.linalg.solve(torso_turn(angles)[1], turning)
        return np.concatenate([rate, -rate], axis=1)

    return np.concatenate([angles - low, high - angles], axis=1), slopes


def _lifted(problem: PlanningProblem, chain: Chain) -> tuple[Part, Part]:
    """Return the height of the swing sole's corners, (m, 4), and its place to its own side, (m, 1) [m]."""
    foot, place = chain.rotations[:, problem.swing_frame], chain.positions[:, problem.swing_frame]
    corners = np.column_stack([problem.soles[1], np.full(len(problem.soles[1]), problem.points[1][2])])
    height = place[:, 2, None] + np.einsum("mb,cb->mc", foot[:, 2], corners)
    side = place[:, 1] + foot[:, 1] @ problem.points[1]

    def speed(points: np.ndarray) -> np.ndarray:
        arm = place[:, None] + points @ foot.mT
        moved = problem.moved[:, problem.swing_frame, None]
        return cross(chain.axes[:, None], arm[:, :, None] - chain.pivots[:, None]) * moved

    return (
        (height, lambda: speed(corners)[..., 2]),
        (problem.side * side[:, None], lambda: problem.side * speed(problem.points[1:])[..., 1]),
    )


def _uncertainty(problem: PlanningProblem, angles: np.ndarray, inward: np.ndarray) -> Part:
    """Return the s.d. of the nominal CoM across every edge of the stance sole, (m, 4) [m], and its slopes."""
    spread = problem.parameter_covariance
    across = np.einsum("ek,mkp->mep", inward, problem.parameters.regressor(angles))
    sd = np.sqrt(np.einsum("mep,pq,meq->me", across, spread, across))

    def slopes() -> np.ndarray:
        turned = np.einsum("ek,mknp->menp", inward, problem.parameters.slope(angles))
        rate = np.einsum("menp,mep->men", turned, across @ spread)
        return rate / np.maximum(sd, LEAST_SD)[..., None]

    return sd, slopes


def _cell_loads(problem: PlanningProblem, com: np.ndarray, swing: np.ndarray) -> np.ndarray:
    """Return the cell loads of the stance foot's plate, (m, 4) [N]."""
    loads, order = [], slice(None, None, 1 if problem.side > 0 else -1)  # boards: the right one first
    share = np.array([1.0, 0.0])
    for point, pose in zip(com[:, :2], swing, strict=True):
        soles = np.array([problem.soles[0], place_polygon(problem.soles[1], pose)])
        boards = lay_boards(soles[order], problem.plate.size, problem.ranges.plate_gap)[order]
        cop = np.array([point, boards[1, :2]])
        loads.append(predicted_cell_loads(share, cop, boards, problem.plate, problem.weight)[:4])
    return np.array(loads)
