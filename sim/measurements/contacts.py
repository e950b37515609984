"""Contact sensors that measure a wrench: six-axis plates, or force-torque sensors in the feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # N, Nm; of the ground on the foot, in the sensor's frame
VERTICAL = ("fz", "mx", "my")  # all that the centre of pressure on level ground needs
CHANNEL_SETS = (WRENCH, VERTICAL)
MOUNTS = ("ground", "foot")
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
    """

    mount: str
    channels: tuple[str, ...]
    pose: np.ndarray
    covariance: np.ndarray | None
    zero_sd: np.ndarray
    below: np.ndarray
    below_sd: np.ndarray
