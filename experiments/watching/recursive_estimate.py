"""The state of a day by the rows so far: a Kalman filter, linear about the present base parameters.

Reference: R. E. Kalman, A new approach to linear filtering and prediction problems, J. Basic Eng. 82, 1960.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.experiments.watching.day_model import PLATES, STANCE, DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns


@dataclass(frozen=True, eq=False)
class Belief:
    """Mean, (n,), and covariance, (n, n), of the state."""

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Innovation:
    """The difference between a posture's residuals and their prediction.

    Attributes:
        value: residuals less their prediction, (11,). covariance: of the prediction, (11, 11).
        precision: its inverse. gain: of the state by the residuals, (n, 11).
        state: derivative of the residuals by the state where they were predicted, (11, n).
        faults: change by one plausible size of each fault there, (11, c).
        freedom: residuals in use.
    """

    value: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    gain: np.ndarray
    state: np.ndarray
    faults: np.ndarray
    freedom: int

    @property
    def chi_square(self) -> float:
        """Return the square of the innovation in its own covariance."""
        return float(self.value @ self.precision @ self.value)


def first_belief(model: DayModel) -> Belief:
    """Return what is known before the first row."""
    return Belief(np.zeros(len(model.covariance)), model.covariance)


def begun(model: DayModel, belief: Belief, numbers: int) -> Belief:
    """Return the belief in a new placement (`PLATES + STANCE` numbers begin again) or stance (`STANCE`)."""
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    mean[-numbers:] = 0.0
    covariance[-numbers:] = covariance[:, -numbers:] = 0.0
    covariance[-numbers:, -numbers:] = model.covariance[-numbers:, -numbers:]
    return Belief(mean, covariance)


def innovation(model: DayModel, belief: Belief, row: RowColumns) -> Innovation:
    """Predict a posture and return by how much it is missed.

    Args:
        row: one row, see `RowColumns.row`.
    """
    here = row.about(belief.mean[: model.parameters])
    across = here.state @ belief.covariance
    covariance = across @ here.state.T + here.noise(model.noise.encoder)
    covariance = (covariance + covariance.T) / 2
    scale = 1 / np.sqrt(np.diag(covariance))
    precision = scale[:, None] * np.linalg.inv(scale[:, None] * covariance * scale) * scale
    return Innovation(
        value=here.residual - here.state @ belief.mean,
        covariance=covariance,
        precision=precision,
        gain=across.T @ precision,
        state=here.state,
        faults=here.faults,
        freedom=int(here.used.sum()),
    )


def updated(belief: Belief, found: Innovation) -> Belief:
    """Return the belief with the posture taken in."""
    mean = belief.mean + found.gain @ found.value
    covariance = belief.covariance - found.gain @ found.covariance @ found.gain.T
    return Belief(mean, (covariance + covariance.T) / 2)


ANEW = PLATES + STANCE
