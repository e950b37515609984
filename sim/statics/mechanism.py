"""The robot's mechanism in a laboratory, as plain arrays."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.sim.statics.soft_constraints import Stops

LEVEL = 1e-6  # m, of feet that are equally long
# Moment about the diagonal over which the board tips from one side to the other [Nm]. A rigid board does so
# at none; this one displaces the centre of pressure by a fifth of a millimetre under 100 N.
TIPPING = 0.02
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


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
        """Return what the cells of the empty board bear, (4,) [N], by a quarter of its weight [N]."""
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
    """Return a board if it rocks, by its cells' places, (4, 2), and how far each is too short, (4,) [m]."""
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


@dataclass(frozen=True)
class Joint:
    """A hinge or slide.

    Attributes:
        column: of the coordinates. kind: `HINGE` or `SLIDE`.
        axis, anchor: in its body's frame, (3,).
        zero: coordinate at which it is as the file draws it (`ref`) [rad, m].
    """

    column: int
    kind: int
    axis: np.ndarray
    anchor: np.ndarray
    zero: float

    @cached_property
    def along(self) -> int | None:
        """Return which of its body's axes it turns about or slides along, None if none of them."""
        nonzero = np.flatnonzero(self.axis)
        return int(nonzero[0]) if len(nonzero) == 1 and self.axis[nonzero[0]] == 1.0 else None

    @cached_property
    def off_origin(self) -> bool:
        """Return whether its axis does not pass through its body's origin."""
        return bool(self.anchor.any())


@dataclass(frozen=True)
class Body:
    """A body: index of its parent, pose in the parent's frame, and its joints in order."""

    name: str
    parent: int
    position: np.ndarray
    rotation: np.ndarray
    joints: tuple[Joint, ...]

    @cached_property
    def turned(self) -> bool:
        """Return whether its axes at rest are not those of its parent."""
        return not np.array_equal(self.rotation, np.eye(3))


@dataclass(frozen=True)
class Rope:
    """A spring between points of a body and of the world, without force in a range of lengths [N/m, m]."""

    body: int
    point: np.ndarray
    anchor: np.ndarray
    stiffness: float
    length: tuple[float, float]


@dataclass(frozen=True)
class Mechanism:
    """The mechanism of one laboratory, as far as statics needs it.

    The n coordinates are the angles of hinges and the displacements of slides: the robot's joints and, if the
    rig has them, rotors and sole springs. Body 0 is the torso.

    Attributes:
        bodies: the tree, parents first; the torso's entry has no joints.
        mass, center: mass of every body, (nb,) [kg], and its centre of mass in its frame, (nb, 3) [m].
        gravity: acceleration of gravity, (3,) [m/s2].
        joints: columns of the robot's joints, in the plan's order.
        motors: columns that their servos turn.
        gain, limit: stiffness and torque limit of the servos, by joint, [Nm/rad], [Nm].
        stiffness, rest: springs in single coordinates, (n,) [Nm/rad or N/m], [rad or m].
        springs: fixed tendons as (stiffness, (low, high), coefficients (n,)).
        ropes: springs to the world.
        friction: dry friction of every coordinate, (n,) [Nm].
        stops: limits of the coordinates.
        feet: indices of the bodies of the right and left foot.
        soles: indices of the bodies of the right and left sole.
        sole_points: point of each sole below the ankle, in its body's frame, (2, 3) [m].
        corners: corners of the soles relative to these points, (2, 4, 2) [m].
        sole_friction: coefficient of static friction under each sole, (2,).
        cells: positions of the cells on their plates, (2, 4, 2) [m].
        plate_weight: share of its plate's weight on every cell, (2,) [N].
        top_height: height of the boards' top over the floor [m].
        board_compliance, sole_compliance: compliance of each board on its cells and of each sole on its
            board in height, roll and pitch, about the plate's origin and the sole point, (2, 3, 3).
        rocking: the board of each plate if it has a short foot, (2,).
        names: names of the coordinates.
    """

    bodies: tuple[Body, ...]
    mass: np.ndarray
    center: np.ndarray
    gravity: np.ndarray
    joints: np.ndarray
    motors: np.ndarray
    gain: np.ndarray
    limit: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    springs: tuple[tuple[float, tuple[float, float], np.ndarray], ...]
    ropes: tuple[Rope, ...]
    friction: np.ndarray
    stops: Stops
    feet: tuple[int, int]
    soles: tuple[int, int]
    sole_points: np.ndarray
    corners: np.ndarray
    sole_friction: np.ndarray
    cells: np.ndarray
    plate_weight: np.ndarray
    top_height: float
    board_compliance: np.ndarray
    sole_compliance: np.ndarray
    rocking: tuple[RockingBoard | None, RockingBoard | None]
    names: tuple[str, ...]

    def with_play(self, fraction: float) -> Self:
        """Return the mechanism with this fraction of the springs' free play, about its middle."""
        springs = [
            (k, ((low + high - fraction * (high - low)) / 2, (low + high + fraction * (high - low)) / 2), row)
            for k, (low, high), row in self.springs
        ]
        return replace(self, springs=tuple(springs))

    @cached_property
    def behind(self) -> np.ndarray:
        """Return whether the second body hangs on the first or is it, (nb, nb) bool."""
        out = np.eye(len(self.bodies), dtype=bool)
        for number in range(len(self.bodies) - 1, 0, -1):
            out[self.bodies[number].parent] |= out[number]
        return out

    def sums_behind(self, values: np.ndarray) -> np.ndarray:
        """Sum over each body and all that hang on it, (nb, ...)."""
        return (self.behind.astype(float) @ values.reshape(len(values), -1)).reshape(values.shape)

    @cached_property
    def owner(self) -> np.ndarray:
        """Return the body of each coordinate, (n,)."""
        return self._by_coordinate([number for number, body in enumerate(self.bodies) for _ in body.joints])

    @cached_property
    def order(self) -> np.ndarray:
        """Return the place of each coordinate's joint among those of its body, (n,)."""
        return self._by_coordinate([place for body in self.bodies for place in range(len(body.joints))])

    @cached_property
    def slides(self) -> np.ndarray:
        """Return which coordinates are displacements, (n,) bool."""
        kinds = [joint.kind == SLIDE for body in self.bodies for joint in body.joints]
        return self._by_coordinate(kinds).astype(bool)

    def _by_coordinate(self, of_joints: list) -> np.ndarray:
        columns = [joint.column for body in self.bodies for joint in body.joints]
        out = np.zeros(len(self.names), int)
        out[columns] = of_joints
        return out

    @property
    def balanced(self) -> Self:
        """Return the mechanism with boards that rock balanced on their diagonals."""
        right, left = (board and replace(board, balanced=True) for board in self.rocking)
        return replace(self, rocking=(right, left))

    @property
    def tare(self) -> np.ndarray:
        """Return what the cells bear under the empty boards, (8,) [N]."""
        shares = zip(self.rocking, self.plate_weight, strict=True)
        return np.concatenate([board.tare(own) if board else np.full(4, own) for board, own in shares])
