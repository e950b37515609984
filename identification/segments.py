"""Nearest points of line segments."""

from __future__ import annotations

import numpy as np


def nearest_on_segments(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest points of two segments (m, 2, 3) as fractions of their lengths (Ericson 2005)."""
    u, v, w = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    return _fractions(*(_dot(x, y) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w))))


def segment_distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Compute the distances between segments (m, 2, 3), (m,) [m].

    It takes half the time of `nearest_on_segments` and its points, and loses digits below 1e-8 m.
    """
    u, v, w = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    uu, uv, vv, uw, vw, ww = (_dot(x, y) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w), (w, w)))
    s, t = _fractions(uu, uv, vv, uw, vw)
    square = ww + s * (s * uu + 2 * uw - 2 * t * uv) + t * (t * vv - 2 * vw)
    return np.sqrt(np.maximum(square, 0.0))


def on_segments(segments: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Return the points at fractions (m,) of the lengths of segments (m, 2, 3), (m, 3)."""
    return segments[:, 0] + fractions[:, None] * (segments[:, 1] - segments[:, 0])


def _fractions(
    uu: np.ndarray, uv: np.ndarray, vv: np.ndarray, uw: np.ndarray, vw: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fractions at which w + s u - t v is shortest, (m,) each, from inner products."""
    cross = np.maximum(uu * vv - uv**2, 1e-12)
    uu, vv = np.maximum(uu, 1e-18), np.maximum(vv, 1e-18)  # a segment may be a point
    s = np.minimum(np.maximum((uv * vw - vv * uw) / cross, 0), 1)
    t = np.minimum(np.maximum((uv * s + vw) / vv, 0), 1)
    s = np.minimum(np.maximum((uv * t - uw) / uu, 0), 1)
    return s, t


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the inner products of vectors (m, 3), (m,), in a fifth of the time of `(x * y).sum(axis=1)`."""
    return x[:, 0] * y[:, 0] + x[:, 1] * y[:, 1] + x[:, 2] * y[:, 2]
