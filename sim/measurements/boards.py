"""What a plate is, and where the two boards are laid for a pair of feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PlateGeometry:
    """A plate as its data sheet describes it.

    Attributes:
        cells: the four cells' positions in the plate's frame, in the order of `CORNERS`, (4, 2) [m].
        size: the board's extent in x and y, (2,) [m].
        top_height: height of the top surface over the floor [m].
        mass: the board's own mass [kg].
    """

    cells: np.ndarray
    size: np.ndarray
    top_height: float
    mass: float


def lay_boards(soles: np.ndarray, size: np.ndarray, gap: float) -> np.ndarray:
    """Poses of two parallel boards, each under its own sole and as central to it as the other allows.

    Args:
        soles: corners of the right and the left sole in the base frame, (2, 4, 2) [m].
        size: a board's extent in x and y, (2,) [m].
        gap: least distance between the boards' long edges [m].

    Returns:
        (2, 3) [m, m, rad] in the base frame.
    """
    centres = (soles.min(axis=1) + soles.max(axis=1)) / 2
    lack = max(0.0, size[1] + gap - (centres[1, 1] - centres[0, 1]))
    return np.array(
        [[centres[0, 0], centres[0, 1] - lack / 2, 0.0], [centres[1, 0], centres[1, 1] + lack / 2, 0.0]]
    )
