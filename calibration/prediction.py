"""How well a calibration predicts postures that took no part in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.linearisation import (
    FOOT_TILT,
    INERTIA,
    INTERNAL,
    LOOSE,
    SQUEEZE,
    LinearisationPoint,
    Linearised,
    ResidualCovariance,
    linearised,
    sources_of,
)
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ROWS,
    SIZE,
    by_weight,
    residuals,
    residuals_in_use,
    total_force,
)
from tulip_testbed.identification.residual_noise import contrasts, without_constants
from tulip_testbed.measurements.data import feet_in_contact

STEP = 1e-4  # m, of a centre of pressure, for differences
RANK = 1e-12  # of singular values: readings of a foot in the air are zero


@dataclass(frozen=True)
class HeldOutPrediction:
    """Residuals of other postures, less their prediction.

    Their covariance is that of the noise, which has a block for each placement, and H H' of the estimates.

    Attributes:
        residual: (n,) [SI]. channel: letter of the channel of each residual, (n,).
        noise: covariance by the noise of each placement's residuals in turn.
        estimates: H, (n, k).
    """

    residual: np.ndarray
    channel: np.ndarray
    noise: tuple[np.ndarray, ...]
    estimates: np.ndarray

    def of(self, channels: str) -> HeldOutPrediction:
        """Return the part in some channels."""
        rows = np.isin(self.channel, list(channels))
        each = np.split(rows, np.cumsum([len(block) for block in self.noise])[:-1])
        noise = tuple(block[inside][:, inside] for block, inside in zip(self.noise, each, strict=True))
        return HeldOutPrediction(self.residual[rows], self.channel[rows], noise, self.estimates[rows])

    @property
    def variance(self) -> np.ndarray:
        """Return the variance of each residual, (n,)."""
        noise = [np.diag(block) for block in self.noise]
        return np.concatenate(noise) + (self.estimates**2).sum(axis=1)

    @property
    def chi_square(self) -> float:
        """Return the sum of squares of the whitened residual."""
        return self._whitened[0]

    @property
    def log_density(self) -> float:
        """Return ln of the predictive density at the residual [SI]."""
        square, volume = self._whitened
        return -0.5 * square - volume - 0.5 * len(self.residual) * float(np.log(2 * np.pi))

    @cached_property
    def _whitened(self) -> tuple[float, float]:
        """Return the sum of squares and half the ln determinant of the covariance (Woodbury)."""
        both, white, volume = np.column_stack([self.estimates, self.residual]), [], 0.0
        ends = np.cumsum([len(block) for block in self.noise])
        for block, part in zip(self.noise, np.split(both, ends[:-1]), strict=True):
            unit = np.sqrt(np.diag(block))
            lower = np.linalg.cholesky(block / unit / unit[:, None])
            volume += float((np.log(np.diag(lower)) + np.log(unit)).sum())
            white.append(solve_triangular(lower, part / unit[:, None], lower=True))
        flat = np.concatenate(white)
        left, right = flat[:, :-1], flat[:, -1]
        # Orthogonal, so that what the estimates explain is not the difference of two large numbers.
        basis, triangle = np.linalg.qr(np.vstack([left, np.eye(left.shape[1])]))
        whole = np.append(right, np.zeros(left.shape[1]))
        rest = whole - basis @ (basis.T @ whole)
        return float(rest @ rest), volume + float(np.log(np.abs(np.diag(triangle))).sum())


def predicted(calibration: SelfCalibration, others: Observation) -> HeldOutPrediction:
    """Predict the residuals of postures that took no part in a calibration.

    Args:
        calibration: made without those postures.
        others: the postures, of other placements.
    """
    problem, linear, _, scales = _linearised(calibration, others)
    estimate = calibration.solved.estimate
    structure = linear.covariance.structure
    own, levers = _noise(linear.covariance, scales)
    used = residuals_in_use(others)
    letters = np.array([letter for letter, at in ROWS.items() for _ in range(at.start, at.stop)])
    rows, covariances, channel = [], [], []
    for number in range(len(structure.placement)):
        inside = np.flatnonzero(structure.placement.number == number)
        contrast, of = contrasts(used[inside], without_constants(others.stance[inside], used[inside]))
        rows.append(contrast @ problem.whole[inside].reshape(len(inside) * SIZE, -1))
        shared = levers[inside].reshape(len(inside) * SIZE, -1)
        covariances.append(contrast @ (block_diag(*own[inside]) + shared @ shared.T) @ contrast.T)
        channel.append(letters[of % SIZE])
    whole = np.concatenate(rows)
    return HeldOutPrediction(
        residual=whole @ np.append(-estimate, 1.0),
        channel=np.concatenate(channel),
        noise=tuple(covariances),
        estimates=whole[:, :-1] @ _root(calibration.solved.covariance),
    )


def center_errors(calibration: SelfCalibration, others: Observation) -> np.ndarray:
    """Return measured less predicted centre of pressure of other postures, (m, 2) [m].

    A row's own force, its size and direction, may predict its moments; its moments may not. So the error e
    of a centre of pressure is unknown: it changes the row's residuals by J e, also where a correction depends
    on the load, such as a foot that yields, or where a force reads a part of a moment. e is the generalised
    least-squares estimate, by the noise of the row and the covariance of the calibration, both at the
    predicted centre. How the body is accelerated as it rocks and how late the foot is follow from the
    moments, so they are left out. Of two feet that stand, e is that of both together.

    Args:
        calibration: made without those postures.
    """
    motion = others.motion
    motion = replace(motion, load_rates=0 * motion.load_rates, yielding=0 * motion.yielding)
    others = replace(others, cad=calibration.observed.cad, motion=motion)
    others = others.weighing(calibration.observed.heavier)
    first = _center_errors(calibration, others)
    return first + _center_errors(calibration, _off_center(others, -first))


def _center_errors(calibration: SelfCalibration, others: Observation) -> np.ndarray:
    """Return the estimates, see `center_errors`, by what holds at these readings."""
    problem, linear, clean, scales = _linearised(calibration, others)
    own, levers = _noise(linear.covariance, scales)
    estimates = problem.whole[..., :-1] @ _root(calibration.solved.covariance)
    covariance = own + levers @ levers.mT + estimates @ estimates.mT
    left = left_by(calibration, clean)
    moved = (calibration.cleaned(_off_center(others, step)) for step in STEP * np.eye(2))
    by_center = np.stack([(left_by(calibration, one) - left) / STEP for one in moved], axis=2)
    used = residuals_in_use(others) & (np.arange(SIZE) < ROWS["C"].start)
    out = np.empty((len(others), 2))
    for k, rows in enumerate(used):
        reach = by_center[k, rows]
        weights = np.linalg.solve(covariance[k][np.ix_(rows, rows)], reach).T
        out[k] = np.linalg.solve(weights @ reach, weights @ left[k, rows])
    return out


def left_by(calibration: SelfCalibration, clean: Observation) -> np.ndarray:
    """Return the residuals at the estimate, that of the weight too, (m, 11).

    Args:
        clean: readings without members and effects.
    """
    left = residuals(clean, calibration.theta)
    left[:, : ROWS["T"].stop] += by_weight(clean) * (calibration.nu[-1] - clean.heavier)
    return left


def _linearised(
    calibration: SelfCalibration, others: Observation
) -> tuple[LinearProblem, Linearised, Observation, np.ndarray]:
    """Linearise other readings about a calibration.

    Returns:
        the problem, where it was linearised, the readings without members and effects, and the scales of the
        noise.
    """
    clean, estimate = calibration.cleaned(others), calibration.solved.estimate
    p = len(calibration.theta)
    variance = np.diag(
        calibration.mixing @ calibration.solved.covariance[p + 1 :, p + 1 :] @ calibration.mixing.T
    )
    # The noise holds the scales of the readings already; those of other postures are not estimated anew.
    unseen = np.isin(sources_of(others), (INTERNAL, SQUEEZE, FOOT_TILT, INERTIA, LOOSE))
    scales = np.where(unseen, calibration.solved.scales, 1.0)
    state = LinearisationPoint(clean, clean, calibration.nu, estimate[p + 1 :], variance, scales, None)
    return *linearised(state, calibration.all, calibration.noise), clean, scales


def _noise(covariance: ResidualCovariance, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of each row's own noise, (m, 11, 11), and the reach of the shared, (m, 11, k)."""
    structure = covariance.structure
    own = structure.fixed + np.tensordot(scales[: len(structure.own)] ** 2, structure.own, axes=1)
    return own, structure.shared * scales[structure.owner]


def _off_center(observed: Observation, shift: np.ndarray) -> Observation:
    """Return an observation whose centres of pressure are off by (2,) or (m, 2) [m], with equal forces."""
    contacts, m = observed.contacts, len(observed)
    forces = [contacts.bears.reshape(1, -1)]
    if contacts.pushes is not None:
        forces.append(block_diag(*contacts.pushes))
    held = np.vstack(forces)
    stand = np.repeat(feet_in_contact(observed.measurements.support), held.shape[1] // 2, axis=1)
    rows = np.concatenate([observed.cell_places.mT, np.broadcast_to(held, (m, *held.shape))], axis=1)
    change = np.linalg.pinv(rows * stand[:, None], rcond=RANK)[..., :2]
    moment = total_force(observed)[:, None] * np.broadcast_to(shift, (m, 2))
    return observed.changed(cell_forces=observed.cell_forces + (change @ moment[..., None])[..., 0])


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return R with R R' = covariance, without what rounding made negative."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, axes = np.linalg.eigh(covariance / size / size[:, None])
    return size[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
