"""Plan postures on the stance foot alone: their constraints and the most informative ones.

In single support the robot is an open chain: statics determines the drive torques, the centre of pressure is
below the centre of mass, and the freely moving swing foot makes one more base parameter identifiable. The
plan contains these torques as feed-forward, so that the servos do not sag.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.feasibility import place_polygon, predicted_cell_loads, support_polygon
from tulip_testbed.identification.kinematics import roll_pitch_yaw
from tulip_testbed.identification.planning.blocks import Block
from tulip_testbed.identification.planning.closed_chain import Chain, chain_at, com_jacobian
from tulip_testbed.identification.planning.collisions import link_room
from tulip_testbed.identification.planning.exchange import exchange
from tulip_testbed.identification.planning.legs import leg_stretch, limb_distances
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.path_order import sequences
from tulip_testbed.identification.planning.problem import Problem
from tulip_testbed.sim.errors import InputError, most_frequent
from tulip_testbed.sim.measurements import PosturePlan, lay_boards

DRAWS = 5000  # per round
MOST_ROUNDS, HOPELESS = 60, 6  # largest number of rounds; the same without any feasible posture
POOL = 8  # candidates for each wanted posture
NEWTON_STEPS = 6
PATH_POINTS = 7  # points checked between two postures
ON_THE_PATH = ("stability margin", "torques", "leg clearance", "link clearance", "swing foot lifted")


@dataclass(frozen=True)
class Margin:
    """Margin of one constraint by posture, (m,), in a readable unit; feasible where at least 0."""

    values: np.ndarray
    unit: str


def single_support_margins(problem: Problem, angles: np.ndarray, swing: np.ndarray) -> dict[str, Margin]:
    """Compute the margins by constraint for postures on the stance foot.

    Args:
        problem: the robot and its constraints.
        angles: joint angles, (m, n) [rad].
        swing: last pose of the standing swing foot, under which its board lies, (m, 3) [m, m, rad].
    """
    ranges, margins = problem.ranges, problem.margins
    chain = chain_at(problem, angles)
    torque = open_chain_torques(problem, chain)
    low, high = problem.limits.T
    stops = np.concatenate([angles - low, high - angles], axis=1) - margins.joint
    limited = np.isfinite(problem.torques)
    limits = np.where(limited, problem.torques, np.inf)
    spare = np.stack([margins.torque_share - torque / limits[:, k] for k in range(2)], axis=2)
    foot, place = chain.rotations[:, problem.swing], chain.positions[:, problem.swing]
    corners = np.column_stack([problem.soles[1], np.full(len(problem.soles[1]), problem.points[1][2])])
    lifted = place[:, 2, None] + np.einsum("mb,cb->mc", foot[:, 2], corners)
    side = place[:, 1] + foot[:, 1] @ problem.points[1]
    found = {
        "joint limits": (np.rad2deg(stops), "deg"),
        "torso range": (np.rad2deg(_torso_room(problem, chain)), "deg"),
        "least height": (1e3 * (chain.positions[:, problem.torso, 2:] - ranges.least_height), "mm"),
        "stability margin": (
            1e3 * (_sure_distance(problem, angles, chain.com) - ranges.stability_margin),
            "mm",
        ),
        "sole margin": (
            1e3 * (_edge_distances(problem.soles[0], chain.com[:, :2])[0] - ranges.sole_margin),
            "mm",
        ),
        "cell load": (_cell_loads(problem, chain.com, swing) - ranges.least_cell_load, "N"),
        "torques": (100 * spare.reshape(len(angles), -1), "% of limit"),
        "leg clearance": (1e3 * (limb_distances(problem, chain)[0] - margins.leg_clearance), "mm"),
        "straight leg": (
            1e3 * (leg_stretch(problem, chain)[0] - [margins.stretch * leg[2] for leg in problem.legs]),
            "mm",
        ),
        "link clearance": (1e3 * link_room(problem, chain, np.ones(len(angles), bool))[0], "mm"),
        "swing foot lifted": (1e3 * (lifted - margins.lifted), "mm"),
        "swing foot to its side": (1e3 * (side - ranges.swing_y[0])[:, None], "mm"),
    }
    return {
        name: Margin(values.min(axis=1), unit) for name, (values, unit) in found.items() if values.shape[1]
    }


def open_chain_torques(problem: Problem, chain: Chain) -> np.ndarray:
    """Compute the drive torques that hold the robot on its stance foot, (m, n) [N m].

    A drive carries the moment of the weight beyond it about its axis: tau = -a . (r x m g).
    """
    load = -problem.gravity * (chain.moment - chain.beyond[:, None] * chain.pivots)
    return chain.axes[..., 1] * load[..., 0] - chain.axes[..., 0] * load[..., 1]


def single_support_plan(
    problem: Problem, objective: Objective, plan: PosturePlan, measured: np.ndarray, count: int, seed: int
) -> PosturePlan:
    """Append `count` postures on the stance foot, on placements of their own, to a plan.

    The postures are chosen by exchange (Fedorov 1972) from random feasible ones, and ordered so that the
    robot does not tip between them. The boards stay where the last placement left them.

    Args:
        problem: planning problem with support "right".
        objective: the objective.
        plan: postures on both feet.
        measured: information of the measurements before, (p, p).
        count: number of postures.
        seed: seed of the draws.

    Raises:
        InputError: too few random postures are feasible; the message names the violated constraints.
    """
    rng = np.random.default_rng([seed, count, 1])
    swing = plan.swing_pose[-1]
    pool = _pool(problem, swing, count, rng)
    rows = problem.parameters.regressor(plan.joint_angles).reshape(-1, len(problem.nominal))
    none = Block(np.zeros((0, 9)), np.zeros((0, pool.shape[1])))
    offered = Block(np.tile([0.0] * 6 + swing.tolist(), (len(pool), 1)), pool)
    chosen = exchange(problem, none, offered, measured + rows.T @ rows, objective.smooth[-1], count).angles
    _, sizes = np.unique(plan.placement, return_counts=True)
    order, group = _sequences(problem, chosen, swing, int(sizes.max()))
    number = plan.placement.max() + 1 + group
    torques = open_chain_torques(problem, chain_at(problem, chosen[order]))
    made = {"postures": count, "candidates": len(pool), "lifted": problem.margins.lifted}
    return dataclasses.replace(
        plan,
        joint_angles=np.concatenate([plan.joint_angles, chosen[order]]),
        posture=np.append(plan.posture, plan.posture.max() + 1 + np.arange(count)),
        placement=np.append(plan.placement, number),
        support=np.append(plan.support, np.full(count, "right")),
        swing_pose=np.concatenate([plan.swing_pose, np.tile(swing, (count, 1))]),
        torques=np.concatenate([plan.feed_forward, torques]),
        made=plan.made | {"single_support": made},
    )


def _sequences(
    problem: Problem, angles: np.ndarray, swing: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Order postures, and assign placements, (m,) each, so that no path between two of them tips the robot.

    In single support the joints move on a line from posture to posture. If this path violates a constraint
    (`ON_THE_PATH`), the robot is lifted and put down instead, which begins another placement.

    Args:
        problem: the robot and its constraints.
        angles: joint angles of the postures, (m, n) [rad].
        swing: pose of the swing foot's board, (3,) [m, m, rad].
        most: largest number of postures on a placement.
    """
    count = len(angles)
    first, second = np.triu_indices(count, k=1)
    part = np.arange(1, PATH_POINTS + 1)[:, None] / (PATH_POINTS + 1)
    paths = angles[first, None] + part * (angles[second] - angles[first])[:, None]
    points = paths.reshape(-1, angles.shape[1])
    margins = single_support_margins(problem, points, np.broadcast_to(swing, (len(points), 3)))
    least = np.min([margins[name].values for name in ON_THE_PATH if name in margins], axis=0)
    room = np.full((count, count), -np.inf)
    room[first, second] = room[second, first] = least.reshape(-1, PATH_POINTS).min(axis=1)
    return sequences(room, most)


