"""Covariance of residuals that postures of a placement share, and of constants that nobody knows.

V_0 = blocks of single postures + L L' within a placement, L what a recorded plate's error changes. The swing
foot's place is known up to a constant of each stance: columns Z of flat parameters. Without them the inverse
is

    Q = A^-1 - U (Z' U)^-1 U',  U = A^-1 Z,        W = Q - Q L (I + L' Q L)^-1 L' Q,

of blocks of a posture's size (Woodbury). Half of ln|A| + ln|Z' U| + ln|I + L' Q L| is V_0's part of the
restricted likelihood (Patterson and Thompson 1971) with Z among its columns, up to a constant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import get_blas_funcs
from scipy.sparse import csr_array

LEAST_AT_ONCE, MOST_NUMBERS = 32, 100_000  # columns, numbers: more of them leave the cache

of_triangle = get_blas_funcs("trmm")  # a product with a triangle: half of the work of a whole one


@dataclass(frozen=True)
class Groups:
    """Postures that belong together: placements, or stances.

    Attributes:
        number: of each posture's group, from 0, (m,).
    """

    number: np.ndarray

    def __len__(self) -> int:
        """Return the number of groups."""
        return int(self.number.max()) + 1

    @cached_property
    def _sums(self) -> csr_array:
        m = len(self.number)
        return csr_array((np.ones(m), (self.number, np.arange(m))))

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum over the postures of each group, (m, ...) -> (g, ...)."""
        flat = self._sums @ values.reshape(len(values), int(np.prod(values.shape[1:])))
        return flat.reshape(len(flat), *values.shape[1:])


@dataclass(frozen=True)
class NoiseStructure:
    """Covariance of the residuals, r of each of m postures, by scales of the noise.

    Attributes:
        placement, stance: groups of postures. A stance lies within a placement.
        fixed: covariance that no scale changes, by posture, (m, r, r); 1 on the diagonal of residuals that
            are not in use.
        own: covariance by each scale that postures do not share, (k, m, r, r).
        shared: change of the residuals by one s.d. of what a placement's postures share, (m, r, s).
        owner: number of the scale of each column of `shared`, (s,); they follow those of `own`.
        free: columns of the constants of a stance, (m, r, c).
    """

    placement: Groups
    stance: Groups
    fixed: np.ndarray
    own: np.ndarray
    shared: np.ndarray
    owner: np.ndarray
    free: np.ndarray

    def __len__(self) -> int:
        """Return the number of scales."""
        return max([len(self.own), *(1 + self.owner)])

    def varies(self) -> np.ndarray:
        """Return which residuals have any noise in any posture, (r,) bool."""
        plain = np.eye(self.fixed.shape[1])
        out = (self.fixed != plain).any(axis=(0, 2)) | self.own.any(axis=(0, 1, 3))
        return out | self.shared.any(axis=(0, 2)) | self.free.any(axis=(0, 2))

    def take(self, used: np.ndarray) -> NoiseStructure:
        """Return the covariance of some residuals of every posture, (r,) bool."""
        return replace(
            self,
            fixed=np.compress(used, self.fixed[:, used], axis=2),
            own=np.compress(used, self.own[:, :, used], axis=3),
            shared=np.compress(used, self.shared, axis=1),
            free=np.compress(used, self.free, axis=1),
        )

    def weights(self, log_scale: np.ndarray) -> Weights:
        """Return the inverse of the covariance at scales of the noise.

        Args:
            log_scale: natural logarithms, (number of scales,).
        """
        square = np.exp(2 * log_scale)
        alone = self.fixed + np.tensordot(square[: len(self.own)], self.own, axes=1)
        levers = self.shared * np.exp(log_scale)[self.owner]
        inverse, root, log_volume = _inverted(alone)
        on_free = inverse @ self.free
        of_free, free_root, volume = _inverted(self.stance.sums(self.free.mT @ on_free))
        log_volume += volume
        free_weights = on_free @ of_free[self.stance.number]
        on_levers = inverse @ levers
        on_levers -= free_weights @ self.stance.sums(self.free.mT @ on_levers)[self.stance.number]
        inner = self.placement.sums(levers.mT @ on_levers)
        of_levers, lever_root, volume = _inverted(np.eye(levers.shape[2]) + inner)
        log_volume += volume
        return Weights(
            structure=self,
            square=square,
            inverse=inverse,
            roots=(root, free_root, lever_root),
            on_free=on_free,
            free_weights=free_weights,
            levers=levers,
            on_levers=on_levers,
            lever_weights=on_levers @ of_levers[self.placement.number],
            of_levers=inner @ of_levers,
            log_volume=float(log_volume),
        )


