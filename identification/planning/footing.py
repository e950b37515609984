"""Constraints in the plan view: support polygon, loads of feet and cells, boards.

Every function accepts complex numbers, since derivatives are computed by complex steps (Squire and Trapp
1998): f'(x) = Im f(x + ih) / h is free of cancellation and so exact to rounding. Decisions, for example
whether a corner is on the hull, use the real parts.
"""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.feasibility import planned_foot_loads
from tulip_testbed.identification.planning.problem import PlanningProblem

STEP = 1e-30
COLLINEAR = 1e-12  # m2
LEAST_VARIANCE = 1e-18  # m2, so that the square root is differentiable
OFF_HULL = 1.0  # m: margin of a corner at which no edge begins, so that it is never active
LEAST_FORCE = 1.0  # N, on each foot; avoids a division by zero far outside of the constraints
# Inputs: CoM x, y; swing foot x, y, yaw; variance of the CoM's x, covariance, variance of y.
PLAN = 8


@dataclass(frozen=True)
class Footing:
    """Constraint quantities by posture (m, ...), complex while derivatives are computed.

    Attributes:
        polygon: distance of the CoM inside each edge of the hull, minus its uncertainty, (m, 8) [m].
        soles: distance of each foot's centre of pressure inside the edges of its sole, minus the uncertainty
            of its moment, (m, 8) [m].
        cells: cell loads, (m, 8) [N].
        feet: vertical force on each foot, (m, 2) [N].
        wrench: vertical force on the swing foot and its moments about x and y through the base frame's
            origin, (m, 3) [N, N m]; the other components are zero.
        boards: clearance of each sole on its board to the side, of the swing sole to the front, and between
            the soles to the side, (m, 42) [m].
    """

    polygon: np.ndarray
    soles: np.ndarray
    cells: np.ndarray
    boards: np.ndarray
    feet: np.ndarray
    wrench: np.ndarray


def footing(problem: PlanningProblem, plan: np.ndarray) -> Footing:
    """Compute the constraint quantities for the inputs of `PLAN`, (m, 8)."""
    com, swing, covariance = (plan[:, k] for k in (slice(0, 2), slice(2, 5), slice(5, 8)))
    c, s = np.cos(swing[:, 2]), np.sin(swing[:, 2])
    turn = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    swing_sole = (turn[:, None] @ problem.soles[1][..., None])[..., 0] + swing[:, None, :2]
    stance_sole = np.broadcast_to(problem.soles[0], swing_sole.shape)
    force, cop = planned_foot_loads(problem.weight, com, stance_sole.mean(axis=1), swing_sole.mean(axis=1))
    soles = []
    for foot, corners in enumerate((stance_sole, swing_sole)):
        around = corners[:, ::-1]  # counter-clockwise: `CORNERS` are clockwise seen from above
        distance, _ = _edges(cop[:, foot, None], around, np.roll(around, -1, axis=1))
        least = np.where(force[:, foot].real > LEAST_FORCE, force[:, foot], LEAST_FORCE)
        soles.append(distance - problem.margins.assurance * problem.margins.foot_moment / least[:, None])
    boards, room = _boards(problem, swing_sole)
    arm = (cop - boards) / (problem.plate.cells**2).mean(axis=0)
    tilt = 1 + arm @ problem.plate.cells.T
    cells = problem.plate.mass * problem.gravity / 4 + force[..., None] / 4 * tilt
    return Footing(
        polygon=_polygon(com, np.concatenate([stance_sole, swing_sole], axis=1), covariance, problem),
        soles=np.concatenate(soles, axis=1),
        cells=cells.reshape(len(plan), -1),
        boards=room,
        feet=force,
        wrench=np.stack([force[:, 1], force[:, 1] * cop[:, 1, 1], -force[:, 1] * cop[:, 1, 0]], axis=1),
    )


