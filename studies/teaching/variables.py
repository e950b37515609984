"""The quantity that explains an effect's error of the centre of pressure, for the axis of its picture."""

from collections.abc import Callable

import numpy as np

from tulip_testbed.effects.targets import plate_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements.cells import CELLS, PLATES

Variable = tuple[str, Callable[[Observation, str], np.ndarray]]


def order(observed: Observation, target: str) -> np.ndarray:
    """Return the number of every posture in the order of measurement, from 1, (m,)."""
    return np.arange(1.0, len(observed) + 1)


def height(observed: Observation, target: str) -> np.ndarray:
    """Return the height of the centre of mass over the load cells, (m,) [m]."""
    return observed.height


def torque(observed: Observation, joint: str) -> np.ndarray:
    """Return the torque of the load on a joint, (m,) [Nm]."""
    return observed.torques[:, observed.tree.joints.index(joint)]


def travel(observed: Observation, joint: str) -> np.ndarray:
    """Return how far forward the centre of mass moves when a joint turns, (m,) [mm/deg]."""
    slope = observed.nominal.parameters.slope(observed.joint_angles) @ observed.nominal.value
    return -1e3 * np.radians(slope[:, 0, observed.tree.joints.index(joint)])


def angle(observed: Observation, joint: str) -> np.ndarray:
    """Return a joint's angle, (m,) [deg]."""
    return np.degrees(observed.joint_angles[:, observed.tree.joints.index(joint)])


def foot_load(observed: Observation, joint: str) -> np.ndarray:
    """Return the vertical force on the foot of a joint's leg, (m,) [N]."""
    return plate_load(observed, plate_of(observed.nominal.robot, joint))


def plate_load(observed: Observation, plate: str) -> np.ndarray:
    """Return the vertical force on a plate, (m,) [N]."""
    return observed.foot_loads[0][:, PLATES.index(plate)]


def cell_load(observed: Observation, cell: str) -> np.ndarray:
    """Return the force on a load cell, (m,) [N]."""
    return observed.cell_forces[:, CELLS.index(cell)]


ORDER: Variable = ("posture, in the order of measurement", order)
LEVER: Variable = ("travel of the CoM when the joint turns, mm/deg", travel)
TORQUE: Variable = ("torque of the load on the joint, Nm", torque)
HEIGHT: Variable = ("height of the centre of mass, m", height)
ON_PLATE: Variable = ("force on the plate, N", plate_load)
VARIABLES: dict[str, Variable] = {
    "encoder-offset": LEVER,
    "encoder-gain": ("angle of the joint, deg", angle),
    "encoder-load": ("force on the foot of the leg, N", foot_load),
    "joint-compliance": TORQUE,
    "backlash": TORQUE,
    "logged-command": TORQUE,
    "tilt": HEIGHT,
    "payload": HEIGHT,
    "cell-gain": ("force on the load cell, N", cell_load),
    "plate-translation": ON_PLATE,
    "plate-yaw": ON_PLATE,
    "wrench-gain": ON_PLATE,
    "wrench-origin": ON_PLATE,
}
