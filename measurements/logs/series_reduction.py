"""Reduce a series of samples to rows, each with the mean motion and readings of a short window."""

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements.data import Measurements, feet_in_contact
from tulip_testbed.measurements.trajectory import runs

WINDOW = 0.5  # s, of a row
# By encoders of 0.088 deg at 100 Hz the acceleration of a centre of mass at 0.6 m has noise of 0.4 mm of the
# centre of pressure in such windows, as much as there is of it, and of 0.1 mm in windows twice as long.
COARSE = np.radians(0.05)  # resolution of encoders from which windows are twice as long; assumed
# Of a motion. Its noise lasts for seconds, so that more rows say little more: of 12 min, 1,480 rows gave
# 0.9 of the standard errors of 600, in three times the time. A long motion has rows every two seconds.
ENOUGH_ROWS, LONGEST_STEP, MOST_ROWS = 600, 2.0, 4000
OVERLAP = 2  # windows at a time: the ends of a window have little weight
BLOCK = 4.0  # s, of a placement: slow errors are common to it, and predictions leave whole blocks out
DEGREE = 3  # of polynomials for which the weights are exact
# Means of 1, u, u^2 and u^3, and of their first to third derivatives.
MOMENTS = np.array([[1, 0, 1 / 7, 0], [0, 1, 0, 3 / 7], [0, 0, 2, 0], [0, 0, 0, 6]])
LEAST_SAMPLES = 8  # in a window: twice the polynomial's coefficients
GAP = 0.25  # of a window, in which no sample is missed
FILTERED = ("joint_angles", "command", "motor", "cell_forces", "plate_poses", "wrenches")
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


class _Window(NamedTuple):
    """The samples of a row.

    Attributes:
        start: [s]. inside: the samples' rows.
        weights: of the n samples for mean value, rate, acceleration and jerk, (4, n).
        powers, solve: of a polynomial's coefficients, samples at them, (n, 4), and their inverse, (4, n).
    """

    start: float
    inside: slice
    weights: np.ndarray
    powers: np.ndarray
    solve: np.ndarray


def usual_window(encoder_resolution: float | None) -> float:
    """Return the length of a window that suits the encoders [s]."""
    return WINDOW if encoder_resolution is None or encoder_resolution < COARSE else 2 * WINDOW


def supports(samples: Measurements, weight: float) -> np.ndarray:
    """Return on which feet the robot stands by its contact sensors, (n,); "" on none.

    Forces count by their size, since the frame of a wrench may be unknown.

    Args:
        weight: of the robot [N].
    """
    right, left = (loads(samples) >= LIFTED * weight).T
    return np.select([right & left, right, left], ["double", "right", "left"], "")


def reduced(
    samples: Measurements, weight: float, window: float = WINDOW, step: float = WINDOW / OVERLAP
) -> Reduced:
    """Average angles, rates, accelerations and contact readings over short windows, all by the same weights.

    The mean rate and the mean acceleration follow from the angles alone, without a derivative, since the
    weights fall to zero at both ends of a window (modulating functions). The equation of motion holds between
    such means, at any frequency of the motion; with the values of a fitted polynomial it would not. The
    weights of the acceleration are those of Savitzky and Golay for a cubic polynomial, here with any clock.

    Args:
        samples: one row a sample, in the order of their times within a segment, whose number is `posture`.
            No window reaches beyond a segment's end.
        weight: of the robot [N].
        window, step: length of a window, and from one to the next [s].

    Returns:
        the rows, none if every window was dropped. Every row is a posture; s.d. are those of the samples
        about a cubic polynomial. Placements are those of the samples if plates are recorded; without
        plates, a placement begins with a segment, where the support changes, and after four seconds.
    """
    time = samples.time
    found = []  # start, first and last sample
    for rows in runs(samples.posture):
        there = time[rows]
        # Of a clock that jumps, only those that begin near a sample: others would be billions.
        jumps = (there[-1] - there[0]) / step > len(there)
        near = np.floor((there - there[0]) / step) if jumps else np.arange(len(there))
        starts = there[0] + step * np.unique(near)
        starts = starts[starts <= there[-1] - window + 1e-9]
        ends = [rows.start + np.searchsorted(there, starts + shift - 1e-9) for shift in (0.0, window)]
        found += list(zip(starts.tolist(), *(end.tolist() for end in ends), strict=True))
    return _reduced(samples, weight, window, found)


def reduced_window(samples: Measurements, weight: float, start: float, window: float) -> Reduced:
    """Reduce the samples of one segment from a time on [s], as `reduced` does, to one row or none."""
    a, b = np.searchsorted(samples.time, [start - 1e-9, start + window - 1e-9]).tolist()
    return _reduced(samples, weight, window, [(start, a, b)])


def _reduced(
    samples: Measurements, weight: float, window: float, found: list[tuple[float, int, int]]
) -> Reduced:
    """Reduce windows, each with its start and its first and last sample."""
    time = samples.time
    carried, loaded = feet_in_contact(samples.support), loads(samples) >= LIFTED * weight
    dropped, windows = Counter[str](), []
    for start, a, b in found:
        inside = slice(a, b)
        edges = np.concatenate([[start], time[inside], [start + window]])
        if b - a < LEAST_SAMPLES or np.diff(edges).max() > GAP * window:
            dropped[MISSED] += 1
        elif (samples.support[inside] != samples.support[a]).any():
            dropped[MOVING] += 1
        elif not loaded[inside][:, carried[a]].all():
            dropped[NO_LOAD] += 1
        elif not samples.support[a]:
            dropped[MOVING] += 1
        else:
            windows.append(_Window(start, inside, *_weights(time[inside] - start - window / 2, window)))
    return Reduced(_rows(samples, windows, window), dict(dropped))


