"""Which link masses static measurements can give at all, whatever the postures and the sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.rank import reduced_basis

RELATIVE = 1e-9


@dataclass(frozen=True)
class VisibleMasses:
    """Combinations of link masses that base parameters and total mass determine.

    Attributes:
        links: names, (n,).
        combinations: their weights, (k, n), the total mass among them.
    """

    links: tuple[str, ...]
    combinations: np.ndarray

    @property
    def alone(self) -> tuple[str, ...]:
        """Links whose own mass is determined."""
        single = self.combinations[(np.abs(self.combinations) > RELATIVE).sum(axis=1) == 1]
        return tuple(self.links[k] for k in np.flatnonzero((np.abs(single) > RELATIVE).any(axis=0)))

    @property
    def words(self) -> str:
        """In a sentence."""
        count = len(self.combinations)
        if count == 1:
            return "Statics gives the total mass and no single link's: those are the prior's, adjusted."
        known = f" ({', '.join(self.alone)} alone)" if self.alone else ""
        return (
            f"Statics gives {count} combinations of the {len(self.links)} links' masses{known}; "
            "the rest of a mass is the prior's."
        )


def visible_masses(parameters: BaseParameters) -> VisibleMasses:
    """The combinations of masses that do not depend on any centre of mass, structurally.

    A combination w'm is determined if it vanishes on every change of the standard parameters that
    base parameters and total mass do not show.
    """
    links = parameters.tree.links
    total = np.zeros((len(links), 4))
    total[:, 0] = 1.0
    shown = np.vstack([parameters.from_standard, total.ravel()])
    _, size, turned = np.linalg.svd(shown)
    rank = int((size > RELATIVE * size[0]).sum())
    free = turned[rank:].reshape(-1, len(links), 4)[:, :, 0]  # masses in the unseen changes
    if not len(free):
        return VisibleMasses(links, np.eye(len(links)))
    _, size, turned = np.linalg.svd(free)
    rank = int((size > RELATIVE).sum())
    return VisibleMasses(links, reduced_basis(turned[rank:]))
