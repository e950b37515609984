"""Noise of an experiment's residuals, and coordinates in which it is white."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs, helmert
from scipy.sparse import csr_array
from scipy.special import ndtri

from tulip_testbed.base.result import Array
from tulip_testbed.identification.loop_closure import encoder_sd_by_closure
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ANCHORED,
    ROWS,
    SIZE,
    TWIST,
    fields,
    has_twist,
    more_as_read,
    residuals_in_use,
    sensitivity,
)
from tulip_testbed.identification.variance_components import MARK_RATIO
from tulip_testbed.measurements.data import feet_in_contact

# Residuals of the simulated laboratory with exact sensors in full dynamics, due to compliant contacts. They
# take the place of noise where there is none.
FLOOR = np.array([1.5e-5] * 2 + [2e-3] + [2e-3] * 2 + [5e-6] + [1e-5] * 2 + [5e-6] * 2 + [1e-5])
FINEST_ENCODER, FINEST_CELL = 1e-8, 1e-5  # rad, N: finer sensors are exact beside these residuals
ASSUMED_ENCODER = 5e-4  # rad
ASSUMED_CELL = 1.0  # N
MANY = 200  # residuals of a placement, whose contrasts are multiplied as the sparse matrices that they are
OUTLYING = 4.0  # s.d. beyond which a twist is an outlier
# Components of a plate's cell forces orthogonal to the twist: the load and its position.
OTHERS = np.array([[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
SLOW = (1e-3, 1e-3, 0.0)  # m, m, rad: slow errors of a moving record, common to a block of time; assumed
FREE_PLATE = (0.01, 0.01, 0.03)  # m, m, rad: assumed s.d. of a recorded pose without a data sheet

# For one placement SciPy's function of this name takes six times as long, because of its checks.
solve_triangular = get_lapack_funcs("trtrs")


@dataclass(frozen=True)
class Noise:
    """Standard deviations of an experiment's readings.

    Attributes:
        encoder: s.d. of a joint angle [rad].
        cell: s.d. of a cell force [N].
        plates: s.d. of both recorded plate poses, (6,) [m, m, rad].
        assumed: names of the figures that no data sheet stated.
    """

    encoder: float
    cell: float
    plates: Array
    assumed: tuple[str, ...]


def noise_of(observed: Observation) -> Noise:
    """Return the noise by the data sheets; estimate or assume figures that they do not state.

    The sheet states the s.d. of the left plate's pose only; the foot on the right plate stands on a mark.
    """
    sheet = observed.measurements.sensors
    assumed = []
    encoder, cell, left = sheet.encoder_sd, sheet.cell_sd, sheet.placement_sd
    if encoder is None:
        encoder = encoder_by_closure(observed) or ASSUMED_ENCODER
        assumed.append("encoders (from the closure of the legs)")
    if not has_twist(observed):  # their readings are scaled to one of noise
        cell = observed.contacts.sd
        if observed.measurements.contacts is not None and observed.measurements.contacts.covariance is None:
            assumed.append("wrench sensors (1 N, 0.05 Nm)")
    elif cell is None:
        cell = cell_by_twist(observed) or ASSUMED_CELL
        assumed.append("cells (from the plates' twist)")
    if observed.in_feet:  # where a sensor is in its foot is no matter of placements, blocks of time here
        left = SLOW if observed.moves else (0.0, 0.0, 0.0)
    elif left is None:
        left = FREE_PLATE
        assumed.append("placement (taken as unknown)")
    plates = np.concatenate([MARK_RATIO * np.array(left), left])
    return Noise(encoder, cell, plates, tuple(assumed))


def with_cell_noise(observed: Observation) -> Observation:
    """Return the observation with the noise of its cells, estimated if no data sheet states it."""
    return observed if observed.cell_sd else observed.changed(cell_sd=noise_of(observed).cell)


def encoder_by_closure(observed: Observation) -> float | None:
    """Estimate the encoders' s.d. by the closed legs [rad]; None if too few postures are on both feet."""
    m, base = observed.measurements, observed.nominal.parameters.base
    both = m.support == "double"
    return encoder_sd_by_closure(
        observed.tree, base, observed.nominal.swing_frame, observed.joint_angles[both], m.placement[both]
    )


