"""What the plates bear in an equilibrium, and why a posture could not be used."""

from __future__ import annotations

import numpy as np

from tulip_testbed.sim.robot import CELLS, CORNERS
from tulip_testbed.sim.statics.forces import Load, State, board_wrench
from tulip_testbed.sim.statics.mechanism import Mechanism

LEAST_LOAD = 1e-6  # N
TWIST = np.array([1.0, -1.0, 1.0, -1.0])


def cell_forces(mechanism: Mechanism, state: State, load: Load) -> np.ndarray:
    """Tared forces of the eight cells, (..., 8) [N].

    A rigid board on four equal springs shares its load bilinearly; where a cell would have to
    pull, it reads nothing and three carry the board.
    """
    sides = []
    for side, own in enumerate(mechanism.plate_weight):
        wrench, foot = state.wrench[..., side, :], load.feet[..., side, :]
        down, tip = board_wrench(mechanism, wrench, foot, load.plates[..., side, :])
        x, y = mechanism.cells[side].T
        forces = own + down[..., None] / 4 + tip[..., 1:] * x / (x @ x) - tip[..., :1] * y / (y @ y)
        lack = np.maximum(-forces, 0.0)
        worst = lack.argmax(axis=-1)[..., None]
        forces = forces + np.take_along_axis(lack, worst, -1) * TWIST[worst] * TWIST
        sides.append(forces - own)
    return np.concatenate(sides, axis=-1)


def faults(
    mechanism: Mechanism, state: State, load: Load, cells: np.ndarray, feet: tuple[str, str]
) -> np.ndarray:
    """Why a posture would not stand as it should, or "", (...,) of text.

    A sole stands flat while its centre of pressure is inside its corners, a board while no cell
    but one would have to pull, a foot does not slide while force and torsion are inside the limit
    surface (as in `sim.dynamics.stiction`).

    Args:
        cells: tared forces, (..., 8) [N]. feet: their names.
    """
    m, reason = mechanism, np.full(cells.shape[:-1], "", dtype=object)
    for side, foot in enumerate(feet):
        force, moment = state.wrench[..., side, :3], state.wrench[..., side, 3:]
        press = np.maximum(force[..., 2], LEAST_LOAD)
        center = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) / press[..., None]
        yaw = load.feet[..., side, 2]
        c, s = np.cos(yaw), np.sin(yaw)  # from the world's axes to the sole's
        x, y = center[..., 0], center[..., 1]
        center = np.stack([c * x + s * y, c * y - s * x], axis=-1)
        arms = np.sqrt(((m.corners[side] - center[..., None, :]) ** 2).sum(axis=-1))
        low, high = m.corners[side].min(axis=0), m.corners[side].max(axis=0)
        lost = ((center < low) | (center > high)).any(axis=-1) | (force[..., 2] <= LEAST_LOAD)
        lost &= load.stands[..., side]
        names = np.array([f"lost sole corner {foot}_{corner}" for corner in CORNERS], dtype=object)
        reason = np.where(lost & (reason == ""), names[arms.argmax(axis=-1)], reason)
        twist = moment[..., 2] - x * force[..., 1] + y * force[..., 0]
        carried = m.sole_friction[side] * press
        along = (force[..., :2] ** 2).sum(axis=-1) / carried**2
        slides = load.stands[..., side] & (along + (twist / (carried * arms.mean(axis=-1))) ** 2 > 1)
        reason = np.where(slides & (reason == ""), f"slipped {foot}", reason)
    pulled = cells + np.repeat(m.plate_weight, 4) < -LEAST_LOAD
    lifted = np.array([f"lifted cell {cell}" for cell in CELLS], dtype=object)[pulled.argmax(axis=-1)]
    return np.where(pulled.any(axis=-1) & (reason == ""), lifted, reason)
