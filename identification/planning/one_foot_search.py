"""Postures on one foot that are optimised together with those on both: candidates, choice and improvement.

In single support the robot is an open chain: statics determines the drive torques, the centre of pressure is
below the centre of mass, and the freely moving swing foot makes one more base parameter identifiable. The
plan contains these torques as feed-forward, so that the servos do not sag.

Every posture on one foot is put down by itself, on a placement of its own. Optimal ones use what torque the
drives have, and on the way from one to the next, in the laboratory's 2 s, the standing ankle's drive comes to
its limit even between near ones.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError, most_frequent
from tulip_testbed.identification.planning.blocks import FEASIBLE, exchanged, information
from tulip_testbed.identification.planning.closed_chain import chain_at, com_jacobian, open_chain_torques
from tulip_testbed.identification.planning.constraints import Evaluated
from tulip_testbed.identification.planning.linear_steps import Steps, descend, repaired
from tulip_testbed.identification.planning.objectives import PENALTY, Smooth, shifted
from tulip_testbed.identification.planning.one_foot import (
    evaluate_one_foot,
    from_other_foot,
    single_support_margins,
)
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.measurements import PosturePlan

DRAWS = 5000  # a round of random postures
MOST_ROUNDS, HOPELESS = 60, 6  # largest number of rounds; the same without any feasible posture
NEWTON_STEPS = 6
POOL = 3  # random postures for each wanted one on one foot
STEPS = 40  # linear steps of the postures on one foot in a round


@dataclass(frozen=True)
class OnOneFoot:
    """Postures on one foot.

    Attributes:
        support: "right" or "left".
        problem: constraints and regressor of standing on this foot.
        swing: pose of the other foot's board, (3,) [m, m, rad].
        angles: joint angles, (k, n) [rad].
    """

    support: str
    problem: PlanningProblem
    swing: np.ndarray
    angles: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """Return M = H'H of the postures, (p, p)."""
        return self.each.sum(axis=0)

    @property
    def each(self) -> np.ndarray:
        """Return the information of each posture, (k, p, p)."""
        rows = self.problem.parameters.regressor(self.angles)
        return rows.mT @ rows


def random_pools(
    problem: PlanningProblem, counts: Mapping[str, int], seed: int, times: int = POOL
) -> Iterator[OnOneFoot]:
    """Draw random feasible postures on each foot, `times` as many as are wanted if draws suffice.

    The lifted foot's board lies as far to its side as the ranges allow, so that both lie central to their
    feet.
    """
    for number, (support, count) in enumerate(counts.items()):
        own = problem if support == "right" else from_other_foot(problem)
        swing, rng = board_pose(own), np.random.default_rng([seed, number, 3])
        yield OnOneFoot(support, own, swing, feasible_pool(own, swing, count, rng, times))


def feasible_pool(
    problem: PlanningProblem, swing: np.ndarray, count: int, rng: np.random.Generator, times: int
) -> np.ndarray:
    """Draw random feasible postures on the stance foot with the other foot's board at a pose, (k, n) [rad].

    There are `times` as many as the `count` to be chosen from them, as far as draws suffice, or at least
    `count`.
    """
    limits = problem.parameters.tree.joint_range
    low, high = np.where(np.isfinite(limits), limits, [-np.pi, np.pi]).T
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
        values = np.array([*margins.values()])
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


def board_pose(problem: PlanningProblem) -> np.ndarray:
    """Return the pose of the lifted foot's board: its middle ahead, its farthest to the side, (3,)."""
    x, y, yaw = problem.ranges.swing_x, problem.ranges.swing_y, problem.ranges.swing_yaw
    return np.array([sum(x) / 2, max(y, key=abs), np.clip(0.0, *yaw)])


def from_pools(
    pools: list[OnOneFoot], counts: Mapping[str, int], rest: np.ndarray, smooth: Smooth
) -> list[OnOneFoot]:
    """Choose from pools the postures that minimise a function of M, by exchange (Fedorov 1972).

    The rest is the information of the postures on both feet, (p, p).
    """
    every = [pool.each for pool in pools]
    first = [list(range(counts[pool.support])) for pool in pools]
    now = rest + sum(each[rows].sum(axis=0) for each, rows in zip(every, first, strict=True))
    chosen = exchanged(every, first, now, smooth)
    return [replace(pool, angles=pool.angles[rows]) for pool, rows in zip(pools, chosen, strict=True)]


def improved(single: Sequence[OnOneFoot], both: np.ndarray, *stages: Smooth) -> list[OnOneFoot]:
    """Improve postures on each foot in turn by each function of M; those on both feet give (p, p) of it."""
    single = list(single)
    for smooth in stages:
        for k, own in enumerate(single):
            rest = both + total(single) - own.information
            single[k] = _descended(own, shifted(smooth, rest))
    return single


def total(single: Sequence[OnOneFoot]) -> np.ndarray | float:
    """Return the information of all postures on one foot, (p, p); 0 without any."""
    return np.sum([postures.information for postures in single], axis=0)


def _descended(own: OnOneFoot, smooth: Smooth) -> OnOneFoot:
    """Return feasible postures whose information has a smaller value, or the same postures."""
    problem, size = own.problem, own.angles.shape
    standing, free = np.broadcast_to(own.swing, (size[0], 3)), np.full(size, np.inf)

    def slope(plan: Evaluated, by_matrix: np.ndarray) -> np.ndarray:
        by_regressor = 2 * plan.regressor @ by_matrix
        return np.einsum("mip,minp->mn", by_regressor, plan.regressor_slopes, optimize=True)

    def moved(plan: Evaluated, step: np.ndarray) -> Evaluated:
        return evaluate_one_foot(problem, plan.chain.joint_angles + step, standing)

    columns = np.arange(own.angles.size).reshape(size)
    steps = Steps(1, columns, 1.0, slope, lambda plan: (-free, free), moved)
    first = evaluate_one_foot(problem, own.angles, standing)
    found = repaired(steps, descend(steps, first, smooth, STEPS, PENALTY), smooth)
    better = smooth(information(found))[0] < smooth(information(first))[0]
    kept = better and found.inequalities.min() >= -FEASIBLE
    return replace(own, angles=found.chain.joint_angles) if kept else own


def appended_on_one_foot(plan: PosturePlan, own: OnOneFoot) -> PosturePlan:
    """Append postures on one foot, each on a placement of its own, with the torques that hold them."""
    angles, count = own.angles, len(own.angles)
    torques = open_chain_torques(own.problem, chain_at(own.problem, angles))
    return replace(
        plan,
        joint_angles=np.concatenate([plan.joint_angles, angles]),
        posture=np.append(plan.posture, plan.posture.max() + 1 + np.arange(count)),
        placement=np.append(plan.placement, plan.placement.max() + 1 + np.arange(count)),
        support=np.append(plan.support, np.full(count, own.support)),
        swing_pose=np.concatenate([plan.swing_pose, np.tile(own.swing, (count, 1))]),
        torques=np.concatenate([plan.feed_forward, torques]),
    )
