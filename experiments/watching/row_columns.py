"""The residuals of single postures, and how they change with the state and with faults.

No posture depends on another: the columns of one row are the same, computed alone or among others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.calibration.linear_model import nuisances
from tulip_testbed.calibration.linearisation import SYSTEMATIC
from tulip_testbed.calibration.member_columns import STEP, member_columns
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.identification.inertial_wrench import acceleration_sd, by_accelerations
from tulip_testbed.identification.joint_loads import UNSEEN
from tulip_testbed.identification.noise_in_time import WHITE
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ANCHORED,
    ROWS,
    SIZE,
    constants_of_stances,
    difference,
    fields,
    residuals,
    residuals_in_use,
    sensitivity,
)
from tulip_testbed.identification.residual_noise import floor
from tulip_testbed.measurements import Measurements

# Size of the wrench between the feet that no cell shows, over that of `UNSEEN`: friction differs between
# postures, and the compliances by which it acts are anything up to two tolerances.
FRICTION = 2.0
INERTIAL = 0.05  # of the inertial forces that is noise; what a calibration of a simulated motion found


@dataclass(frozen=True)
class RowColumns:
    """Residuals of m postures, linear about the robot by CAD.

    Attributes:
        residual: at CAD's base parameters, swing foot relative to its planned place, (m, 11).
        used: residuals that hold information, (m, 11) bool.
        state: derivative by the state, (m, 11, n).
        faults: change by one plausible size of each direction, (m, 11, c).
        by_angles: derivative by the joint angles, (m, 11, j).
        slope: change of its first two rows with the base parameters, (m, 2, j, p).
        angles: change of the angles' readings by the state, (m, j, n).
        fault_angles: the same by the faults, (m, j, c).
        pushed: change of the angles by one s.d. of the wrench that no cell shows, (m, j, 3).
        cells: covariance of the residuals by the cells, (m, 11, 11).
    """

    residual: np.ndarray
    used: np.ndarray
    state: np.ndarray
    faults: np.ndarray
    by_angles: np.ndarray
    slope: np.ndarray
    angles: np.ndarray
    fault_angles: np.ndarray
    pushed: np.ndarray
    cells: np.ndarray

    def row(self, k: int) -> RowColumns:
        """Return one row, without the axis of rows."""
        return RowColumns(**{name: values[k] for name, values in vars(self).items()})

    def about(self, theta: np.ndarray) -> RowColumns:
        """Return a row linearised about other base parameters, theta less CAD's, (p,) [m]."""
        turn = self.slope @ theta
        by_angles, state, faults = self.by_angles.copy(), self.state.copy(), self.faults.copy()
        by_angles[..., :2, :] -= turn
        state[..., :2, :] -= turn @ self.angles
        faults[..., :2, :] -= turn @ self.fault_angles
        return replace(self, by_angles=by_angles, state=state, faults=faults)

    def without_twist(self, rows: np.ndarray) -> RowColumns:
        """Return rows without the twists that are unreliable, (..., 2) bool."""
        used = self.used.copy()
        used[..., ROWS["T"]] &= ~rows
        names = ("state", "faults", "by_angles")
        kept = {name: getattr(self, name) * used[..., None] for name in names}
        return replace(self, used=used, residual=self.residual * used, **kept)

    def noise(self, encoder: float, share: float = 1.0) -> np.ndarray:
        """Return the covariance of the residuals by the share of it that does not last, (..., 11, 11)."""
        pushed = self.by_angles @ self.pushed
        own = encoder**2 * self.by_angles @ self.by_angles.swapaxes(-1, -2)
        own = own + self.cells + pushed @ pushed.swapaxes(-1, -2)
        both = self.used[..., :, None] & self.used[..., None, :]
        return np.where(both, share * own, np.eye(SIZE))


