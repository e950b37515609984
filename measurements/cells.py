"""Two plates on four cells each: names of the cells, geometry of a plate, and where two boards lie."""

from dataclasses import dataclass

import numpy as np

CORNERS = ("front_left", "front_right", "rear_right", "rear_left")
SIGNS = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])  # of x and y of each corner
PLATES = ("right", "left")
CELLS = tuple(f"{plate}.{corner}" for plate in PLATES for corner in CORNERS)


@dataclass(frozen=True)
class PlateGeometry:
    """Geometry of a plate as on its data sheet.

    Attributes:
        cells: positions of the four cells in the plate's frame, in the order of `CORNERS`, (4, 2) [m].
        size: extent of the board in x and y, (2,) [m].
        top_height: height of the top surface over the floor [m].
        mass: mass of the board [kg].
    """

    cells: np.ndarray
    size: np.ndarray
    top_height: float
    mass: float

    @property
    def corners(self) -> np.ndarray:
        """Return the corners of the board in the plate's frame, in the order of `CORNERS`, (4, 2) [m]."""
        return self.size / 2 * SIGNS


def lay_boards(soles: np.ndarray, size: np.ndarray, gap: float) -> np.ndarray:
    """Place two parallel boards, each under its sole and as central to it as the other board allows.

    Args:
        soles: corners of the right and the left sole in the base frame, (2, 4, 2) [m].
        size: extent of a board in x and y, (2,) [m].
        gap: smallest distance between the boards' long edges [m].

    Returns:
        Poses of the right and the left board in the base frame, (2, 3) [m, m, rad].
    """
    centres = (soles.min(axis=1) + soles.max(axis=1)) / 2
    lack = max(0.0, size[1] + gap - (centres[1, 1] - centres[0, 1]))
    return np.array(
        [[centres[0, 0], centres[0, 1] - lack / 2, 0.0], [centres[1, 0], centres[1, 1] + lack / 2, 0.0]]
    )
