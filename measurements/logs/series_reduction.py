"""Reduce a series of samples to rows, each with the mean motion and readings of a short window."""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from tulip_testbed.measurements.data import Measurements, feet_in_contact

WINDOW = 0.5  # s, of a row: with encoders of 0.088 deg shorter ones have noisy accelerations
OVERLAP = 2  # windows at a time: the ends of a window have little weight
DEGREE = 3  # of polynomials for which the weights are exact
MOMENTS = np.array([[1, 0, 1 / 7, 0], [0, 1, 0, 3 / 7], [0, 0, 2, 0]])  # means of 1, u, u^2, u^3; of u', u''
LEAST_SAMPLES = 8  # in a window: twice the polynomial's coefficients
GAP = 0.25  # of a window, in which no sample is missed
FILTERED = ("command", "motor", "cell_forces", "plate_poses", "wrenches")
LIFTED = 0.05  # of the weight, below which a foot is in the air
MOVING, MISSED, NO_LOAD = (
    "in which a foot lands or lifts",
    "with too few samples or a gap between them",
    "in which a foot that stands carries less than 5 % of the weight",
)


class Reduced(NamedTuple):
    """Rows of a series, and how many windows gave none, by cause."""

    measurements: Measurements
    dropped: dict[str, int]


class _Fit(NamedTuple):
    """Weights of the samples of a window for the mean value, rate and acceleration in it, (3, n)."""

    weights: np.ndarray
    residual: np.ndarray  # (n, n): maps samples to their deviations from a polynomial


def supports(samples: Measurements, weight: float) -> np.ndarray:
    """Return on which feet the robot stands by its contact sensors, (n,); "" on none.

    Forces count by their size, since the frame of a wrench may be unknown.

    Args:
        weight: of the robot [N].
    """
    right, left = (_loads(samples) >= LIFTED * weight).T
    return np.select([right & left, right, left], ["double", "right", "left"], "")


def reduced(
    samples: Measurements, weight: float, window: float = WINDOW, step: float = WINDOW / OVERLAP
) -> Reduced:
    """Average angles, rates, accelerations and contact readings over short windows, all by the same weights.

    The mean rate and the mean acceleration follow from the angles alone, without a derivative, since the
    weights fall to zero at both ends of a window (modulating functions). The equation of motion holds between
    such means, whatever the frequency of the motion; with the values of a fitted polynomial it would not. The
    weights of the acceleration are those of Savitzky and Golay for a cubic polynomial, here with any clock.

    Args:
        samples: one row a sample, in the order of their times. weight: of the robot [N].
        window, step: length of a window, and from one to the next [s].

    Returns:
        the rows, none if every window was dropped. Every row is a posture; a placement begins where the
        support changes; s.d. are those of the samples about a cubic polynomial.
    """
    time = samples.time
    starts = np.arange(time[0], time[-1] - window + 1e-9, step)
    first, last = np.searchsorted(time, starts - 1e-9), np.searchsorted(time, starts + window - 1e-9)
    carried, loaded = feet_in_contact(samples.support), _loads(samples) >= LIFTED * weight
    dropped, rows = Counter[str](), []
    for start, a, b in zip(starts, first, last, strict=True):
        inside = slice(a, b)
        edges = np.concatenate([[start], time[inside], [start + window]])
        if b - a < LEAST_SAMPLES or np.diff(edges).max() > GAP * window:
            dropped[MISSED] += 1
        elif (samples.support[inside] != samples.support[a]).any():
            dropped[MOVING] += 1
        elif not carried[a].any() or not loaded[inside][:, carried[a]].all():
            dropped[NO_LOAD] += 1
        else:
            rows.append((start, a, b))
    return Reduced(_rows(samples, rows, window), dict(dropped))


def _rows(samples: Measurements, rows: list[tuple[float, int, int]], window: float) -> Measurements:
    fits = [_fit(samples.time[a:b] - start - window / 2, window) for start, a, b in rows]

    def each(name: str, order: int = 0) -> np.ndarray | None:
        """Return value, rate or acceleration in every window."""
        if (values := getattr(samples, name)) is None:
            return None
        found = [
            np.tensordot(fit.weights[order], values[a:b], 1)
            for fit, (_, a, b) in zip(fits, rows, strict=True)
        ]
        return np.reshape(found, (len(rows), *values.shape[1:]))

    def spread(name: str) -> np.ndarray | None:
        if (values := getattr(samples, name)) is None:
            return None
        off = [np.tensordot(fit.residual, values[a:b], 1) for fit, (_, a, b) in zip(fits, rows, strict=True)]
        found = [np.sqrt((one**2).sum(axis=0) / (len(one) - DEGREE - 1)) for one in off]
        return np.reshape(found, (len(rows), *values.shape[1:]))

    chosen = samples.take(np.array([a for _, a, _ in rows], int))
    angles = each("joint_angles")
    assert angles is not None
    constant = [samples.joints.index(joint) for joint in samples.constant_joints]
    angles[:, constant] = chosen.joint_angles[:, constant]  # to the last digit
    new = chosen.support[1:] != chosen.support[:-1]
    readings: dict[str, Any] = {name: each(name) for name in FILTERED}
    readings |= {f"{name}_sd": spread(name) for name in ("joint_angles", "cell_forces", "wrenches")}
    return dataclasses.replace(
        chosen,
        posture=np.arange(1, len(rows) + 1),
        placement=1 + np.cumsum(np.append(np.zeros(min(len(rows), 1), bool), new)),
        time=np.array([start for start, _, _ in rows]),
        window=np.full(len(rows), window),
        samples=np.array([b - a for _, a, b in rows], float),
        joint_angles=angles,
        joint_rates=each("joint_angles", 1),
        joint_accelerations=each("joint_angles", 2),
        **readings,
    )


def _fit(time: np.ndarray, window: float) -> _Fit:
    """Return the weights of samples at times from the middle of a window, (n,) [s].

    With u = 2 time / window the weight is k(u) = (1 - u^2)^2. By parts, the mean rate is that of -k' times
    the value, the mean acceleration that of k'' times the value. The sums over samples are corrected so that
    all three are exact for polynomials.
    """
    half = window / 2
    u = time / half
    powers = np.vander(u, DEGREE + 1, increasing=True)
    raw = np.gradient(u) * np.array([(1 - u**2) ** 2, 4 * u * (1 - u**2), 12 * u**2 - 4]) / (16 / 15)
    solve = np.linalg.pinv(powers)
    weights = (raw + (MOMENTS - raw @ powers) @ solve) / half ** np.arange(3)[:, None]
    return _Fit(weights, np.eye(len(time)) - powers @ solve)


def _loads(m: Measurements) -> np.ndarray:
    """Return the size of the force on each foot, 0 where none was recorded, (n, 2) [N]."""
    if m.contacts is None:
        return m.cell_forces.reshape(-1, 2, 4).sum(axis=2)
    assert m.wrenches is not None
    forces = [k for k, channel in enumerate(m.contacts.channels) if channel.startswith("f")]
    return np.nan_to_num(np.linalg.norm(m.wrenches[..., forces], axis=2))
