"""The linear model of the residuals, with the nuisance parameters projected out.

r = N nu + G phi + e: nu holds the base parameters (A) and the error of the weighed mass (F); G the columns of
the effects; e the noise, white after whitening, which removes the swing foot's pose in each stance (C).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, qr

from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ROWS,
    SIZE,
    by_base_parameters,
    by_weight,
    fields,
    more_as_read,
    packed,
    residuals,
    unpacked,
)
from tulip_testbed.identification.residual_noise import Noise, Whitening, whitening

RANK = 1e-9  # of the largest diagonal element of R
LARGEST = 4.0  # s.d. of the noise of an encoder, a plate's pose or a sensor in a foot
FINEST_SCALE = 1e-3  # kg
UNWEIGHED = 0.3  # of the nominal mass: s.d. of the mass of a robot that was not weighed


@dataclass(frozen=True)
class Background:
    """Ordinary imperfections that were estimated and removed: what is still uncertain about them.

    Attributes:
        columns: derivative of the residuals by independent deviates with prior s.d. 1, (m, 11, k).
        removed: estimate of the deviates, (k,).
        internal: change of the residuals by one s.d. of forces that no cell shows, (m, 11, j); they differ
            from posture to posture. squeeze: the same of those that a placement's postures share.
        yielding: what noisy readings change in the fields of `packed` through the compliances that were
            removed, (m, k, n_joints + 2 k + 6); None: nothing.
    """

    columns: np.ndarray
    removed: np.ndarray
    internal: np.ndarray
    squeeze: np.ndarray
    yielding: np.ndarray | None = None


def exact(postures: int) -> Background:
    """Return the background of a laboratory in which everything is exact."""
    nothing = np.zeros((postures, SIZE, 0))
    return Background(nothing, np.zeros(0), nothing, nothing)


@dataclass(frozen=True)
class LinearModel:
    """An experiment, linear about its readings.

    Attributes:
        observed: the readings as measured.
        smoothed: the readings less the mean of their noise given the residuals. Columns are taken there, so
            that they do not hold the noise that they are compared with.
        theta: base parameters, (p,) [m].
        noise, whitening: of the residuals.
        basis: orthonormal basis of the whitened nuisance columns, (r + e, k). The last e rows hold what is
            known beforehand: the weighing, CAD where it is needed, the prior of ordinary imperfections.
        known: residuals of those rows, (e,).
        residual: whitened and projected, (r + e,).
        weighed: whether the weighing is among the data, which is so with channel F.
    """

    observed: Observation
    smoothed: Observation
    theta: np.ndarray
    noise: Noise
    whitening: Whitening
    basis: np.ndarray
    known: np.ndarray
    residual: np.ndarray
    weighed: bool

    @property
    def dof(self) -> int:
        """Return the degrees of freedom of the residual."""
        return len(self.basis) - self.basis.shape[1] - int(not self.weighed)

    @property
    def chi_square(self) -> float:
        """Return the sum of squares of the residual."""
        return float(self.residual @ self.residual)

    def project(self, columns: np.ndarray) -> np.ndarray:
        """Project the nuisance columns out of whitened columns (r, ...): (r + e, ...)."""
        return self._project(columns, np.zeros((len(self.known), *columns.shape[1:])))

    def project_residual(self, whitened: np.ndarray) -> np.ndarray:
        """Project the nuisance columns out of whitened residuals, (r,), and what is known: (r + e,)."""
        return self._project(whitened, self.known)

    def _project(self, whitened: np.ndarray, known: np.ndarray) -> np.ndarray:
        full = np.concatenate([whitened, known])
        return full - self.basis @ (self.basis.T @ full)

    def residual_of(self, observed: Observation) -> np.ndarray:
        """Compute the whitened, projected residual of other readings, (r + e,)."""
        return self.project_residual(self.whitening(residuals(observed, self.theta)))

    @cached_property
    def raw_residual(self) -> np.ndarray:
        """Compute the residuals at the base parameters, (m, 11)."""
        return residuals(self.observed, self.theta)


def linear_model(
    observed: Observation,
    noise: Noise,
    channels: str = "AFTC",
    smoothed: Observation | None = None,
    rounds: int = 2,
    propagation: np.ndarray | None = None,
    background: Background | None = None,
) -> LinearModel:
    """Build the linear model of an experiment.

    Args:
        observed: the experiment with all known effects removed.
        channels: those that are used.
        smoothed: its readings less their noise, if known; otherwise the readings. Covariances taken at
            noisy readings are correlated with the noise, which `rounds` of smoothing reduce.
        propagation: see `whitening`; of other effects than ordinary imperfections.
        background: ordinary imperfections that were removed; None: there are none.

    Raises:
        numpy.linalg.LinAlgError: readings that are not finite.
    """
    smoothed = observed if smoothed is None else smoothed
    theta = first_parameters(observed)
    rest = exact(len(observed)) if background is None else background
    model = _round(observed, smoothed, theta, noise, channels, propagation, rest)
    for _ in range(rounds - 1):
        model = _round(observed, model.smoothed, model.theta, noise, channels, propagation, rest)
    return model


def first_parameters(observed: Observation) -> np.ndarray:
    """Return base parameters to begin with, (p,) [m]: CAD where it is needed, or else least squares."""
    if observed.cad is not None:
        return observed.cad.center
    regressor = -by_base_parameters(observed)[:, ROWS["A"]]
    flat, cad = regressor.reshape(2 * len(observed), -1), observed.nominal.value
    return cad + np.linalg.lstsq(flat, residuals(observed, cad)[:, ROWS["A"]].ravel(), rcond=None)[0]


def _round(
    observed: Observation,
    smoothed: Observation,
    theta: np.ndarray,
    noise: Noise,
    channels: str,
    propagation: np.ndarray | None,
    background: Background,
) -> LinearModel:
    """Take columns and covariances at the smoothed readings, and residuals at the readings."""
    if (yielding := background.yielding) is not None:
        plain = np.eye(*yielding.shape[1:]) if propagation is None else propagation
        propagation = plain + yielding
    hidden = background.internal, background.squeeze
    white = whitening(smoothed, theta, noise, channels, propagation, *hidden, observed)
    nuisance = nuisances(smoothed, channels)
    used = np.abs(nuisance).max(axis=(0, 1)) > 0
    members = background.columns.shape[2]
    kept = np.append(used, np.ones(members, bool))
    rows, values = known_beforehand(observed, theta)
    prior = block_diag(rows, np.eye(members))
    # A deviate that is removed in addition takes its columns from the residuals.
    whole = np.concatenate([nuisance, -background.columns], axis=2)
    whole = np.vstack([white(whole[..., kept]), prior[:, kept]])
    known = np.append(values, background.removed)
    basis, triangle, order = _pivoted_qr(whole)
    size = np.abs(np.diag(triangle))
    rank = int((size > RANK * size.max(initial=0.0)).sum())
    basis, triangle = basis[:, :rank], triangle[:rank, :rank]
    as_read = more_as_read(observed, white.sensitivity[:, ROWS["A"], fields(observed)["cells"]])
    noisy = residuals(observed, theta)
    noisy[:, ROWS["A"]] += (as_read @ (observed.cell_forces - smoothed.cell_forces)[..., None])[..., 0]
    start = np.concatenate([white(noisy), known])
    gain = basis.T @ start
    left = start - basis @ gain
    solution = np.zeros(len(kept))
    solution[np.flatnonzero(kept)[order[:rank]]] = -np.linalg.solve(triangle, gain)
    theta = theta + solution[: len(theta)]
    smoothed = without_noise(observed, white.precision_weighted(left[: len(white.rows)]), white.reach, noise)
    return LinearModel(observed, smoothed, theta, noise, white, basis, known, left, "F" in channels)


def _pivoted_qr(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Q, R and the order of the columns of a QR decomposition with column pivoting."""
    basis, triangle, order = qr(matrix, mode="economic", pivoting=True)
    return np.asarray(basis), np.asarray(triangle), np.asarray(order)


