"""Convex polygons: what lies inside of a margin, the nearest point of the edges."""

from __future__ import annotations

import numpy as np
from scipy.spatial import HalfspaceIntersection, QhullError

from tulip_testbed.identification.feasibility import support_polygon


def inset(polygon: np.ndarray, distance: float) -> np.ndarray | None:
    """Return the convex polygon of points at least `distance` [m] inside its edges; None: there are none."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    outward = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
    offset = distance - (outward * polygon).sum(axis=1)
    middle = polygon.mean(axis=0)
    if (outward @ middle + offset >= 0).any():
        return None
    try:
        return support_polygon(
            HalfspaceIntersection(np.column_stack([outward, offset]), middle).intersections
        )
    except QhullError:
        return None


def nearest_on(point: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return the point of a polygon's edges that is nearest, (2,) [m]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    along = ((point - polygon) * edges).sum(axis=1) / (edges**2).sum(axis=1)
    feet = polygon + np.clip(along, 0, 1)[:, None] * edges
    return feet[np.argmin(np.linalg.norm(feet - point, axis=1))]
