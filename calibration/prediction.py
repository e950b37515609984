"""How well a calibration predicts postures that took no part in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.linearisation import State, linearised
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, SIZE, residuals_in_use
from tulip_testbed.identification.residual_noise import contrasts, noise_of


@dataclass(frozen=True)
class Prediction:
    """Residuals of other postures, less their prediction.

    Attributes:
        residual: (n,) [SI]. channel: letter of the channel of each residual, (n,).
        covariance: of the residual, by the noise and the errors of all estimates, (n, n).
    """

    residual: np.ndarray
    covariance: np.ndarray
    channel: np.ndarray

    def of(self, channels: str) -> Prediction:
        """Return the part in some channels."""
        rows = np.isin(self.channel, list(channels))
        return Prediction(self.residual[rows], self.covariance[np.ix_(rows, rows)], self.channel[rows])

    @cached_property
    def chi_square(self) -> float:
        """Return the sum of squares of the whitened residual."""
        return float(self._whitened[0] @ self._whitened[0])

    @property
    def log_density(self) -> float:
        """Return ln of the predictive density at the residual [SI]."""
        white, volume = self._whitened
        return -0.5 * self.chi_square - volume - 0.5 * len(white) * float(np.log(2 * np.pi))

    @cached_property
    def _whitened(self) -> tuple[np.ndarray, float]:
        """Return the whitened residual and half the ln determinant of the covariance."""
        unit = np.sqrt(np.diag(self.covariance))
        lower = np.linalg.cholesky(self.covariance / unit / unit[:, None])
        volume = float((np.log(np.diag(lower)) + np.log(unit)).sum())
        return np.asarray(solve_triangular(lower, self.residual / unit, lower=True)), volume


def predicted(
    found: SelfCalibration, others: Observation, known: Sequence[EffectInstance] = ()
) -> Prediction:
    """Predict the residuals of postures that took no part in a calibration.

    Args:
        found: the calibration.
        others: postures of other placements.
        known: effects that are removed from them first, as they are.
    """
    clean = found.cleaned(removed(others, known))
    estimate, p = found.solved.estimate, len(found.theta)
    variance = np.diag(found.mixing @ found.solved.covariance[p + 1 :, p + 1 :] @ found.mixing.T)
    state = State(clean, clean, estimate[: p + 1], estimate[p + 1 :], variance, found.solved.scales, None)
    problem, linear = linearised(state, found.all, noise_of(others))
    structure, scales = linear.covariance.structure, found.solved.scales
    own = structure.fixed + np.tensordot(scales[: len(structure.own)] ** 2, structure.own, axes=1)
    levers = structure.shared * scales[structure.owner]
    used = residuals_in_use(others)
    letters = np.array([letter for letter, at in ROWS.items() for _ in range(at.start, at.stop)])
    rows, covariances, channel = [], [], []
    for number in range(len(structure.placement)):
        inside = np.flatnonzero(structure.placement.number == number)
        contrast, of = contrasts(others.stance[inside], used[inside])
        rows.append(contrast @ problem.whole[inside].reshape(len(inside) * SIZE, -1))
        shared = levers[inside].reshape(len(inside) * SIZE, -1)
        covariances.append(contrast @ (block_diag(*own[inside]) + shared @ shared.T) @ contrast.T)
        channel.append(letters[of % SIZE])
    whole = np.concatenate(rows)
    covariance = block_diag(*covariances) + _propagated(whole[:, :-1], found.solved.covariance)
    return Prediction(whole @ np.append(-estimate, 1.0), covariance, np.concatenate(channel))


def _propagated(columns: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return columns times a covariance times their transpose, without what rounding made negative."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, axes = np.linalg.eigh(covariance / size / size[:, None])
    half = (columns * size) @ (axes * np.sqrt(np.maximum(values, 0.0)))
    return half @ half.T