def row_columns(model: DayModel, rows: Measurements, errors: np.ndarray | None = None) -> RowColumns:
    """Compute the columns of some postures of a day.

    Args:
        errors: of the cells, (m, 8) [N], which the residuals have and the columns should not; None: unknown.
            Columns of gains would be correlated with the noise otherwise, by a little in every row.
    """
    seen, m, p = model.observe(rows), len(rows), model.parameters
    at, theta, noise = fields(seen), model.nominal.value, model.noise
    used, left = residuals_in_use(seen), residuals(seen, theta)
    left[:, ANCHORED] -= model.plan.swing_pose[model.first_rows(rows)]
    left[:, -1] = np.arctan2(np.sin(left[:, -1]), np.cos(left[:, -1]))
    if errors is not None:
        seen = seen.changed(cell_forces=seen.cell_forces - errors)
    reach = sensitivity(seen, theta)
    joints, inside = at["angles"].stop, used[..., None]
    members, member_angles = _families(model, seen, theta, reach)
    faults, fault_angles = _faults(model, seen, reach)
    by_cells, by_angles = reach[..., at["cells"]], reach[..., at["angles"]]
    friction = FRICTION if model.held else SYSTEMATIC
    pushed = model.unseen[:, None] * seen.loads.levers * friction * UNSEEN
    cells, lasting, slow = noise.cell**2 * by_cells @ by_cells.mT + floor(noise), [], np.zeros((m, joints, 0))
    if not model.held:
        forces = slice(at["shift"].start, at["push"].stop)
        inertia = INERTIAL * reach[..., forces] @ seen.motion.by_cad[..., None]
        sd = acceleration_sd(rows, noise.encoder, WHITE)[:, None]
        shaken = reach[..., forces] @ by_accelerations(seen.geometry, rows) * sd
        cells = cells + inertia @ inertia.mT + shaken @ shaken.mT
        # What the errors that last change in angles and residuals.
        read = np.broadcast_to(noise.encoder * np.eye(joints), (m, joints, joints))
        slow = np.concatenate([read, pushed], axis=2)
        lasting = [by_angles @ slow, inertia, noise.cell * by_cells]
    plates, stance = reach[..., at["plates"]] * noise.plates, constants_of_stances(used)
    state = np.concatenate([-nuisances(seen, "AFTC"), members, *lasting, plates, stance], axis=2)
    angles = np.zeros((m, joints, state.shape[2]))
    angles[..., p + 1 : p + 1 + members.shape[2]] = member_angles
    first = model.lasting.start
    angles[..., first : first + slow.shape[2]] = slow
    return RowColumns(
        residual=np.where(used, left, 0.0),
        used=used,
        state=state * inside,
        faults=faults * inside,
        by_angles=by_angles * inside,
        slope=seen.geometry.slope,
        angles=angles,
        fault_angles=fault_angles,
        pushed=pushed,
        cells=cells,
    )


def _families(
    model: DayModel, seen: Observation, theta: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the residuals and the angles by the deviates of all members, (m, 11, k), (m, j, k)."""
    columns, angles = [np.zeros((len(seen), SIZE, 0))], [np.zeros((*seen.joint_angles.shape, 0))]
    for family in model.families:
        columns.append(member_columns(seen, theta, reach, family))
        sizes = STEP * family.steps
        members = [family.single(number, size) for number, size in enumerate(sizes.tolist())]
        after = [one.effect.remove(seen, one.target, one.values).joint_angles for one in members]
        angles.append((seen.joint_angles[..., None] - np.stack(after, axis=-1)) / sizes)
    return np.concatenate(columns, axis=2) @ model.mixing, np.concatenate(angles, axis=2) @ model.mixing


def _faults(model: DayModel, seen: Observation, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the change of residuals and angles by one plausible size of each direction."""
    begun = seen.changed(time_fraction=np.ones(len(seen)))
    changes = []
    for fault in model.faults:
        sizes = tuple(STEP * value for value in fault.values)
        changes.append(difference(begun, fault.effect.remove(begun, fault.target, sizes)) / STEP)
    every = np.stack([*changes, *(changes[k] for k in model.growing)], axis=2)
    return -reach @ every, -every[:, : seen.joint_angles.shape[1]]
