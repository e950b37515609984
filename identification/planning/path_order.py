"""Order postures so that the paths between them keep the constraints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.link_paths import blocked
from tulip_testbed.identification.planning.problem import PlanningProblem
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.path import ClosedChain


def _sequences(room: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Order postures along paths with room, and number the groups without a path between them.

    Args:
        room: room on the path between each two postures, feasible where at least 0, (m, m).
        first: posture to begin with.

    Returns:
        The order, (m,), and the group of each posture in this order, from 0, (m,).
    """
    left = [first, *(k for k in range(len(room)) if k != first)]
    order, group = [], []
    while left:
        ahead = room[order[-1], left] if order else np.array([-np.inf])
        if ahead.max() >= 0:
            order.append(left.pop(int(ahead.argmax())))
            group.append(group[-1])
        else:
            order.append(left.pop(0))
            group.append(group[-1] + 1 if group else 0)
    return np.array(order), np.array(group)


def with_free_paths(problem: PlanningProblem, plan: PosturePlan) -> PosturePlan:
    """Return a plan on both feet whose links keep apart on the paths between its postures.

    Placements keep the order of their postures if they can. If no order will do, the robot is lifted and put
    down instead: the rest becomes placements with the same foot pose at the end of the plan.
    """
    chain = ClosedChain(problem.robot.model, problem.robot)
    kept, added = [], []
    for number in dict.fromkeys(plan.placement.tolist()):
        rows = np.flatnonzero(plan.placement == number)
        first, *rest = _groups(problem, chain, plan.joint_angles[rows])
        kept.append((number, rows[first]))
        added += [rows[group] for group in rest]
    last = int(plan.placement.max())
    parts = [*kept, *enumerate(added, last + 1)]
    moved = plan.take(np.concatenate([rows for _, rows in parts]))
    placement = np.repeat([number for number, _ in parts], [len(rows) for _, rows in parts])
    return replace(moved, posture=plan.posture, placement=placement)


def _groups(problem: PlanningProblem, chain: ClosedChain, angles: np.ndarray) -> list[np.ndarray]:
    """Split postures (k, n) into as few sequences with free paths as a greedy search finds."""
    count = len(angles)

    def free(a: int, b: int) -> bool:
        return blocked(problem.pairs, chain.path, angles[a], angles[b]) is None

    if all(free(k, k + 1) for k in range(count - 1)):
        return [np.arange(count)]
    room = np.full((count, count), -1.0)
    for a in range(count):
        for b in range(a + 1, count):
            room[a, b] = room[b, a] = 0.0 if free(a, b) else -1.0
    found = [_sequences(room, first) for first in range(count)]
    order, group = min(found, key=lambda one: one[1].max())
    return [order[group == k] for k in range(group.max() + 1)]
