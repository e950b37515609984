"""The result of every estimator."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import computed_field

from tulip_testbed.base.result import Array, InMemory, Numbers
from tulip_testbed.identification.statistics import (
    HIGH_CORRELATION,
    WELL_IDENTIFIED,
    high_correlations,
    relative_standard_errors,
    standard_errors,
)

MOSTLY = 0.5  # of a parameter's prior variance, that the data of a well identified one removed


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
    mass: Array
    mass_error: Array
    mass_share: Array
    center: Array
    center_error: Array
    center_share: Array
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
    value: Array
    carry: Array
    covariance: Array

    def given(self, value: np.ndarray, sizes: Mapping[str, float]) -> np.ndarray:
        """Return an estimate, (p,) [m], as if imperfections of these sizes, by label [SI], were known."""
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
        data_share: share of each parameter's prior variance that the data removed, 0 (all CAD) to 1, (p,).
            direction_shares: the same of independent directions, the best known first, (p,). None: the
            postures determine all parameters, and CAD takes no part.
        cad_scales: of the prior's s.d. of masses and centres of mass, see `CadPrior`.
    """

    numbers: Numbers
    names: tuple[str, ...]
    value: Array
    covariance: Array
    clustered_covariance: Array
    residual: Array
    sigma: float
    placement_sd: tuple[float, float]
    dof: int
    interval_dof: Array
    joint_dof: float
    condition_number: float
    unseen: InMemory[Unseen | None] = None
    standard: StandardEstimate | None = None
    data_share: Array | None = None
    direction_shares: Array | None = None
    cad_scales: tuple[float, float] | None = None

    @computed_field
    @property
    def standard_error(self) -> Array:
        """Return the standard errors by `covariance`, (p,) [m]."""
        return standard_errors(self.covariance)

    @computed_field
    @property
    def clustered_standard_error(self) -> Array:
        """Return the standard errors by `clustered_covariance`, (p,) [m]."""
        return standard_errors(self.clustered_covariance)

    @computed_field
    @property
    def relative_standard_error(self) -> Array:
        """Return the standard error over the estimate (eq. 13), (p,) [%]."""
        return relative_standard_errors(self.value, self.standard_error)

    @property
    def well_identified(self) -> np.ndarray:
        """Return which parameters have a small relative standard error that is not CAD's, (p,) bool."""
        known = self.relative_standard_error < WELL_IDENTIFIED
        return known if self.data_share is None else known & (self.data_share > MOSTLY)

    @computed_field
    @property
    def residual_norms(self) -> Array:
        """Return the distance between measured and estimated centre of pressure of each posture, (m,) [m]."""
        return np.linalg.norm(self.residual.reshape(-1, 2), axis=1)

    @computed_field
    @property
    def high_correlations(self) -> list[tuple[int, int, float]]:
        """Return the pairs of parameters that are highly correlated (eq. 15): both numbers, correlation."""
        return high_correlations(self.covariance, self.numbers, HIGH_CORRELATION)

    def __repr__(self) -> str:
        return (
            f"Estimate: {len(self.numbers)} parameters, residual sigma {1e3 * self.sigma:.3g} mm, "
            f"{self.dof} degrees of freedom, condition number {self.condition_number:.3g}"
        )
