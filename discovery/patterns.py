"""Patterns without a name in the residuals: they show whether anything is unexplained, and where."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
import scipy

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.effects.ropes import link_center
from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.identification.noise_structure import groups
from tulip_testbed.identification.residual_channels import SIZE, fields, has_direction, has_twist
from tulip_testbed.measurements.cells import CELLS, PLATES

# Channel, rows of the residuals, and their name.
PARTS = (
    ("A", slice(0, 2), "the centre of pressure"),
    ("F", slice(2, 3), "the sum of the vertical forces"),
    ("T", slice(3, 4), "the twist of the right plate"),
    ("T", slice(4, 5), "the twist of the left plate"),
    ("C", slice(5, 6), "the swing foot's height"),
    ("C", slice(6, 8), "the swing foot's tilt"),
    ("C", slice(8, 11), "the swing foot's place"),
)
DIRECTION = {  # what six-axis sensors in the feet have in place of the twist
    "the twist of the right plate": "the force's direction along x",
    "the twist of the left plate": "the force's direction along y",
}
DISTINCT = 0.05
ROUNDING = 1e-6  # of the noise: a constant of a stance leaves the swing foot's place but for rounding
AT_ONCE = 30  # patterns
SMOOTH = 12  # directions of a smooth function of many quantities
MOST_LANDMARKS = 400  # postures from whose neighbourhood such a function is made
NEAR = 0.5  # length over which it varies, of the median distance of two postures; assumed
MOST_PARTS = 60  # of an experiment, between which residuals may differ; successive placements together


@dataclass(frozen=True)
class Pattern:
    """A pattern in the residuals.

    Attributes:
        channel: A, F, T or C, or several, as "AC".
        words: "the twist of the left plate depends on right_knee".
        gain: decrease of chi-square. dof: number of its columns. p: adjusted for all patterns (Bonferroni).
        size: root mean square in the residuals of its channels, in multiples of the noise.
        reading: the joint or the cell whose reading errs by it, "" if it speaks of no single one.
    """

    channel: str
    words: str
    gain: float
    dof: int
    p: float
    size: float
    reading: str = ""


def in_channels(pattern: Pattern) -> str:
    """Name the channels of a pattern, as "channel C" or "channels A and C"."""
    *first, last = pattern.channel
    return f"channels {', '.join(first)} and {last}" if first else f"channel {last}"


def patterns(linear: LinearModel, residual: np.ndarray, fitted: np.ndarray) -> list[Pattern]:
    """Test all patterns.

    Args:
        residual: whitened and projected, (r + 1,).
        fitted: columns that are in the model already, whitened and projected, (r + 1, s).

    Returns:
        the least probable first.
    """
    basis = np.linalg.qr(fitted)[0] if fitted.shape[1] else fitted
    out = []
    for channel, words, reading, whole in _whitened(linear):
        columns = linear.project(whole)
        columns = columns - basis @ (basis.T @ columns)
        left, size, _ = np.linalg.svd(columns, full_matrices=False)
        # Directions that the model explains almost entirely are no pattern of their own.
        length = float(np.sqrt(max(np.linalg.eigvalsh(whole.T @ whole)[-1], 0.0)))
        left = left[:, size > max(DISTINCT * length, ROUNDING)]
        gain = float(((left.T @ residual) ** 2).sum())
        rows = max(int(whole.any(axis=1).sum()), 1)
        size_in_noise = float(np.sqrt(gain / rows))
        out.append(Pattern(channel, words, gain, left.shape[1], 0.0, size_in_noise, reading))
    count = len(out)
    found = [replace(p, p=min(1.0, count * float(chi2_sf(p.gain, p.dof)))) for p in out if p.dof]
    return sorted(found, key=lambda p: (p.p, -p.gain))


def _whitened(linear: LinearModel) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield channel, words, reading and whitened columns (r, k) of all patterns.

    They are computed a few at a time for memory's sake.
    """
    tried = chain(_of_residuals(linear), _of_loose_parts(linear), _of_readings(linear))
    while some := list(islice(tried, AT_ONCE)):
        whitened = linear.whitening.each([one[-1] for one in some])
        yield from ((*one[:-1], whole) for one, whole in zip(some, whitened, strict=True))


def _of_residuals(linear: LinearModel) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield each part of the residuals as a function of each quantity: channel, words, "", (m, 11, k)."""
    observed = linear.observed
    there = np.zeros(len(observed) * SIZE, bool)
    there[linear.whitening.rows] = True
    quantities = _functions(linear)
    for channel, part, name in PARTS:
        what = DIRECTION.get(name, name) if has_direction(observed) else name
        if not there.reshape(-1, SIZE)[:, part].any():
            continue
        width = part.stop - part.start
        for how, functions in quantities:
            raw = np.zeros((len(observed), SIZE, functions.shape[1] * width))
            for k in range(width):
                raw[:, part.start + k, k::width] = functions
            yield channel, f"{what} {how}", "", raw


def _of_loose_parts(linear: LinearModel) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield a centre of mass that moves in the torso as it leans: channel, words, "", (m, 11, k).

    A part slides, in proportion to the lean, or falls to one side. Along axes that do not turn with the torso
    it is lost.
    """
    observed = linear.smoothed
    torso = observed.tree.links[0]
    axes = observed.geometry.frames[0][:, observed.tree.frame(torso)]
    lean = axes[:, 2, :2] - np.median(axes[:, 2, :2], axis=0)
    shift = np.concatenate([lean, np.sign(lean)], axis=1)
    raw = np.zeros((len(observed), SIZE, 2 * shift.shape[1]))
    raw[:, PARTS[0][1]] = (axes[:, :2, :2, None] * shift[:, None, None]).reshape(len(observed), 2, -1)
    yield "A", f"the centre of mass of {torso} moves as it leans", "", raw


