"""A floor that yields: robot and plates turn with it, by the moment of the load on the cells."""

import numpy as np
from scipy.spatial.transform import Rotation


def gravity_on(
    floor: tuple[float, float], gravity: np.ndarray, forces: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Return gravity in the axes of the floor as the load has turned it, (..., 3) [m/s2].

    Args:
        floor: turn about x and about y by the load's moment about them [rad/(N m)].
        gravity: in the axes of the floor without load, (3,) [m/s2].
        forces: of the cells, (..., 8) [N]. places: of the cells from the foot that carries the base frame,
            (..., 8, 2) [m].
    """
    about_x, about_y = floor
    x, y = np.moveaxis((forces[..., None] * places).sum(axis=-2), -1, 0)
    # Load to the left (y > 0) turns the floor about -x, load to the front about +y.
    turn = np.stack([-about_x * y, about_y * x, np.zeros_like(x)], axis=-1)
    return Rotation.from_rotvec(-turn).apply(gravity)  # the axes turn, so that gravity turns back