@dataclass(frozen=True)
class Weights:
    """The inverse W of the covariance of the noise, without the constants of the stances.

    Attributes:
        square: of the scales. inverse: A^-1, by posture, (m, r, r).
        roots: H with H' H = A^-1, (m, r, r), (Z' A^-1 Z)^-1, (g, c, c), and (I + L' Q L)^-1, (g, s, s).
        on_free: A^-1 Z; free_weights: the same times (Z' A^-1 Z)^-1, (m, r, c).
        levers: L. on_levers: Q L; lever_weights: the same times (I + L' Q L)^-1, (m, r, s).
        of_levers: L' W L by placement, (g, s, s).
        log_volume: half the logarithm of the determinants.
    """

    structure: NoiseStructure
    square: np.ndarray
    inverse: np.ndarray
    roots: tuple[np.ndarray, np.ndarray, np.ndarray]
    on_free: np.ndarray
    free_weights: np.ndarray
    levers: np.ndarray
    on_levers: np.ndarray
    lever_weights: np.ndarray
    of_levers: np.ndarray
    log_volume: float

    def __call__(self, columns: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Return W times columns, (m, r, n), in place of `out`, which may be the columns themselves."""
        stance, placement = self.structure.stance, self.structure.placement
        m, rows, count = columns.shape
        out = np.empty_like(columns) if out is None else out
        at_once = max(LEAST_AT_ONCE, MOST_NUMBERS // (m * rows))
        for first in range(0, count, at_once):
            some = columns[..., first : first + at_once]
            part = self.inverse @ some
            part -= self.free_weights @ stance.sums(self.on_free.mT @ some)[stance.number]
            part -= self.lever_weights @ placement.sums(self.on_levers.mT @ some)[placement.number]
            out[..., first : first + at_once] = part
        return out

    def gram(self, columns: np.ndarray) -> np.ndarray:
        """Return X' W X of columns X, (m, r, n) -> (n, n): half of the work of X' times `W X`."""
        stance, placement = self.structure.stance, self.structure.placement
        root, free_root, lever_root = self.roots
        m, rows, width = columns.shape
        out = np.zeros((width, width))
        for first in range(0, m, at_once := max(MOST_NUMBERS // (rows * width), 1)):
            some = slice(first, first + at_once)
            white = (root[some] @ columns[some]).reshape(-1, width)
            out += white.T @ white
        of_stances = free_root @ stance.sums(self.on_free.mT @ columns)
        of_placements = lever_root @ placement.sums(self.on_levers.mT @ columns)
        for shared in (of_stances.reshape(-1, width), of_placements.reshape(-1, width)):
            out -= shared.T @ shared
        return out

    @cached_property
    def of_postures(self) -> np.ndarray:
        """Return the blocks of W of single postures, (m, r, r)."""
        return self.inverse - self.free_weights @ self.on_free.mT - self.lever_weights @ self.on_levers.mT

    def parts(self, columns: np.ndarray) -> Iterator[np.ndarray]:
        """Yield sigma_k^2 K_k times columns (m, r, n) for every scale."""
        structure = self.structure
        for square, kernel in zip(self.square, structure.own, strict=False):
            yield square * (kernel @ columns)
        for k in range(len(structure.own), len(structure)):
            levers = self.levers[..., structure.owner == k]
            yield levers @ structure.placement.sums(levers.mT @ columns)[structure.placement.number]

    def traces(self, columns: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return traces that the first and second derivatives of a likelihood need, Q = W - W X T T' X' W.

        Args:
            columns: X, (m, r, n), and others that are not in use.
            half: T, (n, n), an upper triangle.

        Returns:
            the trace of sigma_k^2 K_k Q for every scale, (k,), and of sigma_k^2 K_k Q sigma_l^2 K_l Q for
            all pairs of those of `shared`, (h, h).
        """
        structure, n = self.structure, len(half)
        m, rows, width = columns.shape
        half = np.pad(half, (0, width - n))
        across = of_triangle(1.0, half, columns.reshape(-1, width).T, trans_a=1).T.reshape(m, rows, width)
        across = self(across, out=across)
        left = self.of_postures - across @ across.mT
        out = [
            square * float(np.vdot(kernel, left))
            for square, kernel in zip(self.square, structure.own, strict=False)
        ]
        seen = structure.placement.sums(self.levers.mT @ across)
        of_seen = seen @ seen.mT
        belongs = (structure.owner == np.arange(len(structure.own), len(structure))[:, None]).astype(float)
        each = np.diagonal(self.of_levers - of_seen, axis1=1, axis2=2)
        # W X T T' X' W joins placements, W does not.
        within = (self.of_levers * (self.of_levers - 2 * of_seen)).sum(axis=0)
        flat = [seen[:, one > 0].reshape(-1, width) for one in belongs]
        joined = np.array([(one.T @ one).ravel() for one in flat]).reshape(len(flat), width**2)
        within = belongs @ within @ belongs.T
        return np.array([*out, *(belongs @ each.sum(axis=0))]), within + joined @ joined.T


def _inverted(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Invert positive definite matrices (g, n, n), zero rows by 1.

    Returns:
        inverses, their roots H with H' H, and half of ln of the matrices' volume.
    """
    diagonal = np.einsum("gnn->gn", matrices)
    diagonal[diagonal == 0] = 1.0
    unit = 1 / np.sqrt(diagonal)
    both = unit[:, :, None] * unit[:, None]
    lower = np.linalg.cholesky(matrices * both)
    pivots = np.diagonal(lower, axis1=1, axis2=2)
    # By substitution in all matrices at once: numpy inverts one by one.
    inverse_root = np.zeros_like(lower)
    for k, row in enumerate(np.moveaxis(lower / pivots[..., None], 1, 0)):
        inverse_root[:, k, :k] = -(row[:, None, :k] @ inverse_root[:, :k, :k])[:, 0]
        inverse_root[:, k, k] = 1 / pivots[:, k]
    inverse = inverse_root.mT @ inverse_root * both
    return inverse, inverse_root * unit[:, None], float(np.log(pivots / unit).sum())


def groups(number: np.ndarray) -> Groups:
    """Return the groups of postures of the same number, (m,)."""
    return Groups(np.unique(number, return_inverse=True)[1])
