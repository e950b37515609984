"""The linear model of the residuals: what is not known anyway is projected out.

r = N nu + G phi + e: nu holds the base parameters (A), the swing foot's place in every placement (C) and
the error of the weighing (F); G the effects' columns; e the noise, white here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ANCHORED,
    ROWS,
    SIZE,
    center,
    packed,
    residuals,
    unpacked,
)
from tulip_testbed.identification.residual_noise import Noise, White, whitening

RANK = 1e-9  # of the largest diagonal element of R
LARGEST = 4.0  # s.d. of a reading's noise
UNWEIGHED = 0.3  # of the nominal mass: s.d. of a robot's mass that nobody has weighed


@dataclass(frozen=True)
class Linear:
    """An experiment about which effects are sought.

    Attributes:
        observed: readings as measured.
        smooth: readings less the noise that the residuals tell; where columns are taken, so that a
            column does not hold the noise that it is compared with.
        theta: base parameters, (p,) [m].
        noise, white: see there.
        basis: orthonormal, of the whitened nuisances, (r + 1, k); the last row is the weighing's.
        residual: whitened and projected, (r + 1,).
        weighed: whether the weighing is among the data: where channel F is.
    """

    observed: Observation
    smooth: Observation
    theta: np.ndarray
    noise: Noise
    white: White
    basis: np.ndarray
    residual: np.ndarray
    weighed: bool

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return len(self.basis) - self.basis.shape[1] - int(not self.weighed)

    def project(self, columns: np.ndarray) -> np.ndarray:
        """Take the nuisances out of whitened columns (r, ...): (r + 1, ...)."""
        full = np.concatenate([columns, np.zeros((1, *columns.shape[1:]))])
        return full - self.basis @ (self.basis.T @ full)

    def at(self, observed: Observation) -> np.ndarray:
        """Whitened, projected residual of readings that are taken to be others, (r + 1,)."""
        return self.project(self.white(residuals(observed, self.theta)))


def linear_model(
    shown: Observation,
    noise: Noise,
    channels: str = "AFTC",
    smooth: Observation | None = None,
    rounds: int = 2,
    through: np.ndarray | None = None,
    beside: np.ndarray | None = None,
) -> Linear:
    """Build it from an experiment.

    Args:
        shown: the experiment, freed of what is already known.
        channels: those that are looked at.
        smooth: its readings less their noise, where they are known; else the readings. Covariances taken at
            noisy readings go with their noise: `rounds` of smoothing take that away.
        through: see `whitening`.
        beside: residuals that are explained already, (m, 11): they are no noise to be smoothed away.

    Raises:
        numpy.linalg.LinAlgError: readings that are no numbers.
    """
    smooth = shown if smooth is None else smooth
    theta = np.linalg.lstsq(
        shown.nominal.parameters.regressor(shown.joint_angles).reshape(2 * len(shown), -1),
        center(shown).ravel(),
        rcond=None,
    )[0]
    known = np.zeros((len(shown), SIZE)) if beside is None else beside
    found = _round(shown, smooth, theta, noise, channels, through, known)
    for _ in range(rounds - 1):
        found = _round(shown, found.smooth, found.theta, noise, channels, through, known)
    return found


def _round(
    shown: Observation,
    smooth: Observation,
    theta: np.ndarray,
    noise: Noise,
    channels: str,
    through: np.ndarray | None,
    beside: np.ndarray,
) -> Linear:
    """Columns and covariances at smoothed readings, residuals at the readings."""
    white = whitening(smooth, theta, noise, channels, through)
    nuisance = nuisances(smooth, channels)
    kept = np.abs(nuisance).max(axis=(0, 1)) > 0
    basis, triangle, order = _pivoted(np.vstack([white(nuisance[..., kept]), weighing(shown)[None, kept]]))
    size = np.abs(np.diag(triangle))
    rank = int((size > RANK * size.max(initial=0.0)).sum())
    basis, triangle = basis[:, :rank], triangle[:rank, :rank]
    start = np.append(white(residuals(shown, theta) - beside), 0.0)
    gain = basis.T @ start
    left = start - basis @ gain
    solution = np.zeros(nuisance.shape[-1])
    solution[np.flatnonzero(kept)[order[:rank]]] = -np.linalg.solve(triangle, gain)
    theta = theta + solution[: len(theta)]
    return Linear(
        shown, _smoothed(shown, white, left, noise), theta, noise, white, basis, left, "F" in channels
    )


def _pivoted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """QR decomposition with column pivoting: Q, R and the columns' order."""
    basis, triangle, order = qr(matrix, mode="economic", pivoting=True)
    return np.asarray(basis), np.asarray(triangle), np.asarray(order)


def _smoothed(shown: Observation, white: White, left: np.ndarray, noise: Noise) -> Observation:
    """Readings less their noise's mean given the residuals, S J' V^-1 r."""
    pull = white.back(left[:-1])
    n, reach = shown.joint_angles.shape[1], white.reach
    variance = np.concatenate([np.full(n, noise.encoder**2), np.full(8, noise.cell**2), noise.plates**2])
    errors = np.zeros((len(shown), white.sensitivity.shape[-1]))
    readings, plates = slice(0, n + 14), slice(n + 8, n + 14)
    errors[:, readings] = variance * (reach.mT @ pull[..., None])[..., 0]
    for placement in np.unique(shown.measurements.placement):
        inside = shown.measurements.placement == placement
        together = np.einsum("mrk,mr->k", reach[inside][..., plates], pull[inside])
        errors[inside, plates] = noise.plates**2 * together
    most = LARGEST * np.sqrt(variance)
    # What is larger than noise can be is no noise.
    errors[:, readings] = np.clip(errors[:, readings], -most, most)
    return unpacked(shown, packed(shown) - errors)


def nuisances(observed: Observation, channels: str) -> np.ndarray:
    """Derivative of the residuals by all that is not known anyway, (m, 11, k)."""
    m, stance = len(observed), observed.stance
    regressor = observed.nominal.parameters.regressor(observed.joint_angles)
    p = regressor.shape[2]
    sets = np.unique(stance)
    out = np.zeros((m, SIZE, p + 3 * len(sets) + 1))
    if "A" in channels:
        out[:, ROWS["A"], :p] = -regressor
    if "C" in channels:
        for k, number in enumerate(sets):
            inside = np.flatnonzero(stance == number)
            for axis in range(3):
                out[inside, ANCHORED.start + axis, p + 3 * k + axis] = -1.0
    if "F" in channels:
        out[:, ROWS["F"], -1] = -1.0
    return out


def weighing(observed: Observation) -> np.ndarray:
    """The row that says how well the weight is known."""
    regressor = observed.nominal.parameters
    sets = len(np.unique(observed.stance))
    row = np.zeros(len(regressor.names) + 3 * sets + 1)
    weighed = observed.measurements.weighed_mass
    sd = (
        weighed[1] if weighed and weighed[1] else (UNWEIGHED * observed.nominal.mass if not weighed else 1e-3)
    )
    row[-1] = 1.0 / (sd * observed.measurements.gravity)
    return row
