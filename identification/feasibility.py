"""Constraints on a posture: limits, support polygon, feet and boards (section IV)."""

import numpy as np
import scipy

from tulip_testbed.measurements import PlateGeometry

SHARING = 0.75  # change of the load share over that of the CoM's relative position between the feet


def place_polygon(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a foot's sole corners at a planar pose, (k, 2) [m], from those in its own frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return corners @ np.array([[c, s], [-s, c]]) + pose[:2]


def support_polygon(feet: np.ndarray) -> np.ndarray:
    """Return the convex hull of all sole corners, counter-clockwise, (k, 2) [m]."""
    points = feet.reshape(-1, 2)
    return points[scipy.spatial.ConvexHull(points).vertices]


def stability_margin(point: np.ndarray, polygon: np.ndarray) -> float:
    """Return the distance d_e from a point to a convex polygon's edges, negative outside [m] (Fig. 2)."""
    return float(edge_distances(np.atleast_2d(point), polygon).min())


def foot_clearance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the distance d_f between two convex polygons, 0 if they touch or overlap [m]."""
    first, second = support_polygon(first), support_polygon(second)
    # Separating axis: the polygons are apart only if one lies entirely outside an edge of the other.
    apart = max(
        -edge_distances(second, first).max(axis=0).min(), -edge_distances(first, second).max(axis=0).min()
    )
    if apart <= 0:
        return 0.0
    return min(_least_distance(first, second), _least_distance(second, first))


def predicted_foot_loads(com: np.ndarray, ankles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predict load share and centre of pressure of each foot, (2,) [-] and (2, 2) [m].

    The loads are statically indeterminate: they depend on the controller. Equal feet on equal ankles share
    the weight by the position of the centre of mass, (2,) [m], along the line between the points below the
    ankles, (2, 2) [m], and carry half of the moment about that line each, so that the foot with less load
    needs the longer lever.
    """
    line = ankles[1] - ankles[0]
    left = np.clip((com - ankles[0]) @ line / (line @ line), 0.02, 0.98)
    share = np.array([1 - left, left])
    lever = com - ankles[0] - left * line
    return share, ankles + lever / (2 * share[:, None])


def planned_foot_loads(
    weight: float, com: np.ndarray, stance: np.ndarray, swing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertical forces (m, 2) [N] and centres of pressure (m, 2, 2) [m] that feed-forward chooses.

    Statics determines only their mean, which is at the CoM, (m, 2) [m]. The load share depends on the
    position of the CoM between the centres of the soles, (m, 2) [m]; the remaining offset is the same for
    both centres of pressure. Complex numbers are accepted.
    """
    line = swing - stance
    part = ((com - stance) * line).sum(axis=1) / (line**2).sum(axis=1)
    share = 0.5 + SHARING * (part - 0.5)
    off = com - stance - share[:, None] * line
    return weight * np.stack([1 - share, share], axis=1), np.stack([stance + off, swing + off], axis=1)


def predicted_cell_loads(
    share: np.ndarray, cop: np.ndarray, boards: np.ndarray, plate: PlateGeometry, weight: float
) -> np.ndarray:
    """Predict the loads of the eight cells, boards included, (8,) [N]; boards are rigid, cells equal.

    Share and centre of pressure are those of `predicted_foot_loads`, the boards have zero yaw, (2, 3).
    """
    arm = (cop - boards[:, :2]) / (plate.cells**2).mean(axis=0)
    tilt = 1 + arm @ plate.cells.T
    return (plate.mass * 9.81 / 4 + weight * share[:, None] / 4 * tilt).ravel()


def boards_fit(soles: np.ndarray, boards: np.ndarray, plate: PlateGeometry) -> bool:
    inside = np.abs(soles - boards[:, None, :2]) <= plate.size / 2 + 1e-9
    return bool(inside.all())


def inner_normals(polygon: np.ndarray) -> np.ndarray:
    """Return the unit normals of a counter-clockwise polygon's edges (k, 2) that point inside, (k, 2)."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    return np.column_stack([-edges[:, 1], edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]


def edge_distances(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return distances of points (k, 2) to the lines through the edges, positive inside, (k, edges)."""
    return ((points[:, None] - polygon) * inner_normals(polygon)).sum(axis=2)


def _least_distance(points: np.ndarray, polygon: np.ndarray) -> float:
    """Return the smallest distance between points (k, 2) and the edges of a polygon."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    along = ((points[:, None] - polygon) * edges).sum(axis=2) / (edges**2).sum(axis=1)
    nearest = polygon + np.clip(along, 0, 1)[..., None] * edges
    return float(np.linalg.norm(points[:, None] - nearest, axis=2).min())
