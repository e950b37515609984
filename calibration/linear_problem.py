"""The linear model of which a restricted likelihood is taken."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

from tulip_testbed.identification.noise_in_time import Decorrelation
from tulip_testbed.identification.noise_structure import NoiseStructure

# Of the information about members, in any direction, that counts as noise of the columns. Half, as for
# estimates without a prior (Fuller 1987, ch. 2.5), left too much: at it, 92 % of the intervals of compliances
# held in 84 development laboratories, 93 % at 0.9 or 1.
MOST_EXCESS = 0.9


@dataclass(frozen=True)
class LinearProblem:
    """A linear model of r residuals of each of m postures.

    Attributes:
        whole: N, G and y side by side, (m, r, p + q + 1); zero in rows that are not in use.
        flat: p, the number of columns of N.
        noise: V_0, of k scales.
        information: of nu, known beforehand with mean zero, (p, p); with CAD as prior, nu is the difference
            from it.
        sizes: number of members of each family, together q; theirs are the variances tau_f^2.
        doubt: s.d. of ln sigma about zero, (k,).
        excess: what the noise in the columns adds to G' V_0^-1 G on average, (q, q).
        about: members at which y was linearised, (q,); there the noise of the columns has no effect.
        in_time: what makes the noise of postures uncorrelated; None: it is. `noise` is that of its result.
        known: numbers of the families whose spread is known, tau = 1.
        most_excess: share of the information about members, in any direction, that may be excess.
    """

    whole: np.ndarray
    flat: int
    noise: NoiseStructure
    information: np.ndarray
    sizes: tuple[int, ...]
    doubt: np.ndarray
    excess: np.ndarray
    about: np.ndarray
    known: tuple[int, ...] = ()
    in_time: Decorrelation | None = None
    most_excess: float = MOST_EXCESS

    @property
    def columns(self) -> np.ndarray:
        """Return N, (m, r, p)."""
        return self.whole[..., : self.flat]

    @property
    def members(self) -> np.ndarray:
        """Return G, (m, r, q)."""
        return self.whole[..., self.flat : -1]

    @property
    def output(self) -> np.ndarray:
        """Return y, (m, r)."""
        return self.whole[..., -1]

    @property
    def parts(self) -> list[slice]:
        """Return the columns of G that belong to each family."""
        ends = np.cumsum([0, *self.sizes]).tolist()
        return [slice(a, b) for a, b in pairwise(ends)]

    def decorrelated(self) -> Self:
        """Return the same problem with noise that is uncorrelated in time."""
        if self.in_time is None:
            return self
        noise = replace(
            self.noise, shared=self.in_time(self.noise.shared), free=self.in_time(self.noise.free)
        )
        return replace(self, whole=self.in_time(self.whole), noise=noise, in_time=None)

    def in_use(self) -> tuple[Self, np.ndarray]:
        """Return the problem without the residuals that no posture uses and members that no residual shows.

        Returns:
            the problem, and which unknowns it has, (p + q,) bool. Members of an unknown spread all stay.
        """
        if self.in_time is not None:
            return self.decorrelated().in_use()
        used = self.whole.any(axis=(0, 2)) | self.noise.varies()
        whole = self.whole if used.all() else np.compress(used, self.whole, axis=1)
        own = np.repeat(~np.isin(np.arange(len(self.sizes)), self.known), self.sizes)
        shown = whole[..., self.flat : -1].any(axis=(0, 1)) | self.excess.any(axis=0) | own
        noise = self.noise if used.all() else self.noise.take(used)
        columns = np.concatenate([np.ones(self.flat, bool), shown, [True]])
        small = replace(
            self,
            whole=whole if shown.all() else np.compress(columns, whole, axis=2),
            noise=noise,
            sizes=tuple(int(shown[part].sum()) for part in self.parts),
            excess=self.excess[shown][:, shown],
            about=self.about[shown],
        )
        return small, columns[:-1]