def _pool(problem: Problem, swing: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw random feasible postures on the stance foot, (k, n) [rad]; k is at least `count`."""
    low, high = np.where(np.isfinite(problem.limits), problem.limits, [-np.pi, np.pi]).T
    sole = problem.soles[0]
    inner = problem.ranges.stability_margin
    kept: list[np.ndarray] = []
    blocked: Counter[str] = Counter()
    for tried in range(1, MOST_ROUNDS + 1):
        angles = rng.uniform(low, high, (DRAWS, len(low)))
        target = rng.uniform(sole.min(axis=0) + inner, sole.max(axis=0) - inner, (DRAWS, 2))
        for _ in range(NEWTON_STEPS):  # least-norm: all joints move a little to bring the CoM to its target
            chain = chain_at(problem, angles)
            slope = com_jacobian(problem, chain)[:, :2]
            lack = target - chain.com[:, :2]
            inverse = np.linalg.inv(slope @ slope.mT + 1e-9 * np.eye(2))
            step = (slope.mT @ inverse @ lack[..., None])[..., 0]
            angles = angles + np.clip(step, -0.3, 0.3)
        within = ((angles >= low) & (angles <= high)).all(axis=1)  # a cheap test that rejects most
        blocked["joint limits"] += int((~within).sum())
        angles = angles[within]
        margins = single_support_margins(problem, angles, np.tile(swing, (len(angles), 1)))
        values = np.array([m.values for m in margins.values()])
        blocked.update({name: int((row < 0).sum()) for name, row in zip(margins, values, strict=True)})
        kept += list(angles[values.min(axis=0) >= 0])
        if len(kept) >= POOL * count or (not kept and tried == HOPELESS):
            break
    if len(kept) < count:
        raise InputError(
            f"{problem.robot.path}: planning ranges: found {len(kept)} postures on the stance foot in "
            f"{tried * DRAWS} draws, expected {count}; blocked by {most_frequent(blocked)}"
        )
    return np.array(kept)


def _torso_room(problem: Problem, chain: Chain) -> np.ndarray:
    """Return the margins of the torso's orientation to its ranges, (m, 6) [rad]."""
    angles, ranges = roll_pitch_yaw(chain.rotations[:, problem.torso]), problem.ranges
    low, high = np.array([ranges.torso_roll, ranges.torso_pitch, ranges.torso_yaw]).T
    return np.concatenate([angles - low, high - angles], axis=1)


def _sure_distance(problem: Problem, angles: np.ndarray, com: np.ndarray) -> np.ndarray:
    """Return the CoM's distance inside every edge of the stance sole minus its uncertainty, (m, 4) [m]."""
    distance, normal = _edge_distances(problem.soles[0], com[:, :2])
    across = np.einsum("ek,mkp->mep", normal, problem.parameters.regressor(angles))
    sd = np.sqrt(np.einsum("mep,pq,meq->me", across, problem.parameter_covariance, across))
    return distance - problem.margins.assurance * sd


def _edge_distances(sole: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of points (m, 2) inside a sole's edges, (m, 4) [m], and inner normals, (4, 2)."""
    polygon = support_polygon(sole)
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.linalg.norm(edge, axis=1)[:, None]
    return ((points[:, None] - polygon) * normal).sum(axis=2), normal


def _cell_loads(problem: Problem, com: np.ndarray, swing: np.ndarray) -> np.ndarray:
    """Return the cell loads of the stance foot's plate, (m, 4) [N]."""
    loads = []
    for point, pose in zip(com[:, :2], swing, strict=True):
        soles = np.array([problem.soles[0], place_polygon(problem.soles[1], pose)])
        boards = lay_boards(soles, problem.plate.size, problem.ranges.plate_gap)
        cop = np.array([point, boards[1, :2]])
        share = np.array([1.0, 0.0])
        loads.append(predicted_cell_loads(share, cop, boards, problem.plate, problem.weight)[:4])
    return np.array(loads)