def cell_by_twist(observed: Observation) -> float | None:
    """Estimate the cells' s.d. by the twist of rigid plates [N]; None if there are too few postures, or none.

    Zero, gain and drift of a cell are no noise: parts that vary with load, position and time are removed.
    """
    if not has_twist(observed):
        return None
    m, left, freedom = len(observed), [], 0
    for side in (0, 1):
        rows = observed.on_four_cells[:, side] & feet_in_contact(observed.measurements.support)[:, side]
        forces = observed.cell_forces.reshape(m, 2, 4)[rows, side]
        known = np.column_stack([np.ones(len(forces)), observed.time_fraction[rows], forces @ OTHERS.T])
        twist = forces @ TWIST
        left.append(twist - known @ np.linalg.lstsq(known, twist, rcond=None)[0])
        freedom += max(len(twist) - known.shape[1], 0)
    every = np.concatenate(left)
    if not freedom:
        return None
    most = OUTLYING * np.median(np.abs(every - np.median(every))) / ndtri(0.75)
    inside = every[np.abs(every) <= most]
    return float(np.sqrt((inside**2).mean() * len(every) / freedom) / 2)


@dataclass(frozen=True)
class Whitening:
    """Coordinates in which the residuals' noise is independent, of unit variance.

    The swing foot's x, y and yaw are known up to a constant of each stance: these coordinates hold their
    contrasts between the postures of a stance (Helmert's), which are free of it.

    Attributes:
        sensitivity: derivative of the residuals by the fields of `packed`, (m, 11, k).
        reach: derivative by the readings (angles, cells, plates), (m, 11, n_joints + 14); it differs from
            `sensitivity` if removed effects depend on noisy readings.
        own: part of each posture's covariance that it does not share, (m, 11, 11).
        levers: one s.d. in the residuals of what a placement's postures share: plate coordinates, and then
            forces that no reading shows, (m, 11, 6 + j).
        used: residuals that are used, (m, 11) bool.
        placement, stance: number of each posture's, (m,).
    """

    sensitivity: np.ndarray
    reach: np.ndarray
    own: np.ndarray
    levers: np.ndarray
    used: np.ndarray
    placement: np.ndarray
    stance: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """Return the residual (11 a posture) that each coordinate mainly holds, placement by placement."""
        return self._factored[0]

    @property
    def blocks(self) -> list[tuple[slice, np.ndarray, np.ndarray]]:
        """Return of every placement its coordinates, the residuals' numbers and the factor between them."""
        return self._factored[1]

    @property
    def log_volume(self) -> float:
        """Return the logarithm of the determinant of the covariance, but for a constant."""
        return self._factored[2]

    @cached_property
    def _factored(self) -> tuple[np.ndarray, list[tuple[slice, np.ndarray, np.ndarray]], float]:
        rows, blocks, at_row, volume = [], [], 0, 0.0
        known: dict[tuple[bytes, bytes], np.ndarray] = {}  # most placements are alike
        for number in np.unique(self.placement):
            inside = np.flatnonzero(self.placement == number)
            used, stance = self.used[inside], self.stance[inside]
            numbers = (inside[:, None] * SIZE + np.arange(SIZE)).ravel()
            shared = self.levers[inside].reshape(-1, self.levers.shape[2])
            block, each = shared @ shared.T, np.arange(len(inside))
            block.reshape(len(inside), SIZE, len(inside), SIZE)[each, :, each] += self.own[inside]
            keep = used.ravel()
            alike = (stance - stance[0]).tobytes(), used[:, ANCHORED].tobytes()
            if alike not in known:
                known[alike] = without_constants(stance, used)
            contrast, of = contrasts(used, known[alike])
            contrast = contrast[:, keep]
            quick = csr_array(contrast) if len(contrast) > MANY else contrast
            lower = np.linalg.cholesky(quick @ block[keep][:, keep] @ quick.T)
            factor = contrast  # of a placement without a residual in these channels
            if len(lower):
                factor, _ = solve_triangular(lower, contrast, lower=1)
            volume += 2 * float(np.log(np.diag(lower)).sum())
            blocks.append((slice(at_row, at_row + len(lower)), numbers[keep], factor))
            rows.append(numbers[of])
            at_row += len(lower)
        return np.concatenate(rows), blocks, volume

    def __call__(self, residuals: np.ndarray) -> np.ndarray:
        """Whiten residuals (m, 11) or columns (m, 11, k): (r,) or (r, k)."""
        flat = residuals.reshape(residuals.shape[0] * SIZE, *residuals.shape[2:])
        out = np.empty((len(self.rows), *flat.shape[1:]))
        for where, numbers, factor in self.blocks:
            out[where] = factor @ flat[numbers]
        return out

    def each(self, columns: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Whiten several sets of columns, (m, 11, k) each, with the same bits as one by one: (r, k)."""
        out: list[np.ndarray] = [np.zeros(0)] * len(columns)
        widths = [column.shape[-1] for column in columns]
        for width in set(widths):
            chosen = [k for k, other in enumerate(widths) if other == width]
            flat = np.stack([columns[k].reshape(-1, width) for k in chosen])
            white = np.empty((len(chosen), len(self.rows), width))
            for where, numbers, factor in self.blocks:
                white[:, where] = factor @ flat[:, numbers]
            for k, one in zip(chosen, white, strict=True):
                out[k] = one
        return out

    def precision_weighted(self, white: np.ndarray) -> np.ndarray:
        """Compute V^-1 times the residuals from the whitened ones, (r,) -> (m, 11)."""
        flat = np.zeros(self.own.shape[0] * SIZE)
        for where, numbers, factor in self.blocks:
            flat[numbers] = factor.T @ white[where]
        return flat.reshape(-1, SIZE)


def floor(noise: Noise) -> np.ndarray:
    """Return the covariance of a posture's residuals without noise, (11, 11); zero for noisy sensors."""
    exact = noise.encoder < FINEST_ENCODER or noise.cell < FINEST_CELL
    return np.diag(FLOOR**2) if exact else np.zeros((SIZE, SIZE))


def whitening(
    observed: Observation,
    theta: np.ndarray,
    noise: Noise,
    channels: str = "AFTC",
    propagation: np.ndarray | None = None,
    internal: np.ndarray | None = None,
    squeeze: np.ndarray | None = None,
    clean: Observation | None = None,
) -> Whitening:
    """Return the whitening coordinates of some channels of an experiment.

    Args:
        theta: base parameters, (p,) [m].
        propagation: derivative of all fields with respect to the readings, (m, k, n_joints + 14), if
            effects were removed from the experiment; None: the fields are the readings.
        internal: change of the residuals by one s.d. of independent errors of every posture that no reading
            shows, (m, 11, j); None: there are none. squeeze: the same of errors that a placement's postures
            share.
        clean: the experiment with its noise, see `more_as_read`; None: nothing was removed from it.
    """
    slope, at = sensitivity(observed, theta), fields(observed)
    reach = slope[..., : at["plates"].stop].copy() if propagation is None else slope @ propagation
    if clean is not None:
        reach[:, ROWS["A"], at["cells"]] += more_as_read(clean, slope[:, ROWS["A"], at["cells"]])
    angles, cells = reach[..., at["angles"]], reach[..., at["cells"]]
    own = noise.encoder**2 * angles @ angles.mT + noise.cell**2 * cells @ cells.mT + floor(noise)
    if internal is not None and internal.shape[2]:
        own = own + internal @ internal.mT
    levers = reach[..., at["plates"]] * noise.plates
    levers = levers if squeeze is None else np.concatenate([levers, squeeze], axis=2)
    wanted = np.zeros(SIZE, bool)
    for channel in channels:
        wanted[ROWS[channel]] = True
    used = residuals_in_use(observed) & wanted
    return Whitening(slope, reach, own, levers, used, observed.measurements.placement, observed.stance)


def without_constants(stance: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return numbers that hold the residuals of a placement's n postures without its stances' constants.

    Returns:
        from all residuals, (11 n, 11 n); zero rows for what the constants hide.
    """
    rows = np.eye(used.size)
    for axis in range(ANCHORED.start, ANCHORED.stop):
        rows[axis::SIZE] = 0.0
        for number in np.unique(stance):
            at = SIZE * np.flatnonzero((stance == number) & used[:, axis]) + axis
            if len(at) > 1:
                rows[np.ix_(at[1:], at)] = helmert(len(at))
    return rows


def contrasts(used: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what is known of the residuals of a placement's n postures.

    Args:
        rows: see `without_constants`.

    Returns:
        rows of numbers that are known, from all 11 n residuals, and the residual that each mainly holds.
    """
    of = np.flatnonzero(used.ravel() & rows.any(axis=1))
    return rows[of], of
