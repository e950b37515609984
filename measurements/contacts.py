"""Contact sensors that measure a wrench: six-axis plates, or force-torque sensors in the feet."""

from dataclasses import dataclass

import numpy as np

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # N, Nm; of the ground on the foot, in the sensor's frame
VERTICAL = ("fz", "mx", "my")  # all that the centre of pressure on level ground needs
COP = ("x", "y", "fz")  # m, m, N: a point of the sensor's frame and the vertical force
CHANNEL_SETS = (WRENCH, VERTICAL)
POSE = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Contacts:
    """A wrench sensor under or in each foot, right and left.

    Attributes:
        mount: "ground": the sensor is a plate, and its pose is recorded with every row; "foot": it moves
            with its foot.
        channels: of each sensor, `WRENCH` or `VERTICAL`. A force is that of the ground on the foot in the
            sensor's frame, z up; a moment is about the frame's origin.
        pose: of the sensor's frame in its foot's frame, x, y, z, roll, pitch, yaw (fixed axes), (2, 6)
            [m, rad]; zero on the ground, where the frame is the plate's, at the height of its top.
        covariance: of a posture's averaged reading, (c, c) [N, Nm]; None: unknown.
        zero_sd: s.d. of the constant part of every reading, (2, c) [N, Nm]; 0: tared, infinite: unknown.
        below: mass and centre, in the foot's frame, of the part of the foot below the sensor, whose weight
            the sensor does not bear when the foot stands, (2, 4) [kg, m]; zero for a sensor in the sole.
        below_sd: their s.d., (2, 4) [kg, m].
        cop_sd: s.d. of x, y and the vertical force of devices that give no more, (2, 3) [m, m, N], NaN:
            unknown; their readings are kept as `VERTICAL` wrenches. None: wrench sensors.
        depth: of the plane to which readings refer under the plate's top [m]: its height for boards on cells,
            which are read as vertical wrenches; 0 for wrench sensors.
    """

    mount: str
    channels: tuple[str, ...]
    pose: np.ndarray
    covariance: np.ndarray | None
    zero_sd: np.ndarray
    below: np.ndarray
    below_sd: np.ndarray
    cop_sd: np.ndarray | None = None
    depth: float = 0.0


def wrenches_of_cops(cops: np.ndarray) -> np.ndarray:
    """Return centres of pressure with their vertical force as vertical wrenches, (..., 3) -> (..., 3)."""
    x, y, load = np.moveaxis(cops, -1, 0)
    return np.stack([load, y * load, -x * load], axis=-1)


def cops_of_wrenches(wrenches: np.ndarray) -> np.ndarray:
    """Return vertical wrenches as centres of pressure; NaN in all three where nothing presses."""
    load, roll, pitch = np.moveaxis(wrenches, -1, 0)
    pressed = np.where(load == 0, np.nan, load)
    return np.stack([-pitch / pressed, roll / pressed, pressed], axis=-1)


def covariance_of_cops(cops: np.ndarray, sd: np.ndarray, stands: np.ndarray) -> np.ndarray | None:
    """Return the covariance of both contacts' vertical wrenches, (3, 3) [N, Nm]; None: unknown.

    It depends on the load: it is taken at each contact's mean load and point, and both get the mean.

    Args:
        cops: right and left, (m, 2, 3). sd: their s.d., (2, 3); NaN: unknown.
        stands: whether each foot is on the ground, (m, 2) bool.
    """
    found = []
    for side in (0, 1):
        if stands[:, side].any() and not np.isnan(sd[side]).any():
            x, y, load = cops[stands[:, side], side].mean(axis=0)
            slope = np.array([[0.0, 0.0, 1.0], [0.0, load, y], [-load, 0.0, -x]])
            found.append(slope * np.square(sd[side]) @ slope.T)
    return np.mean(found, axis=0) if found else None
