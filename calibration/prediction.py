"""How well a calibration predicts postures that took no part in it."""

from __future__ import annotations

from collections.abc import Sequence
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
    SQUEEZE,
    LinearisationPoint,
    Linearised,
    ResidualCovariance,
    linearised,
    sources_of,
)
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ROWS,
    SIZE,
    by_weight,
    carried,
    fields,
    residuals,
    residuals_in_use,
)
from tulip_testbed.identification.residual_noise import contrasts, without_constants


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


def predicted(
    calibration: SelfCalibration, others: Observation, known: Sequence[EffectInstance] = ()
) -> HeldOutPrediction:
    """Predict the residuals of postures that took no part in a calibration.

    Args:
        calibration: made without those postures.
        others: the postures, of other placements.
        known: effects that are removed from them first, as they are.
    """
    problem, linear, _, scales = _linearised(calibration, removed(others, known))
    estimate = calibration.solved.estimate
    structure = linear.covariance.structure
    own = structure.fixed + np.tensordot(scales[: len(structure.own)] ** 2, structure.own, axes=1)
    levers = structure.shared * scales[structure.owner]
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

    A row's own force, its size and direction, may predict its moments; its moments may not. Where a
    correction depends on the load, such as a foot that yields, what it says of its own load is undone:
    the error e of a centre of pressure changes its residual by J e. How the body is accelerated as it rocks
    and how late the foot is follow from the moments, so they are left out.

    Args:
        calibration: made without those postures.
    """
    motion = replace(others.motion, load_rates=0 * others.motion.load_rates)
    others = replace(others, cad=calibration.observed.cad, motion=motion)
    _, linear, clean, scales = _linearised(calibration, others)
    structure = linear.covariance.structure
    own = structure.fixed + np.tensordot(scales[: len(structure.own)] ** 2, structure.own, axes=1)
    left = left_by(calibration, clean)
    used, at = residuals_in_use(others), fields(others)
    out = np.empty((len(others), 2))
    for k in range(len(others)):
        known = np.flatnonzero(used[k] & np.isin(np.arange(SIZE), range(2, ROWS["C"].start)))
        gain = np.linalg.solve(own[k][np.ix_(known, known)], own[k][np.ix_(known, [0, 1])]).T
        rest = np.eye(2, SIZE)
        rest[:, known] -= gain
        out[k] = np.linalg.solve(rest @ _by_center(linear.covariance, clean, at["cells"], k), rest @ left[k])
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
    unseen = np.isin(sources_of(others), (INTERNAL, SQUEEZE, FOOT_TILT, INERTIA))
    scales = np.where(unseen, calibration.solved.scales, 1.0)
    state = LinearisationPoint(clean, clean, calibration.nu, estimate[p + 1 :], variance, scales, None)
    return *linearised(state, calibration.all, calibration.noise), clean, scales


def _by_center(covariance: ResidualCovariance, observed: Observation, cells: slice, row: int) -> np.ndarray:
    """Differentiate a row's residuals by its centre of pressure with the forces as they are, (11, 2)."""
    bears = observed.contacts.bears.ravel()
    forces = [bears] if observed.contacts.pushes is None else [bears, *_wide(observed.contacts.pushes)]
    loaded = carried(observed)[row] != 0
    rows = np.vstack([observed.cell_places[row].T, *forces]) * loaded
    moved = np.linalg.lstsq(rows, np.vstack([observed.weight * np.eye(2), np.zeros((len(forces), 2))]))[0]
    return covariance.reach[row][:, cells] @ moved


def _wide(pushes: np.ndarray) -> list[np.ndarray]:
    """Return the horizontal force of each foot along x and y by all readings, four of (2 k,)."""
    nothing = np.zeros(pushes.shape[2])
    return [np.append(a, nothing) for a in pushes[0]] + [np.append(nothing, a) for a in pushes[1]]


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return R with R R' = covariance, without what rounding made negative."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, axes = np.linalg.eigh(covariance / size / size[:, None])
    return size[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
