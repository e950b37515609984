"""Base parameters as a robot's own model states them, for postures that do not determine all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters

MASS_SD = 0.2  # relative, of each link's mass: a CAD model lacks cables, screws and shells
CENTER_SD = 0.02  # m, of each link's centre of mass, per axis
LEAST = 1e-9  # m: s.d. of a base parameter that the links' masses and centres do not change


@dataclass(frozen=True, eq=False)
class CadPrior:
    """Base parameters by CAD, as if known from an earlier experiment.

    Attributes:
        center: (p,) [m].
        root: changes by one s.d. of every link's mass and centre of mass, (p, 4 n) [m].
        mass_sd: s.d. of the total mass [kg].
    """

    center: np.ndarray
    root: np.ndarray
    mass_sd: float

    @cached_property
    def covariance(self) -> np.ndarray:
        """Return the covariance of the base parameters, (p, p) [m2]."""
        return self.root @ self.root.T + LEAST**2 * np.eye(len(self.center))

    @cached_property
    def precision_root(self) -> np.ndarray:
        """Return W with W'W the inverse of the covariance, (p, p) [1/m]."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance))

    def combined(self, value: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return an estimate combined with the prior, (p,) [m], and its covariance, (p, p) [m2]."""
        gain = np.linalg.solve(self.covariance + covariance, self.covariance).T
        spread = gain @ covariance
        return self.center + gain @ (value - self.center), (spread + spread.T) / 2

    def data_share(self, covariance: np.ndarray) -> np.ndarray:
        """Return the share of each parameter's prior variance that the data removed, (p,), 0 to 1.

        Args:
            covariance: of the estimate, (p, p) [m2].
        """
        return np.clip(1 - np.diag(covariance) / np.diag(self.covariance), 0.0, 1.0)

    def direction_shares(self, covariance: np.ndarray) -> np.ndarray:
        """Return the same of the directions of base parameters, the best known first, (p,).

        They are those of the generalised eigenproblem of both covariances, independent before and after.
        """
        white = self.precision_root @ covariance @ self.precision_root.T
        return np.clip(1 - np.linalg.eigvalsh(white), 0.0, 1.0)


def cad_prior(parameters: BaseParameters, standard: np.ndarray, mass_sd: float = MASS_SD) -> CadPrior:
    """Return the prior whose s.d. are those of the estimator `prior`.

    Args:
        standard: standard parameters of the links by CAD, (n, 4) [kg, kg m].
        mass_sd: relative, of each link's mass.
    """
    mass, total = standard[:, 0], float(standard[:, 0].sum())
    by_standard = parameters.from_standard.reshape(len(parameters.names), -1, 4)
    value = parameters.values(standard)
    by_mass = np.einsum("pnk,nk->pn", by_standard, standard) - value[:, None] * mass
    by_center = CENTER_SD * by_standard[..., 1:] * mass[:, None]
    root = np.hstack([mass_sd * by_mass, by_center.reshape(len(value), -1)]) / total
    return CadPrior(value, root, mass_sd * float(np.linalg.norm(mass)))
