"""Known masses on the robot, which are part of the nominal model in the rows of their experiments."""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import look_up
from tulip_testbed.identification.nominal import PostureGeometry
from tulip_testbed.measurements import Measurements


@dataclass(frozen=True)
class Ballast:
    """The known masses of every row.

    Attributes:
        ratio: of their weight to that of the robot, (m,).
        place: their centre of mass times `ratio`, in the base frame, (m, 2) [m].
        slope: derivative of `place` by the joint angles, (m, 2, n_joints) [m/rad].
        moment: their centre of mass times `ratio`, also in the base frame where `place` is seen from the
            stance sole, (m, 3) [m].
    """

    ratio: np.ndarray
    place: np.ndarray
    slope: np.ndarray
    moment: np.ndarray

    def without(self, center: np.ndarray) -> np.ndarray:
        """Return the robot's own centre of mass from that of robot and masses, (m, 2) [m]."""
        return center * (1 + self.ratio)[:, None] - self.place

    def together(self, center: np.ndarray) -> np.ndarray:
        """Return the centre of mass of robot and masses from the robot's own, (m, 2) [m]."""
        return (center + self.place) / (1 + self.ratio)[:, None]

    def loaded(self, center: np.ndarray) -> np.ndarray:
        """Return the centre of mass of robot and masses from the robot's own, (m, 3) [m]."""
        return (center + self.moment) / (1 + self.ratio)[:, None]


def known_weight(measurements: Measurements) -> np.ndarray:
    """Return the weight of the known masses in every row, (m,) [N]."""
    if not measurements.experiments:
        return np.zeros(len(measurements))
    each = [one.arrangement.known_mass for one in measurements.experiments]
    return measurements.gravity * np.array(each)[measurements.of_experiment]


def ballast_of(measurements: Measurements, geometry: PostureGeometry, weight: float) -> Ballast | None:
    """Return the known masses of joined experiments on a robot of a weight [N], None if there are none."""
    weights = known_weight(measurements)
    if not weights.any():
        return None
    tree, m = geometry.tree, len(weights)
    rotations, origins = geometry.frames
    aloft = geometry.on_swing_foot  # there the centre is seen from the stance sole, see `center`
    place, slope = np.zeros((m, 2)), np.zeros((m, 2, len(tree.joints)))
    moment = np.zeros((m, 3))
    for k, experiment in enumerate(measurements.experiments):
        rows = np.flatnonzero(measurements.of_experiment == k)
        for one in experiment.arrangement.masses:
            look_up("link", one.link, tree.links, "manipulations: known mass")
            frame = tree.frame(one.link)
            ratio = one.mass * measurements.gravity / weight
            at = origins[rows, frame] + rotations[rows, frame] @ np.array(one.place)
            moment[rows] += ratio * at
            place[rows] += ratio * at[:, :2]
            axes = geometry.axes[rows] * geometry.moved[:, frame, None]
            turned = np.cross(axes, at[:, None] - geometry.pivots[rows])
            slope[rows] += ratio * turned[..., :2].mT
            if aloft[rows].any():
                seen = aloft[rows][:, None]
                place[rows] -= ratio * np.where(seen, geometry.stance_sole[rows, :2], 0.0)
                slope[rows] -= ratio * np.where(seen[..., None], geometry.stance_sole_slope[rows, :2], 0.0)
    return Ballast(weights / weight, place, slope, moment)
