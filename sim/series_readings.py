"""Readings of a robot that moves, sample by sample: slow errors, noise, rounding, lag and filter."""

from __future__ import annotations

import numpy as np
import scipy

from tulip_testbed.sim.sensors import Sensors, corrupted


def sample_series(
    truth: np.ndarray,
    repeatability: float,
    noise: float,
    resolution: float,
    samples: int,
    rng: np.random.Generator,
    interval: float,
    changing_time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw one reading of every sample of a series, with errors that change slowly; NaN for the s.d.

    Args:
        truth: quantities at instants `interval` [s] apart, (n, ...). samples: not used.
        changing_time: correlation time of "repeatability" [s].
    """
    kept = np.exp(-interval / changing_time)
    steps = rng.standard_normal(truth.shape)
    steps[1:] *= np.sqrt(1 - kept**2)
    slow = np.asarray(scipy.signal.lfilter([1.0], [1.0, -kept], steps, axis=0))
    return corrupted(truth + repeatability * slow, noise, resolution, rng), np.full(truth.shape, np.nan)


def delayed(sensors: Sensors, series: np.ndarray, interval: float) -> np.ndarray:
    """Return what the contact sensors pass on of a series, (n, ...): late, and through their filter.

    Both are exact for a signal that is straight between its samples.
    """
    if not series.size:  # no such sensors
        return series
    time = interval * np.arange(len(series))
    flat = series.reshape(len(series), -1)
    late = np.column_stack([np.interp(time - sensors.contact_lag, time, column) for column in flat.T])
    if sensors.contact_filter > 0:
        ratio = sensors.contact_filter / interval
        kept = np.exp(-1 / ratio)
        new, old = 1 - ratio * (1 - kept), ratio * (1 - kept) - kept
        at_rest = (old + kept) * late[:1]
        late, _ = scipy.signal.lfilter([new, old], [1.0, -kept], late, axis=0, zi=at_rest)
    return late.reshape(series.shape)