def without_noise(observed: Observation, pull: np.ndarray, reach: np.ndarray, noise: Noise) -> Observation:
    """Subtract from the readings the mean of their noise given the residuals, S J' V^-1 r.

    Args:
        pull: V^-1 r, (m, 11).
        reach: J, derivative of the residuals by the readings, (m, 11, n_joints + 14).
        noise: standard deviations in S.
    """
    n, count = observed.joint_angles.shape[1], observed.cell_forces.shape[1]
    variance = np.concatenate([np.full(n, noise.encoder**2), np.full(count, noise.cell**2), noise.plates**2])
    errors = np.zeros((len(observed), packed(observed).shape[1]))
    plates = fields(observed)["plates"]
    readings = slice(0, plates.stop)
    of_rows = pull if observed.in_time is None else observed.in_time.correlated(pull)
    errors[:, readings] = variance * (reach.mT @ of_rows[..., None])[..., 0]
    for placement in np.unique(observed.measurements.placement):
        inside = observed.measurements.placement == placement
        together = np.einsum("mrk,mr->k", reach[inside][..., plates], pull[inside])
        errors[inside, plates] = noise.plates**2 * together
    # A larger error than noise can make is not noise. Of the cells of plates it is taken off too: gains and
    # tares that make all loads smaller make what is left smaller, which many rows would take for evidence.
    most = LARGEST * np.sqrt(variance)
    if not observed.in_feet:
        most[n : n + count] = np.inf
    errors[:, readings] = np.clip(errors[:, readings], -most, most)
    return unpacked(observed, packed(observed) - errors)


def nuisances(observed: Observation, channels: str) -> np.ndarray:
    """Differentiate the residuals by the base parameters and the error of the weighed mass, (m, 11, p + 1).

    Whitened residuals do not hold the swing foot's pose in each stance.
    """
    weight = np.zeros((len(observed), SIZE, 1))
    weight[:, : ROWS["T"].stop, 0] = by_weight(observed)
    out = np.concatenate([by_base_parameters(observed), weight], axis=2)
    for channel in set(ROWS).difference(channels):
        out[:, ROWS[channel]] = 0.0
    return out


def known_beforehand(observed: Observation, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what is known of the columns of `nuisances`, of unit variance: rows (e, p + 1), residuals (e,).

    The first row says how well the weight is known, the others what CAD says if it is needed.
    """
    p = len(theta)
    weighing = np.append(np.zeros(p), weighed_precision(observed))[None]
    if observed.cad is None:
        return weighing, np.zeros(1)
    root = observed.cad.precision_root
    rows = np.vstack([weighing, np.column_stack([root, np.zeros(p)])])
    return rows, np.append(0.0, root @ (theta - observed.cad.center))


def weighed_precision(observed: Observation) -> float:
    """Return one over the s.d. of the weight as it was weighed [1/N]."""
    weighed = observed.measurements.weighed_mass
    unweighed = UNWEIGHED * observed.nominal.mass if observed.cad is None else observed.cad.mass_sd
    sd = max(weighed[1], FINEST_SCALE) if weighed else unweighed
    return 1.0 / (sd * observed.measurements.gravity)
