"""Link masses that static measurements can determine, for any postures and sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.rank import reduced_basis

RELATIVE = 1e-9


@dataclass(frozen=True)
class IdentifiableMasses:
    """Combinations of link masses that base parameters and total mass determine.

    Attributes:
        links: names of the links, (n,).
        combinations: weights of the masses in each combination, (k, n); the total mass is one of them.
    """

    links: tuple[str, ...]
    combinations: np.ndarray

    @property
    def alone(self) -> tuple[str, ...]:
        """Return the links whose own mass is determined."""
        single = self.combinations[(np.abs(self.combinations) > RELATIVE).sum(axis=1) == 1]
        return tuple(self.links[k] for k in np.flatnonzero((np.abs(single) > RELATIVE).any(axis=0)))

    @property
    def sentence(self) -> str:
        """Return the result as a sentence."""
        count = len(self.combinations)
        if count == 1:
            return (
                "The measurements determine the total mass but no single link mass; "
                "link masses are those of the prior, adjusted."
            )
        known = f" ({', '.join(self.alone)} alone)" if self.alone else ""
        return (
            f"The measurements determine {count} combinations of the {len(self.links)} link masses{known}; "
            "everything else about the masses comes from the prior."
        )


def identifiable_masses(parameters: BaseParameters) -> IdentifiableMasses:
    """Find the combinations of masses that do not depend on any centre of mass, structurally.

    A combination w'm is determined if it is constant under every change of the standard parameters that
    leaves base parameters and total mass unchanged.
    """
    links = parameters.tree.links
    total = np.zeros((len(links), 4))
    total[:, 0] = 1.0
    determined = np.vstack([parameters.from_standard, total.ravel()])
    _, size, turned = np.linalg.svd(determined)
    rank = int((size > RELATIVE * size[0]).sum())
    free = turned[rank:].reshape(-1, len(links), 4)[:, :, 0]  # masses in the undetermined directions
    if not len(free):
        return IdentifiableMasses(links, np.eye(len(links)))
    _, size, turned = np.linalg.svd(free)
    rank = int((size > RELATIVE).sum())
    return IdentifiableMasses(links, reduced_basis(turned[rank:]))