def _of_readings(linear: LinearModel) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield each reading's error as such a function, in all channels: channel, words, reading, (m, 11, k)."""
    observed, slope, at = linear.smoothed, linear.whitening.sensitivity, fields(linear.observed)
    time = _powers(observed.time_fraction)
    for k, joint in enumerate(observed.tree.joints):
        if joint in observed.measurements.constant_joints:
            continue
        angle, torque = observed.joint_angles[:, k], observed.torques[:, k]
        errors = {
            "the square and cube of its angle": np.column_stack(
                [_powers(angle)[:, 1], _powers(angle, 3)[:, 2]]
            ),
            "its torque": np.column_stack([torque - torque.mean(), np.sign(torque)]),
            "time": time,
        }
        for how, functions in errors.items():
            column = slope[:, :, at["angles"].start + k, None]
            yield "AC", f"the reading of {joint} errs with {how}", joint, column * functions[:, None]
    for k, cell in enumerate(CELLS if has_twist(observed) else ()):
        for how, functions in {"its load": _powers(observed.cell_forces[:, k]), "time": time}.items():
            column = slope[:, :, at["cells"].start + k, None]
            yield "AFT", f"the cell {cell} errs with {how}", cell, column * functions[:, None]
    load, before = observed.cell_forces, np.zeros_like(observed.cell_forces)
    order = np.argsort(observed.time_fraction)
    before[order[1:]] = load[order[:-1]]
    together = {
        "their load before": before,
        "the square of their load": load**2,
        "their load and time": load * (observed.time_fraction - 0.5)[:, None],
    }
    plates = at["plates"].start
    for k, plate in enumerate(PLATES if not observed.in_feet else ()):
        by_place = slope[:, :, plates + 3 * k : plates + 3 * k + 3, None]
        recorded = observed.plate_poses[:, k]
        recorded = np.column_stack(
            [_powers(one, 1) for one in recorded.T if np.ptp(one) > 0] or [time[:, :0]]
        )
        errors = {"drifts in time": time, "errs with its record": recorded}
        for how, functions in errors.items():
            columns = (by_place * functions[:, None, None]).reshape(*slope.shape[:2], -1)
            yield "AC", f"the place of the {plate} plate {how}", "", columns
    contacts = "cells" if has_twist(observed) else "wrench sensors"
    for how, errors in together.items():
        yield "AFT", f"all {contacts} err with {how}", "", slope[:, :, at["cells"]] @ errors[..., None]


def _powers(values: np.ndarray, most: int = 2) -> np.ndarray:
    """Compute powers of standardised values less their means, (m, most)."""
    spread = float(values.std())
    z = (values - values.mean()) / (spread if spread > 0 else 1.0)
    out = z[:, None] ** np.arange(1, most + 1)
    return out - out.mean(axis=0)


def _functions(linear: LinearModel) -> list[tuple[str, np.ndarray]]:
    """List the quantities on which residuals might depend, with their columns, (m, k).

    They are taken from smoothed readings, because the noise of the load share is that of the centre of
    pressure.
    """
    observed = linear.smoothed
    out = [
        (f"depends on {joint}", _powers(observed.joint_angles[:, k]))
        for k, joint in enumerate(observed.tree.joints)
        if joint not in observed.measurements.constant_joints  # it varies by rounding alone
    ]
    out.append(("drifts in time", _powers(observed.time_fraction)))
    number = groups(observed.measurements.placement).number
    part = number * min(MOST_PARTS, number.max() + 1) // (number.max() + 1)
    out.append(("differs between placements", (part[:, None] == np.arange(part.max() + 1)).astype(float)))
    out.append(("is not zero", np.ones((len(observed), 1))))
    down = observed.foot_loads[0]
    share = down[:, 0] / down.sum(axis=1)
    out.append(("depends on the load share", _powers(share)))
    # A force from the surroundings, such as a cable's, is a function of where the body is. No single angle
    # tells that, and among smooth functions of all angles it is lost.
    torso = observed.tree.links[0]
    place = link_center(observed, torso)[:, :2]
    spread = place.std(axis=0)
    x, y = ((place - place.mean(axis=0)) / np.where(spread > 0, spread, 1.0)).T
    parabolas = np.column_stack([x, y, x * x, x * y, y * y])
    out.append((f"depends on the place of {torso}", parabolas - parabolas.mean(axis=0)))
    sideways = observed.loads.internal_wrench
    if sideways.any():
        out.append(("depends on the side forces", np.column_stack([_powers(force) for force in sideways.T])))
    smooth = {
        "varies smoothly in time": observed.time_fraction[:, None],
        "varies smoothly with the posture": observed.joint_angles,
        "varies smoothly with the readings of the contacts": observed.cell_forces,
    }
    return out + [(how, _smooth(values)) for how, values in smooth.items()]


def _smooth(values: np.ndarray) -> np.ndarray:
    """Return the main directions of smooth functions of some quantities, (m, n) -> (m, k).

    They are those of a Gaussian process with a squared exponential covariance: postures that are alike, or
    follow one another, have alike values.
    """
    spread = values.std(axis=0)
    scaled = (values - values.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    some = scaled[np.linspace(0, len(scaled) - 1, min(len(scaled), MOST_LANDMARKS)).astype(int)]
    square = scipy.spatial.distance.cdist(scaled, some, "sqeuclidean")
    length = NEAR**2 * np.median(square[square > 0]) if square.any() else 1.0
    kernel = np.exp(-square / (2 * length))
    kernel -= kernel.mean(axis=0)
    left, sizes, _ = np.linalg.svd(kernel, full_matrices=False)
    return (left * sizes)[:, : min(SMOOTH, len(values) // 4)]
