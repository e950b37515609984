"""The order in which a plan is measured: short ways, and time that grows with nothing else."""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, LIFT, MotionPlanner
from tulip_testbed.experiments.usable_plan import planned_parameters
from tulip_testbed.identification.feasibility import place_polygon
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.procedure import start_times
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, sole_corners
from tulip_testbed.sim.scene import boards_under, nominal_plates

SAME = 1e-9  # m, s, between nodes that are one
SEPARATED = 1.15  # inflation of a drift's standard error that is small enough
ROUNDS = (1, 2, 3)
HOISTED = 10.0  # s more than the motion itself, to take the load off the robot: prefers free motions
REFUSED = 1e4  # s, more than every motion: the robot would have to be lifted


def shortest_tour(cost: np.ndarray) -> list[int]:
    """Return a shortest closed tour of all nodes that begins with the first.

    Nodes at no distance from each other are one. HiGHS chooses edges such that every node has two; as long as
    they form several tours, each is forbidden and it chooses again (Dantzig, Fulkerson and Johnson 1954).

    Args:
        cost: symmetric, with the triangle inequality where it is zero, (n, n).
    """
    owner = (cost <= SAME).argmax(axis=1)
    places = np.unique(owner)
    count = len(places)
    first, second = np.triu_indices(count, 1)
    length, every = cost[places[first], places[second]], np.arange(count)[:, None]
    rows = [LinearConstraint(((first == every) | (second == every)).astype(float), 2, 2)]
    tours, inner = 0, list(range(count))
    while count > 3 and tours != 1:
        whole = {"integrality": np.ones(len(length)), "bounds": Bounds(0, 1)}
        taken = milp(length, **whole, constraints=rows).x > 0.5
        graph = csr_array((np.ones(taken.sum()), (first[taken], second[taken])), shape=(count, count))
        tours, member = connected_components(graph, directed=False)
        rows += [
            LinearConstraint((inside[first] & inside[second]).astype(float), ub=inside.sum() - 1)
            for inside in member == np.arange(tours)[:, None]
        ]
        left, inner = list(zip(first[taken].tolist(), second[taken].tolist(), strict=True)), [0]
        while tours == 1 and len(left) > 1:  # from node to node
            edge = next(edge for edge in left if inner[-1] in edge)
            left.remove(edge)
            inner.append(edge[0] if edge[1] == inner[-1] else edge[1])
    tour = [int(node) for k in inner for node in np.flatnonzero(owner == places[k])]
    return tour[tour.index(0) :] + tour[: tour.index(0)]


def shortest_path(cost: np.ndarray) -> list[int]:
    """Return a shortest open way through all nodes: a tour by one more node, equally far from all."""
    padded = np.pad(cost, ((1, 0), (1, 0)), constant_values=1.0 + cost.max())
    padded[0, 0] = 0.0
    return [node - 1 for node in shortest_tour(padded)[1:]]


def order_of_placement(planner: MotionPlanner, rows: np.ndarray) -> np.ndarray:
    """Order the rows of one placement and support.

    Motions are planned only where the tour may go: elsewhere their least duration is enough. The
    first of the repeated postures opens the placement and closes it.
    """
    plan = planner.plan
    _, first = np.unique(plan.posture[rows], return_index=True)
    once = rows[np.sort(first)]
    again = rows[~np.isin(rows, once)]
    if len(once) == 1:
        return rows
    least = planner.least_duration
    cost = np.array([[0.0 if a == b else least(a, b) for b in once] for a in once])
    known = np.eye(len(once), dtype=bool)
    while True:
        tour = shortest_tour(cost) if len(again) else shortest_path(cost)
        steps = list(zip(tour, [*tour[1:], tour[0]], strict=True))
        steps = steps if len(again) else steps[:-1]
        unknown = [(a, b) for a, b in steps if not known[a, b]]
        if not unknown:
            break
        for a, b in unknown:
            known[a, b] = known[b, a] = True
            duration, kind = planner.way(once[a], once[b])
            cost[a, b] = cost[b, a] = {FREE: duration, HOIST: duration + HOISTED, LIFT: REFUSED}[kind]
    ordered = once[tour]
    if not len(again):
        return ordered
    position = {int(number): k for k, number in enumerate(plan.posture[ordered])}
    ordered = np.roll(ordered, -position[int(plan.posture[again[0]])])
    return np.concatenate([ordered, again])


def stances_in_order(
    planner: MotionPlanner, placements: Sequence[int], progress: Progress = silent
) -> Iterator[np.ndarray]:
    """Order the rows of every support on every placement; the placements are in order."""
    plan = planner.plan
    with progress("placements", len(placements), 0) as advance:
        for number in placements:
            there = np.flatnonzero(plan.placement == number)
            for support in dict.fromkeys(plan.support[there].tolist()):
                yield order_of_placement(planner, there[plan.support[there] == support])
            advance(1)


