"""How the static loads of joints and soles change with the readings of the cells and the plates' poses."""

import numpy as np

from tulip_testbed.identification.observation import Observation

PLATES = 6  # x, y and yaw of the right and the left plate, after the readings of the contacts


def load_rates(observed: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the loads by the readings of the cells and the plates' poses.

    The first are the torques of the joints, (m, n_joints, 2 k + 6), the second the load of both soles about x
    and y of the foot, (m, 2, 2, 2 k + 6), as `Observation.sole_loads`.
    """
    loads, (down, point) = observed.loads, observed.foot_loads
    m, lever = len(observed), point - observed.contact_poses[..., :2]
    k = observed.cell_forces.shape[1] // 2
    turned = np.stack([-lever[..., 1], lever[..., 0]], axis=-1)
    # Points of the load by the plates: with x and y of its plate, and about its origin.
    points = np.zeros((m, 2, 2, 2, 3))
    for foot in (0, 1):
        points[:, foot, :, foot, :2] = np.eye(2)
        points[:, foot, :, foot, 2] = turned[:, foot]
    points = points.reshape(m, 4, PLATES)
    torques, wrench = (
        np.concatenate([by[..., : 2 * k], by[..., 2 * k :] @ points], axis=2)
        for by in (loads.torques_by, loads.wrench_by)
    )
    moments = np.zeros((m, 2, 2, 2 * k + PLATES))
    place, turn = observed.swing_sole
    cells = observed.cell_places.reshape(m, 2, k, 2).mT
    moments[:, 0, :, :k] = cells[:, 0]
    moments[:, 1, :, k : 2 * k] = cells[:, 1] - place[:, :2, None] * observed.contacts.bears[1]
    moments[..., 2 * k :] = down[..., None, None] * points.reshape(m, 2, 2, PLATES)
    moments[:, 1] = _into_the_foot(turn) @ moments[:, 1]
    for foot, (center, bears) in enumerate(
        zip(observed.nominal.sole_centers, observed.contacts.bears, strict=True)
    ):
        moments[:, foot, :, foot * k : (foot + 1) * k] -= np.outer(center, bears)
    return torques, moments + soles_by_wrench(observed) @ wrench[:, None]


def soles_by_wrench(observed: Observation) -> np.ndarray:
    """Differentiate the load of both soles by the internal wrench, (m, 2, 2, 3); see `load_rates`."""
    out = np.zeros((len(observed), 2, 2, 3))
    both = observed.depth * (observed.measurements.support == "double")[:, None, None]
    out[:, 0, :, :2] = -both * np.eye(2)
    out[:, 1, :, :2] = both * _into_the_foot(observed.swing_sole[1])
    return out


def _into_the_foot(turn: np.ndarray) -> np.ndarray:
    """Return the rotations about z into the axes of a foot turned like this, (m, 3, 3) -> (m, 2, 2)."""
    yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