def footing_slopes(problem: PlanningProblem, plan: np.ndarray) -> tuple[Footing, Footing]:
    """Return values, and derivatives by the inputs with a last axis of 8."""
    stepped = plan[:, None] + 1j * STEP * np.eye(PLAN)
    both = footing(problem, stepped.reshape(-1, PLAN))
    values, slopes = {}, {}
    for name, array in vars(both).items():
        by_input = array.reshape(len(plan), PLAN, -1)
        values[name] = by_input[:, 0].real
        slopes[name] = by_input.imag.transpose(0, 2, 1) / STEP
    return Footing(**values), Footing(**slopes)


def _edges(
    point: np.ndarray, start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return distances of points to the left of lines, and the lines' left normals (x and y)."""
    edge = end - start
    length = np.sqrt((edge**2).sum(axis=-1))
    x, y = -edge[..., 1] / length, edge[..., 0] / length
    return x * (point - start)[..., 0] + y * (point - start)[..., 1], (x, y)


def _polygon(
    com: np.ndarray, corners: np.ndarray, covariance: np.ndarray, problem: PlanningProblem
) -> np.ndarray:
    """Return the margin of the hull's edge that begins at each corner, else `OFF_HULL`, (m, 8) [m]."""
    real = corners.real
    edge = real[:, None] - real[:, :, None]  # from i to j
    other = real[:, None, None] - real[:, :, None, None]  # from i to k
    cross = edge[..., None, 0] * other[..., 1] - edge[..., None, 1] * other[..., 0]
    length = (edge**2).sum(axis=-1)
    is_edge = (cross >= -COLLINEAR).all(axis=-1) & (length > COLLINEAR)
    last = np.where(is_edge, length, -1.0).argmax(axis=2)  # of collinear corners the farthest
    begins = is_edge.any(axis=2)
    last = np.where(begins, last, (np.arange(last.shape[1]) + 1) % last.shape[1])
    end = np.take_along_axis(corners, last[..., None], axis=1)
    distance, (x, y) = _edges(com[:, None], corners, end)
    xx, xy, yy = (covariance[:, k, None] for k in range(3))
    sd = np.sqrt(xx * x**2 + 2 * xy * x * y + yy * y**2 + LEAST_VARIANCE)
    margin = distance - problem.margins.assurance * sd
    return np.where(begins, margin, OFF_HULL)


def _boards(problem: PlanningProblem, swing_sole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of both boards, laid as by `lay_boards`, (m, 2, 2), and clearances, (m, 42).

    The reach of a rotated sole has a kink where another corner becomes the outermost, as at zero yaw, and
    optima lie at such kinks. So every pair of corners has its own clearance, which is smooth.
    """
    size, gap, kept = problem.plate.size, problem.ranges.plate_gap, problem.margins.board
    first, second = problem.soles[0].min(axis=0), problem.soles[0].max(axis=0)
    left = (_extreme(swing_sole, -1) + _extreme(swing_sole, 1)) / 2
    right = np.broadcast_to((first + second) / 2, left.shape)
    lack = size[1] + gap - (left[:, 1] - right[:, 1])
    wide = (swing_sole[:, None] - swing_sole[:, :, None])[:, *np.nonzero(~np.eye(4, dtype=bool))]
    reach = np.column_stack([np.full_like(lack, (second - first)[1]), wide[..., 1]])
    room = np.column_stack(
        [
            (size[1] - reach) / 2 - kept,  # boards side by side, or moved apart to find room
            (size[1] - lack[:, None] - reach) / 2 - kept,
            (size[0] - wide[..., 0]) / 2 - kept,
            swing_sole[..., 1] - second[1] - problem.ranges.foot_clearance,
        ]
    )
    shift = np.stack([np.zeros_like(lack), np.where(lack.real > 0, lack, 0.0) / 2], axis=1)
    return np.stack([right - shift, left + shift], axis=1), room


def _extreme(corners: np.ndarray, sign: int) -> np.ndarray:
    """Return the least (-1) or largest (1) x and y of corners (m, 4, 2), (m, 2)."""
    chosen = (sign * corners.real).argmax(axis=1)
    return np.take_along_axis(corners, chosen[:, None], axis=1)[:, 0]