def order_of_placements(robot: Robot, plan: PosturePlan) -> list[int]:
    """Order the placements of a plan by their numbers.

    They form a shortest closed tour: it goes out and comes back, so that the place of the feet does not grow
    with time. Of all beginnings of the tour and both directions, the one is taken in which a linear drift is
    determined best from everything else. If that is not enough (`SEPARATED`), the tour is gone round twice or
    three times, with every second or third placement each time. A placement that only repeats postures comes
    half a tour after, or before, the placement that it repeats.
    """
    numbers = list(dict.fromkeys(plan.placement.tolist()))
    rows = {number: np.flatnonzero(plan.placement == number) for number in numbers}
    owner: dict[int, int] = {}
    for number in numbers:
        for posture in plan.posture[rows[number]].tolist():
            owner.setdefault(posture, number)
    repeats = [n for n in numbers if all(owner[p] != n for p in plan.posture[rows[n]].tolist())]
    own = [number for number in numbers if number not in repeats]
    tour = [own[k] for k in shortest_tour(marks_moved(robot, plan, [int(rows[n][0]) for n in own]))]
    basis, rig = _explained(robot, plan), preset_rig("ideal", robot)

    def complete(turned: list[int]) -> list[int]:
        half, out = len(turned) // 2, list(turned)
        for number in repeats:
            there = turned.index(owner[int(plan.posture[rows[number][0]])])
            after = turned[(there + half) % len(turned)]
            out.insert(out.index(after) + 1, number)
        return out

    def inflated(order: list[int]) -> float:
        return _inflation(basis, rig, plan, np.concatenate([rows[number] for number in order]))

    for rounds in ROUNDS:
        turned = [way[k:] + way[:k] for way in (tour, tour[::-1]) for k in range(len(tour))]
        orders = [complete([number for k in range(rounds) for number in way[k::rounds]]) for way in turned]
        best = min(orders, key=inflated)
        if inflated(best) <= SEPARATED:
            break
    return best


def drift_inflation(robot: Robot, plan: PosturePlan) -> float:
    """Return by how much the standard error of a linear drift grows since other things vary with time [-].

    The drift is that of the centre of pressure in x or in y, whichever is determined worse. The other things
    are the base parameters and all else that is linear in the place of the feet.
    """
    return _inflation(_explained(robot, plan), preset_rig("ideal", robot), plan, np.arange(len(plan)))


def _explained(robot: Robot, plan: PosturePlan) -> np.ndarray:
    """Return an orthonormal basis of what base parameters and feet can explain, (m, 2, p)."""
    columns = stacked_regressor(planned_parameters(robot, plan), plan.joint_angles, plan.support)
    feet = np.column_stack([np.ones(len(plan)), plan.swing_pose])
    places = np.einsum("mk,ab->makb", feet, np.eye(2)).reshape(2 * len(plan), -1)
    return np.asarray(scipy.linalg.orth(np.hstack([columns, places]))).reshape(len(plan), 2, -1)


def _inflation(basis: np.ndarray, rig: Rig, plan: PosturePlan, order: np.ndarray) -> float:
    """Return the larger inflation of both axes with a basis of `_explained`."""
    if len(order) < 2:
        return 1.0
    time = start_times(rig, plan.placement[order])
    time = (time - time.mean()) / np.linalg.norm(time - time.mean())
    explained = [float(((time @ basis[order, axis]) ** 2).sum()) for axis in range(2)]
    return 1 / np.sqrt(max(1 - max(explained), 1e-12))


def marks_moved(robot: Robot, plan: PosturePlan, rows: list[int]) -> np.ndarray:
    """Return how far boards and foot marks move from one placement to another in the mean, (k, k) [m].

    They are seen from the right board: the corners of the left board and of both soles.

    Args:
        rows: one row of every placement.
    """
    feet = plan.foot_poses[rows]
    boards = boards_under(preset_rig("ideal", robot), feet)
    corners = nominal_plates(robot)[0].corners
    soles = [sole_corners(robot.model, foot)[:, :2] for foot in robot.feet]
    marks = np.array(
        [
            np.concatenate([place_polygon(c, pose) for c, pose in zip([corners, *soles], poses, strict=True)])
            - board[0, :2]
            for poses, board in zip(np.concatenate([boards[:, 1:], feet], axis=1), boards, strict=True)
        ]
    )
    return np.linalg.norm(marks[:, None] - marks[None], axis=-1).mean(axis=-1)