def reduced_motion(
    samples: Measurements, window: float | None = None, source: str = "motion"
) -> Measurements:
    """Reduce the samples of a motion to rows, see `reduced`.

    Args:
        window: None: `usual_window` of the encoders [s]. source: of the samples, for messages.
    """
    window = window or usual_window(samples.sensors.encoder_resolution)
    steps = [np.minimum(np.diff(samples.time[rows]), window) for rows in runs(samples.posture)]
    seconds = float(np.concatenate(steps).sum())
    step = max(window, min(seconds / ENOUGH_ROWS, LONGEST_STEP), seconds / MOST_ROWS)
    rows, dropped = reduced(samples, _weight(samples), window, step)
    if not len(rows):
        causes = "; ".join(f"{count} {cause}" for cause, count in dropped.items())
        raise InputError(
            f"{source}: found no window of {window:g} s that gives a row ({causes or 'segments are shorter'})"
        )
    return rows


def unloaded(samples: Measurements) -> np.ndarray:
    """Return in which samples a foot that stands carries hardly anything, (n,)."""
    lost = feet_in_contact(samples.support) & (loads(samples) < LIFTED * _weight(samples))
    return np.any(lost, axis=1)


def _weight(samples: Measurements) -> float:
    weighed = samples.weighed_mass
    return weighed[0] * samples.gravity if weighed else float(np.median(loads(samples).sum(axis=1)))


def _rows(samples: Measurements, windows: list[_Window], window: float) -> Measurements:
    def each(name: str, of: Callable[[_Window, np.ndarray], np.ndarray]) -> np.ndarray | None:
        """Return a function of the samples, (n, k), of every window."""
        if (values := getattr(samples, name)) is None:
            return None
        flat = values.reshape(len(samples), -1)
        return np.reshape([of(one, flat[one.inside]) for one in windows], (len(windows), *values.shape[1:]))

    def mean_of(derivative: int) -> Callable[[_Window, np.ndarray], np.ndarray]:
        return lambda one, values: one.weights[derivative] @ values

    mean, rate, acceleration, jerk = map(mean_of, range(4))

    def spread(one: _Window, values: np.ndarray) -> np.ndarray:
        off = values - one.powers @ (one.solve @ values)
        return np.linalg.norm(off, axis=0) / np.sqrt(len(values) - DEGREE - 1)

    first = samples.take(np.array([one.inside.start for one in windows], int))
    readings: dict[str, Any] = {name: each(name, mean) for name in FILTERED}
    readings |= {f"{name}_sd": each(name, spread) for name in ("joint_angles", "cell_forces", "wrenches")}
    constant = [samples.joints.index(joint) for joint in samples.constant_joints]
    readings["joint_angles"][:, constant] = first.joint_angles[:, constant]  # to the last digit
    time = np.array([one.start for one in windows])
    changed = (first.support[1:] != first.support[:-1]) | (first.posture[1:] != first.posture[:-1])
    blocks = _blocks(np.append(False, changed)[: len(windows)], time)
    return dataclasses.replace(
        first,
        posture=np.arange(1, len(windows) + 1),
        placement=first.placement if samples.on_plates else blocks,
        time=time,
        window=np.full(len(windows), window),
        samples=np.array([one.weights.shape[1] for one in windows], float),
        joint_rates=each("joint_angles", rate),
        joint_accelerations=each("joint_angles", acceleration),
        joint_jerks=each("joint_angles", jerk),
        cell_rates=each("cell_forces", rate),
        cell_accelerations=each("cell_forces", acceleration),
        wrench_rates=each("wrenches", rate),
        wrench_accelerations=each("wrenches", acceleration),
        wrench_jerks=each("wrenches", jerk),
        **readings,
    )


def _blocks(changed: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Number the blocks of time, which begin where the support changed and after `BLOCK` seconds, (m,)."""
    number, start, out = 0, -np.inf, []
    for new, now in zip(changed.tolist(), time.tolist(), strict=True):
        if new or now - start >= BLOCK:
            number, start = number + 1, now
        out.append(number)
    return np.array(out, int)


def _weights(time: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weights, powers and their inverse, see `_Window`, of samples.

    Args:
        time: from the middle of the window, (n,) [s].

    With u = 2 time / window the weight is k(u) = (1 - u^2)^2. By parts, the mean rate is that of -k' times
    the value, the mean acceleration that of k'' times the value. The jerk's k is (1 - u^2)^3, whose k'' falls
    to zero too. The sums over samples are corrected so that all are exact for polynomials.
    """
    half = window / 2
    u = time / half
    powers = np.vander(u, DEGREE + 1, increasing=True)
    kernels = [(1 - u**2) ** 2, 4 * u * (1 - u**2), 12 * u**2 - 4, (120 * u**3 - 72 * u) * 7 / 6]
    raw = np.gradient(u) * np.array(kernels) / (16 / 15)
    solve = np.linalg.pinv(powers)
    weights = (raw + (MOMENTS - raw @ powers) @ solve) / half ** np.arange(4)[:, None]
    return weights, powers, solve


def loads(m: Measurements) -> np.ndarray:
    """Return the size of the force on each foot, 0 where none was recorded, (n, 2) [N]."""
    if m.contacts is None:
        return m.cell_forces.reshape(-1, 2, 4).sum(axis=2)
    assert m.wrenches is not None
    forces = [k for k, channel in enumerate(m.contacts.channels) if channel.startswith("f")]
    return np.nan_to_num(np.linalg.norm(m.wrenches[..., forces], axis=2))
