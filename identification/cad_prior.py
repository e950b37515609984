"""Base parameters as a robot's own model states them, for postures that do not determine all of them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters

MASS_SD = 0.2  # relative, of each link's mass: a CAD model lacks cables, screws and shells
CENTER_SD = 0.02  # m, of each link's centre of mass, per axis
LEAST = 1e-9  # m: s.d. of a base parameter that the links' masses and centres do not change
# Ends of the scales of these s.d.: no CAD model is better than 2 % of a mass and 2 mm of a centre, and with
# more than 20 % masses would be absurd. Assumed.
BEST, WORST = 0.1, 1.0
RANK = 1e-10  # of the largest singular value
POINTS = 12  # of each scale, over which the posterior is summed


@dataclass(frozen=True, eq=False)
class CadPrior:
    """Base parameters by CAD, as if known from an earlier experiment.

    Attributes:
        center: (p,) [m].
        by_mass, by_center: changes by one s.d. of every link's mass, (p, n), and centre, (p, 3 n) [m].
        mass_sd: s.d. of the total mass [kg].
        scales: of the s.d. of masses and of centres, in those that are assumed beforehand, (2,).
    """

    center: np.ndarray
    by_mass: np.ndarray
    by_center: np.ndarray
    mass_sd: float
    scales: tuple[float, float] = (1.0, 1.0)

    def at(self, scales: tuple[float, float]) -> Self:
        """Return the prior with s.d. of other scales."""
        masses, centers = np.divide(scales, self.scales).tolist()
        return replace(self, by_mass=masses * self.by_mass, by_center=centers * self.by_center, scales=scales)

    @property
    def root(self) -> np.ndarray:
        """Return both kinds of changes side by side, (p, 4 n) [m]."""
        return np.hstack([self.by_mass, self.by_center])

    @property
    def log_density(self) -> float:
        """Return ln of what the prior's normalisation adds to the evidence, with half-Cauchy scales."""
        volume = float(np.log(np.abs(np.diag(self.precision_root))).sum())
        return volume - float(_cost_of(np.array(self.scales)).sum())

    def rescaled(self, change: np.ndarray, covariance: np.ndarray) -> Self:
        """Return the prior with the scales whose squares are the posterior mean, by the marginal likelihood.

        The change of the base parameters from CAD is (p,) [m], its covariance with this prior (p, p). With
        W'W the inverse of the present prior's covariance and U diag(v) U' that of the posterior's covariance,
        both by W, the data see y = U' W change / sqrt(v (1 - v)) with the covariance I + Q' S Q of a prior's
        covariance S, Q = W' U diag(sqrt(1 / v - 1)).
        """
        white = self.precision_root
        left, turn = np.linalg.eigh(white @ covariance @ white.T)
        seen = (left > 0) & (left < 1 - LEAST)
        left, turn = left[seen], turn[:, seen]
        y = (turn.T @ (white @ change)) / np.sqrt(left * (1 - left))
        reach = (white.T @ turn) * np.sqrt(1 / left - 1)
        grid = np.geomspace(BEST, WORST, POINTS)
        both = zip((self.by_mass, self.by_center), self.scales, strict=True)
        each = [(reach.T @ root) / scale for root, scale in both]
        masses, centers = (grid[:, None, None] ** 2 * (one @ one.T) for one in each)
        spread = np.eye(len(y)) + masses[:, None] + centers
        cost = 0.5 * (np.linalg.slogdet(spread)[1] + np.linalg.solve(spread, y[:, None])[..., 0] @ y)
        cost += np.add.outer(_cost_of(grid), _cost_of(grid))
        weights = np.exp(cost.min() - cost)
        squares = (weights.sum(axis=axis) @ grid**2 / weights.sum() for axis in (1, 0))
        return self.at(tuple(np.sqrt(list(squares)).tolist()))

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

        The covariance is that of the estimate, (p, p) [m2].
        """
        return np.clip(1 - np.diag(covariance) / np.diag(self.covariance), 0.0, 1.0)

    def direction_shares(self, covariance: np.ndarray) -> np.ndarray:
        """Return the same of the directions of base parameters, the best known first, (p,).

        They are those of the generalised eigenproblem of both covariances, independent before and after.
        """
        white = self.precision_root @ covariance @ self.precision_root.T
        return np.clip(1 - np.linalg.eigvalsh(white), 0.0, 1.0)


def _cost_of(scale: np.ndarray) -> np.ndarray:
    """Return minus the logarithm of the density of ln scale if the scale is half-Cauchy (Gelman 2006)."""
    return np.log1p(scale**2) - np.log(scale)


def cad_prior(parameters: BaseParameters, standard: np.ndarray, mass_sd: float = MASS_SD) -> CadPrior:
    """Return the prior with the s.d. of the estimator `prior`; that of each link's mass is relative.

    The standard parameters are the links' by CAD, (n, 4) [kg, kg m].
    """
    mass, total = standard[:, 0], float(standard[:, 0].sum())
    by_standard = parameters.from_standard.reshape(len(parameters.names), -1, 4)
    value = parameters.values(standard)
    by_mass = np.einsum("pnk,nk->pn", by_standard, standard) - value[:, None] * mass
    by_center = CENTER_SD * by_standard[..., 1:] * mass[:, None]
    roots = mass_sd * by_mass / total, by_center.reshape(len(value), -1) / total
    return CadPrior(value, *roots, mass_sd * float(np.linalg.norm(mass)))


def expected_standard(
    parameters: BaseParameters,
    standard: np.ndarray,
    value: np.ndarray,
    mass: float,
    scales: tuple[float, float] = (1.0, 1.0),
) -> np.ndarray:
    """Return what CAD's prior expects of links whose base parameters and total mass are known.

    It is the mean of the normal distribution under these conditions: of the changes that satisfy them, that
    which is least in the s.d. of the prior.

    Args:
        standard: by CAD, (n, 4) [kg, kg m]. value: base parameters, (p,) [m]. mass: of the robot [kg].
        scales: of the s.d. of masses and of centres.
    """
    n, own = len(standard), standard[:, 0]
    root = np.zeros((n, 4, n, 4))  # standard parameters by independent deviates of mass and centre
    link = np.arange(n)
    root[link, :, link, 0] = scales[0] * MASS_SD * standard
    for axis in (1, 2, 3):
        root[link, axis, link, axis] = scales[1] * CENTER_SD * own
    root = root.reshape(4 * n, 4 * n)
    rows = np.vstack([parameters.from_standard, np.tile([1.0, 0.0, 0.0, 0.0], n)])
    lack = mass * np.append(value, 1.0) - rows @ standard.ravel()
    deviates = np.linalg.lstsq(rows @ root, lack, rcond=RANK)[0]
    return standard + (root @ deviates).reshape(n, 4)
