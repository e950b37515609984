"""The information of the postures so far about the base parameters, by the data sheets alone.

The information is that of generalised least squares on the centre of pressure, with the errors of the plates'
recorded poses common to a placement. It depends on where the robot stood and on the stated noise, not on
what the residuals are: an experimenter who stops when it suffices does not choose the errors, and
intervals keep their
coverage.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.experiments.watching.day_model import PLATES, STANCE, DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns

CENTER = slice(0, 2)  # residuals of the centre of pressure
LEAST_SHARE = 1e-10  # of the largest eigenvalue, below which parameters are not determined yet


@dataclass(frozen=True, eq=False)
class DesignInformation:
    """Information on the base parameters; the present placement is kept apart until it ends.

    Attributes:
        settled: of the placements that have ended, (p, p) [1/m2].
        own, across, within: of the present one, on the parameters, (p, p), between them and the plates'
            errors, (p, 6), and on these, (6, 6).
    """

    settled: np.ndarray
    own: np.ndarray
    across: np.ndarray
    within: np.ndarray

    @property
    def whole(self) -> np.ndarray:
        """Return the information of all rows, (p, p)."""
        inner = np.eye(PLATES) + self.within
        return self.settled + self.own - self.across @ np.linalg.solve(inner, self.across.T)

    def standard_errors(self) -> np.ndarray:
        """Return the standard errors of the base parameters, (p,) [m]; infinite until all are determined."""
        whole = self.whole
        scale = 1 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
        scaled = scale[:, None] * whole * scale
        values = np.linalg.eigvalsh(scaled)
        if values[0] <= LEAST_SHARE * values[-1]:
            return np.full(len(whole), np.inf)
        return scale * np.sqrt(np.diag(np.linalg.inv(scaled)))


def no_information(parameters: int) -> DesignInformation:
    """Return the information before the first row."""
    p = parameters
    return DesignInformation(
        np.zeros((p, p)), np.zeros((p, p)), np.zeros((p, PLATES)), np.zeros((PLATES, PLATES))
    )


def placement_begun(information: DesignInformation) -> DesignInformation:
    """Return the information as a new placement begins."""
    return replace(no_information(len(information.settled)), settled=information.whole)


def with_posture(information: DesignInformation, model: DayModel, row: RowColumns) -> DesignInformation:
    """Return the information with one more posture."""
    by_angles = row.by_angles[CENTER]
    noise = model.noise.encoder**2 * by_angles @ by_angles.T + row.cells[CENTER, CENTER]
    base = row.state[CENTER, : model.parameters]
    plates = row.state[CENTER, -PLATES - STANCE : -STANCE]
    weighed = np.linalg.solve(noise, np.concatenate([base, plates], axis=1))
    p = model.parameters
    return replace(
        information,
        own=information.own + base.T @ weighed[:, :p],
        across=information.across + base.T @ weighed[:, p:],
        within=information.within + plates.T @ weighed[:, p:],
    )
