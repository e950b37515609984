"""The result of every estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class StandardEstimate:
    """Masses and centres of mass of the links, estimated with the robot's own model as prior.

    Attributes:
        links: names of the links, (n,).
        mass, mass_error, mass_share: value and standard error [kg], and share of the prior's variance that
            the measurements removed, from 0 (all prior) to 1 (all data), (n,).
        center, center_error, center_share: the same for the centre of mass in the link's frame, (n, 3) [m].
        identifiable: sentence about the masses that the measurements determine.
    """

    links: tuple[str, ...]
    mass: np.ndarray
    mass_error: np.ndarray
    mass_share: np.ndarray
    center: np.ndarray
    center_error: np.ndarray
    center_share: np.ndarray
    identifiable: str


@dataclass(frozen=True, eq=False)
class Unseen:
    """Imperfections that the data do not show: how large they are is what their prior says.

    Attributes:
        labels: names of their numbers, (u,).
        value: estimates, (u,) [SI].
        carry: derivative of the estimated base parameters by them, (p, u) [m/SI].
        covariance: of the base parameters if they were known, (p, p) [m2].
    """

    labels: tuple[str, ...]
    value: np.ndarray
    carry: np.ndarray
    covariance: np.ndarray

    def given(self, value: np.ndarray, sizes: Mapping[str, float]) -> np.ndarray:
        """Return the base parameters (p,) as they were estimated if these imperfections were known.

        Args:
            value: the estimate, (p,) [m].
            sizes: true numbers by label, zero if missing [SI].
        """
        return value + self.carry @ (np.array([sizes.get(label, 0.0) for label in self.labels]) - self.value)


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate of the base parameters with its covariance.

    Attributes:
        numbers, names: numbers and names of the parameters, (p,).
        value: estimated base parameters, (p,) [m].
        covariance: covariance by the estimator's own error model, (p, p) [m2]; for least squares
            sigma^2 C, C = (H'H)^-1, with independent errors (eqs 13, 14).
        clustered_covariance: covariance with errors common to a placement, (p, p) [m2]; equal to
            `covariance` if the estimator's own model includes them.
        residual: e = y - H theta (eq. 12), (2m,) [m].
        sigma: residual s.d. (eq. 14) [m].
        placement_sd: estimated s.d. per axis of the placement errors of the right and left plate [m].
        dof: degrees of freedom r - p.
        interval_dof: degrees of freedom of each parameter's t interval by `covariance`, (p,).
        joint_dof: of the denominator of an F test of all parameters.
        condition_number: condition number of H.
        unseen: imperfections that the estimator knows by their prior alone; None: it has no prior.
        standard: link masses and centres of mass, if the estimator gives them.
    """

    numbers: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    clustered_covariance: np.ndarray
    residual: np.ndarray
    sigma: float
    placement_sd: tuple[float, float]
    dof: int
    interval_dof: np.ndarray
    joint_dof: float
    condition_number: float
    unseen: Unseen | None = None
    standard: StandardEstimate | None = None

    def __repr__(self) -> str:
        return (
            f"Estimate: {len(self.numbers)} parameters, residual sigma {1e3 * self.sigma:.3g} mm, "
            f"{self.dof} degrees of freedom, condition number {self.condition_number:.3g}"
        )
