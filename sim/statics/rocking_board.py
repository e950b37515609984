"""A board with one short foot: it stands on three feet and rocks about the diagonal next to the short one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError

LEVEL = 1e-6  # m, of feet that are equally long
# Moment about the diagonal over which the board tips from one side to the other [Nm]. A rigid board does so
# at none; this one displaces the centre of pressure by a fifth of a millimetre under 100 N.
TIPPING = 0.02


@dataclass(frozen=True)
class RockingBoard:
    """The feet of a board, of which one is short.

    Attributes:
        cell: index of the short foot's cell.
        gap: by which it is too short [m].
        across: unit vector across the diagonal towards the short foot, in the plate's frame, (2,).
        distance: of the short foot from the diagonal [m].
        diagonal: place of the diagonal along `across` from the plate's origin [m].
        balanced: whether the board is on the diagonal at any tilt, as between its two stands.
    """

    cell: int
    gap: float
    across: np.ndarray
    distance: float
    diagonal: float
    balanced: bool = False

    @property
    def beside(self) -> list[int]:
        """Return the indices of the two cells on the diagonal."""
        return [(self.cell + 1) % 4, (self.cell + 3) % 4]

    def tare(self, share: float) -> np.ndarray:
        """Return what the cells of the empty board bear, (4,) [N]: it balances on the diagonal.

        Args:
            share: a quarter of its weight [N].
        """
        return np.where(np.isin(np.arange(4), self.beside), 2 * share, 0.0)

    def deflection(self, down: np.ndarray, tip: np.ndarray) -> np.ndarray:
        """Return height, roll and pitch of the board at the plate's origin, (..., 3) [m, rad, rad].

        Args:
            down, tip: see `board_wrench`, (...,) [N] and (..., 2) [Nm].
        """
        x, y = self.across
        moment = x * tip[..., 1] - y * tip[..., 0] - self.diagonal * down
        tipped = 0.5 + moment / TIPPING
        tilt = (tipped if self.balanced else np.clip(tipped, 0.0, 1.0)) * self.gap / self.distance
        return tilt[..., None] * np.array([self.diagonal, -y, x])

    def shared(self, forces: np.ndarray) -> np.ndarray:
        """Return forces on four equal feet as the board on three of them bears them, (..., 4) [N].

        Of the short foot and the opposite one, that with less load hangs in the air.
        """
        opposite = (self.cell + 2) % 4
        idle = np.minimum(forces[..., self.cell], forces[..., opposite])[..., None]
        return forces + idle * np.where(np.isin(np.arange(4), self.beside), 1.0, -1.0)


def rocking_board(cells: np.ndarray, short: np.ndarray) -> RockingBoard | None:
    """Return a plate's board if it rocks, None if its feet are equally long.

    Args:
        cells: positions of the cells on the plate, (4, 2) [m].
        short: by how much the foot at each is shorter than the longest, (4,) [m].
    """
    if (short <= LEVEL).all():
        return None
    if (short > LEVEL).sum() > 1:
        raise InputError(
            f"static equilibrium: found a plate with {(short > LEVEL).sum()} short feet, "
            "expected one at most; use the full dynamics"
        )
    cell = int(short.argmax())
    first, second = cells[(cell + 1) % 4], cells[(cell + 3) % 4]
    along = (second - first) / np.linalg.norm(second - first)
    across = np.array([along[1], -along[0]])
    distance = float((cells[cell] - first) @ across)
    across, distance = (across, distance) if distance > 0 else (-across, -distance)
    return RockingBoard(cell, float(short[cell]), across, distance, float(first @ across))
