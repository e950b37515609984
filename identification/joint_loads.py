"""Static loads of the nominal robot in a held posture: centre of mass and torque on every joint."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tulip_testbed.identification.nominal import PostureGeometry
from tulip_testbed.sim.control import Controller, torque_limits
from tulip_testbed.sim.robot import Robot, joint_names

ROUNDING = 1e-12  # relative
BREAKING_LOOSE = 0.003  # rad/s, speed from which dry friction acts in full; assumed
# S.d. of the wrench between the closed legs about that of elastic servos without friction, assumed: a fifth
# of the wrench of TULip's postures. Friction at rest makes most of it.
UNSEEN = np.array([1.0, 1.0, 0.4])  # N, N, Nm
FRICTION = 5.0  # times that if each row counts by itself: friction is alike in like postures, assumed
ZERO = np.radians(0.15)  # s.d. of an encoder's zero, assumed
LITTLE = 0.01  # precision of the part of the sag that is left before any data, assumed
MOVING = 2.0  # times that, of a robot that moves: the feet stay where they were put down
# m, s.d. of the point of a foot's load beyond the noise of its cells and that of their place, assumed.
MISPLACED = 0.002


@dataclass(frozen=True)
class Loads:
    """Static loads of joints and feet.

    Attributes:
        torques: torque of the load on each joint about its axis, (m, n_joints) [Nm].
        internal_wrench: horizontal force and torsion of the ground on the swing foot, (m, 3) [N, N, Nm].
        closed: internal wrench per displacement along x and y and about z of the point of the load on the
            swing foot, which the closed legs resist, (m, 3, 3) [N/m, N/rad, Nm/m, Nm/rad].
        levers: torque on every joint per unit of the internal wrench, (m, n_joints, 3) [m, m, -].
        turns: internal wrench that takes up a turn of each joint, (m, 3, n_joints) [N/rad, Nm/rad].
        yields: the same of a torque on each joint, by its servo's sag and what yields.
        shown: torque on every joint per unit of what cells show of the swing foot, its vertical force and its
            moments about x and y, (m, n_joints, 3) [m, -, -]; zero on one foot.
        servo_stiffness, geometry, cells, bears, cell_sd, place_sd: see `joint_loads`.
        carried: load of the foot that a joint bears, stance and swing, with its sign, (m, n_joints, 2) [N].
        carries: that sign, (n_joints, 2).
        unseen: s.d. of the internal wrench by what the cells do not show, (3,) [N, N, Nm].
        pushes: see `joint_loads`.
    """

    torques: np.ndarray
    internal_wrench: np.ndarray
    closed: np.ndarray
    levers: np.ndarray
    turns: np.ndarray
    yields: np.ndarray
    shown: np.ndarray
    servo_stiffness: np.ndarray
    geometry: PostureGeometry
    cells: np.ndarray
    bears: np.ndarray
    cell_sd: float
    place_sd: float
    carried: np.ndarray
    carries: np.ndarray
    unseen: np.ndarray
    pushes: np.ndarray

    @cached_property
    def sharing(self) -> np.ndarray:
        """Compute the torque that closed legs take off every joint by a turn of one, (m, n, n) [Nm/rad]."""
        return self.levers @ self.turns

    @cached_property
    def _by(self) -> np.ndarray:
        """Differentiate the torques with the internal wrench as it is, see `torques_by`."""
        geometry, k = self.geometry, self.bears.shape[1]
        ax, ay, _ = np.moveaxis(geometry.axes, -1, 0)
        cell_x, cell_y = np.moveaxis(self.cells.reshape(len(ax), 2 * k, 1, 2), -1, 0)
        of_pivots = geometry.pivots[..., 1] * ax - geometry.pivots[..., 0] * ay
        by_cells = (
            cell_y * ax[:, None] - cell_x * ay[:, None] - self.bears.reshape(-1, 1) * of_pivots[:, None]
        )
        by_cells *= np.repeat(self.carries, k, axis=1).T
        borne = self.carried
        by_points = np.stack([-borne * ay[..., None], borne * ax[..., None]], axis=-1).reshape(*ax.shape, 4)
        return np.concatenate([by_cells.mT, by_points], axis=2)

    @cached_property
    def wrench_by(self) -> np.ndarray:
        """Differentiate the internal wrench by what `torques_by` says, (m, 3, 2 k + 4)."""
        return -self.yields @ self._by

    @cached_property
    def torques_by(self) -> np.ndarray:
        """Differentiate the torques by the readings of the contacts and the points of the loads.

        Returns:
            by the 2 k readings, then by x and y of the point of the load on the stance and the swing foot,
            (m, n_joints, 2 k + 4) [m, N].
        """
        return self._by + self.levers @ self.wrench_by

    @cached_property
    def doubt(self) -> np.ndarray:
        """Compute the s.d. of the torques, (m, n_joints) [Nm].

        It is due to the noise of the cells, what they do not show of the internal wrench, and the point of
        the load.
        """
        of_cells = self.torques_by[..., : self.bears.size]
        variance = (
            self.cell_sd**2 * np.einsum("mnk,mnk->mn", of_cells, of_cells) + self.levers**2 @ self.unseen**2
        )
        off = np.hypot(MISPLACED, self.place_sd)
        return np.sqrt(variance + (off * np.abs(self.carried).sum(axis=2)) ** 2)

    @cached_property
    def sideways(self) -> np.ndarray:
        """Return the ground's horizontal force on stance and swing foot, but motion's, (m, 2, 2) [N]."""
        shared = self.internal_wrench[:, :2]
        out = np.stack([-shared, shared], axis=1)
        out[np.arange(len(out)), self.geometry.on_swing_foot.astype(int)] += self.pushes
        return out

    @property
    def stiffness(self) -> np.ndarray:
        """Return the stiffness of the closed legs against a rotation of one joint, (m, n_joints) [Nm/rad]."""
        return np.diagonal(self.sharing, axis1=1, axis2=2)

    @cached_property
    def held(self) -> np.ndarray:
        """Return the stiffness against a rotation of one joint on the ground, (m, n_joints) [Nm/rad].

        The closed legs and the loads of the feet resist it; zero on one foot.
        """
        levers = np.concatenate([self.levers, self.shown], axis=2)
        resisting = _inverted(levers.mT @ (levers / self.servo_stiffness[:, None]))
        return np.einsum("mni,mij,mnj->mn", levers, resisting, levers, optimize=True)


def joint_loads(
    geometry: PostureGeometry,
    weight: float,
    down: np.ndarray,
    place: np.ndarray,
    cells: np.ndarray,
    bears: np.ndarray,
    cell_sd: float,
    place_sd: float,
    both: np.ndarray,
    servo_stiffness: np.ndarray,
    servo_gain: np.ndarray,
    sag: np.ndarray,
    friction: np.ndarray,
    of_links: np.ndarray,
    pushes: np.ndarray,
) -> Loads:
    """Compute the loads of joints and feet from the nominal robot and the cells.

    The cells give the vertical force on each foot and its point, but not the horizontal force and torsion
    between the feet. Elastic servos settle at the least complementary energy sum tau^2 / stiffness
    (Castigliano). Feed-forward torques that hold the robot without sag take that wrench off, except what is
    due to parts that yield between encoder and link.

    The joints of a leg bear what the ground exerts on its foot. Seen from the torso, those of the stance leg
    would bear the whole robot, whose place depends on the very angle by which a joint yields.

    Args:
        weight: weight of the robot [N].
        down: vertical force on stance and swing foot, (m, 2) [N]. place: its point by the cells,
            (m, 2, 3) [m].
        cells: places of the cells under both feet, (m, 2, k, 2) [m]. bears: vertical force of a unit of each
            reading, (2, k). cell_sd: their noise [N]. See `ContactReadings`.
        place_sd: s.d. of where the cells are in a placement [m].
        both: whether the posture stands on both feet, (m,) bool.
        servo_stiffness: torque of each joint's servo per error of its angle, (n_joints,) [Nm/rad].
        servo_gain: the same without what yields between encoder and link. sag: part of the error of the
            angles which feed-forward leaves, (m,), see `sag_left`.
        friction: torque of dry friction on each joint that turns, against its rate, (m, n_joints) [Nm]. A
            servo sags under it, and no feed-forward takes that off.
        of_links: what each link needs beyond its weight, (m, n_links, 6) [N, Nm]; (0, ...): it is held.
        pushes: horizontal force of the ground on the feet by which it resists what pulls at the torso, (m, 2)
            [N]. No feed-forward knows it.
    """
    mass = geometry.standard[:, 0].sum()
    # The wrench of the ground on the swing foot acts on every joint between it and the base.
    between = geometry.moved[:, geometry.nominal.swing_frame]
    of_stance_leg = between & geometry.moved[:, geometry.tree.frame_of_link[0]]  # a waist is of no leg
    ax, ay, az = np.moveaxis(geometry.axes, -1, 0)
    x, y, _ = np.moveaxis(geometry.center[:, None] - geometry.pivots, -1, 0)
    carried = geometry.mass_moments - mass * (x * ay - y * ax) * of_stance_leg
    # Of which foot a joint bears the force, and with which sign: the stance foot stands on the base's side.
    carries = np.column_stack([-1.0 * of_stance_leg, 1.0 * (between & ~of_stance_leg)])
    # Moments about the axes of unit forces along z, x and y, and of a unit torque about z.
    lever = place[:, None] - geometry.pivots[:, :, None]
    upward = carries * (lever[..., 1] * ax[..., None] - lever[..., 0] * ay[..., None])
    torque = weight / mass * carried + (upward * down[:, None]).sum(axis=2)
    if moves := len(of_links) > 0:
        torque = torque + _in_motion(geometry, of_links, place, of_stance_leg, carries)
    resisted = _resisted(geometry, pushes, place, carries)
    x, y, z = np.moveaxis(lever[:, :, 1] * between[:, None], -1, 0)
    unknown = np.stack([z * ay - y * az, x * az - z * ax, az * between], axis=-1)
    # In single support the swing foot bears no load.
    unknown = unknown * both[:, None, None]
    # What turns the joints must close the legs in all directions. Feed-forward is that of the load share that
    # was planned; how far the measured one is from it follows from the directions that cells show.
    seen = np.stack([y * ax - x * ay, ax * between, ay * between], axis=-1)
    sagging, left = (unknown / servo_gain[:, None]).mT, sag[:, None, None]
    unplanned = seen @ _inverted(seen.mT @ (seen / servo_gain[:, None])) @ seen.mT
    closing = unknown.mT - (1 - left) * sagging @ unplanned
    closed = _inverted(closing @ (unknown / servo_stiffness[:, None]))
    turns = closed @ closing
    yields = turns * (1 / servo_stiffness - (1 - left) / servo_gain)
    sags = friction / servo_gain + resisted / servo_stiffness
    push = -(yields @ torque[..., None] + turns @ sags[..., None])[..., 0]
    return Loads(
        torques=torque + resisted + (unknown @ push[..., None])[..., 0],
        internal_wrench=push,
        closed=closed * both[:, None, None],
        levers=unknown,
        turns=turns,
        yields=yields,
        shown=seen * both[:, None, None],
        servo_stiffness=servo_stiffness,
        geometry=geometry,
        cells=cells,
        bears=bears,
        cell_sd=cell_sd,
        place_sd=place_sd,
        carried=carries * down[:, None],
        carries=carries,
        unseen=UNSEEN * (MOVING if moves else 1.0),
        pushes=pushes,
    )


def _resisted(
    geometry: PostureGeometry, pushes: np.ndarray, place: np.ndarray, carries: np.ndarray
) -> np.ndarray:
    """Compute the torques of what the ground exerts on the foot that carries, (m, n_joints) [Nm].

    The pull acts at the centre of mass, so that a torsion belongs to the force.
    """
    foot = geometry.on_swing_foot.astype(int)
    point = place[np.arange(len(foot)), foot]
    force = np.concatenate([pushes, np.zeros((len(pushes), 1))], axis=1)
    moment = np.cross(point[:, None] - geometry.pivots, force[:, None])
    moment[..., 2] += np.cross(geometry.center - point, force)[:, None, 2]
    return carries[:, foot].T * (geometry.axes * moment).sum(axis=2)


def _in_motion(
    geometry: PostureGeometry,
    of_links: np.ndarray,
    place: np.ndarray,
    of_stance_leg: np.ndarray,
    carries: np.ndarray,
) -> np.ndarray:
    """Compute what motion adds to the torques of the load, (m, n_joints) [Nm], see `joint_loads`.

    Links resist their acceleration (d'Alembert). The cells show what the ground adds to the vertical force,
    but not its horizontal force and torsion: these act on the foot that carries.
    """
    beyond = geometry.moved[:, geometry.tree.frame_of_link] - 1.0 * of_stance_leg[:, None]
    force, moment = np.split(np.einsum("nl,mlk->mnk", beyond, of_links), 2, axis=2)
    whole, turning = np.split(of_links.sum(axis=1), 2, axis=1)
    foot = geometry.on_swing_foot.astype(int)
    point = place[np.arange(len(foot)), foot]
    torsion = (turning - np.cross(point, whole))[:, 2]
    ground = np.cross(point[:, None] - geometry.pivots, whole[:, None] * [1.0, 1.0, 0.0])
    ground[..., 2] += torsion[:, None]
    about = carries[:, foot].T[..., None] * ground - moment + np.cross(geometry.pivots, force)
    return (geometry.axes * about).sum(axis=2)


def _inverted(square: np.ndarray) -> np.ndarray:
    """Invert matrices, (m, k, k); a small term keeps it finite where the legs leave a component free."""
    scale = np.trace(square, axis1=1, axis2=2)[:, None, None]
    return np.linalg.inv(square + ROUNDING * np.where(scale > 0, scale, 1.0) * np.eye(square.shape[1]))


def sag_left(loads: Loads, sags: np.ndarray, experiment: np.ndarray) -> np.ndarray:
    """Return the part of the internal wrench of servos without feed-forward that commands show, (m,), 0 to 1.

    Encoders' zeros seem to exert a wrench too, which is constant. Without data the part is 1.

    Args:
        loads: with all of it.
        sags: commanded less measured angles, (m, n_joints) [rad].
        experiment: its number, (m,).
    """
    free = loads.internal_wrench[:, :2]
    shown, part = free - (loads.turns @ sags[..., None])[:, :2, 0], np.ones(len(free))
    for number in np.unique(experiment):
        rows = experiment == number
        both = np.stack([free[rows], shown[rows]])
        mean = both.mean(axis=1)
        by_zeros = ZERO**2 * (loads.turns[rows, :2].mean(axis=0) ** 2).sum(axis=1)
        every = FRICTION**2 * UNSEEN[:2] ** 2
        squares = ((both - mean[:, None]) * (free[rows] - mean[0])).sum(axis=1) / every
        squares += mean * mean[0] / (by_zeros + every / rows.sum())
        part[rows] = np.clip((LITTLE + squares[1].sum()) / (LITTLE + squares[0].sum()), 0.0, 1.0)
    return part


def dry_friction(robot: Robot, rates: np.ndarray) -> np.ndarray:
    """Return the torque by which dry friction resists the drives at these rates, (m, n_joints) [Nm].

    Args:
        rates: of the joints, (m, n_joints) [rad/s].
    """
    model = robot.model
    most = np.array([model.joint(name).frictionloss[0] for name in joint_names(model)])
    return -most * np.tanh(rates / BREAKING_LOOSE)


def servo_stiffness(robot: Robot, gains: Mapping[str, float]) -> np.ndarray:
    """Return the stiffness of the joints' servos, (n_joints,) [Nm/rad]: the stated gains by joint.

    Where none is stated, it is proportional to the torque limit (1 Nm for a joint without one).
    """
    limits = torque_limits(robot)
    usual = np.where(np.isfinite(limits), limits, 1.0) / Controller().error_at_full_torque
    return np.array([gains.get(name, k) for name, k in zip(joint_names(robot.model), usual, strict=True)])
