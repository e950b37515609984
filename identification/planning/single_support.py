"""Plan postures on the stance foot alone: their constraints and the most informative ones.

In single support the robot is an open chain: statics determines the drive torques, the centre of pressure is
below the centre of mass, and the freely moving swing foot makes one more base parameter identifiable. The
plan contains these torques as feed-forward, so that the servos do not sag.
"""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np

from tulip_testbed.base.errors import InputError, most_frequent
from tulip_testbed.identification.planning.blocks import Block
from tulip_testbed.identification.planning.closed_chain import chain_at, com_jacobian, open_chain_torques
from tulip_testbed.identification.planning.exchange import exchange
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.one_foot import single_support_margins
from tulip_testbed.identification.planning.path_order import sequences
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.measurements import PosturePlan

DRAWS = 5000  # per round
MOST_ROUNDS, HOPELESS = 60, 6  # largest number of rounds; the same without any feasible posture
POOL = 8  # candidates for each wanted posture
NEWTON_STEPS = 6
PATH_POINTS = 7  # points checked between two postures
ON_THE_PATH = ("stability margin", "torques", "leg clearance", "link clearance", "swing foot lifted")


def single_support_plan(
    problem: PlanningProblem,
    objective: Objective,
    plan: PosturePlan,
    measured: np.ndarray,
    count: int,
    seed: int,
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
    pool = feasible_pool(problem, swing, count, rng)
    rows = problem.parameters.regressor(plan.joint_angles).reshape(-1, len(problem.nominal))
    none = Block(np.zeros((0, 9)), np.zeros((0, pool.shape[1])))
    offered = Block(np.tile([0.0] * 6 + swing.tolist(), (len(pool), 1)), pool)
    chosen = exchange(problem, none, offered, measured + rows.T @ rows, objective.smooth[-1], count).angles
    _, sizes = np.unique(plan.placement, return_counts=True)
    order, group = ordered_on_one_foot(problem, chosen, swing, int(sizes.max()))
    made = {"postures": count, "candidates": len(pool), "lifted": problem.margins.lifted}
    plan = dataclasses.replace(plan, made=plan.made | {"single_support": made})
    return appended_on_one_foot(problem, plan, "right", chosen[order], swing, group)


def appended_on_one_foot(
    problem: PlanningProblem,
    plan: PosturePlan,
    support: str,
    angles: np.ndarray,
    swing: np.ndarray,
    group: np.ndarray,
) -> PosturePlan:
    """Append postures on one foot to a plan, with the torques that hold them.

    Args:
        problem: of standing on this foot.
        angles: joint angles, (k, n) [rad].
        swing: pose of the other foot's board, (3,) [m, m, rad].
        group: number of each posture's placement, from 0, (k,).
    """
    count = len(angles)
    torques = open_chain_torques(problem, chain_at(problem, angles))
    return dataclasses.replace(
        plan,
        joint_angles=np.concatenate([plan.joint_angles, angles]),
        posture=np.append(plan.posture, plan.posture.max() + 1 + np.arange(count)),
        placement=np.append(plan.placement, plan.placement.max() + 1 + group),
        support=np.append(plan.support, np.full(count, support)),
        swing_pose=np.concatenate([plan.swing_pose, np.tile(swing, (count, 1))]),
        torques=np.concatenate([plan.feed_forward, torques]),
    )


def ordered_on_one_foot(
    problem: PlanningProblem, angles: np.ndarray, swing: np.ndarray, most: int
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


def feasible_pool(
    problem: PlanningProblem, swing: np.ndarray, count: int, rng: np.random.Generator, times: int = POOL
) -> np.ndarray:
    """Draw random feasible postures on the stance foot, (k, n) [rad].

    Args:
        problem: the robot and its constraints.
        swing: pose of the swing foot's board, (3,) [m, m, rad].
        count: number of postures to choose from them, the smallest number to draw.
        rng: random generator.
        times: number of postures to draw for each of these, as far as draws suffice.

    Raises:
        InputError: fewer are feasible; the message names the violated constraints.
    """
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
        if len(kept) >= times * count or (not kept and tried == HOPELESS):
            break
    if len(kept) < count:
        raise InputError(
            f"{problem.robot.path}: planning ranges: found {len(kept)} postures on the stance foot in "
            f"{tried * DRAWS} draws, expected {count}; blocked by {most_frequent(blocked)}"
        )
    return np.array(kept)
