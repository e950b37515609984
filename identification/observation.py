"""An observation: the readings of an experiment and the assumed state of robot and laboratory.

`predict` of an effect returns a changed observation. The nominal laboratory has flat soles, a level floor,
cells at their data-sheet positions and no external force but gravity. Only measurements and the nominal
robot enter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from tulip_testbed.identification.ballast import Ballast, ballast_of, known_weight
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.cad_prior import CadPrior
from tulip_testbed.identification.contact_readings import (
    ContactReadings,
    contact_readings,
    margin_of_load,
    on_four_cells,
)
from tulip_testbed.identification.inertial_wrench import (
    HELD,
    BeyondWeight,
    beyond_weight,
    rates_of,
    rocking,
    yielding,
)
from tulip_testbed.identification.joint_loads import (
    Loads,
    dry_friction,
    joint_loads,
    sag_left,
    servo_stiffness,
)
from tulip_testbed.identification.kinematics import Tree, turned_about
from tulip_testbed.identification.noise_in_time import Decorrelation, NoiseInTime, decorrelation
from tulip_testbed.identification.nominal import Nominal, PostureGeometry
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.measurements.stated_convention import AXES, WORLD
from tulip_testbed.sim.scene import plate_masses

LONG_GAP = 1.5  # of the median time between a placement's postures
STILL = 10.0  # s, assumed: simulated feet creep 0.1 mm in 75 s, and slip by 0.6 mm where a corner lifts
SIZE, TWISTS, CLOSURE = 11, slice(3, 5), slice(5, 11)  # residuals of a posture, see `residual_channels`


@dataclass(frozen=True)
class Observation:
    """An experiment of m postures as it is assumed to have been.

    Attributes:
        nominal: nominal robot.
        measurements: the measurements; time and placement are taken from here.
        tree: kinematics with the assumed lengths.
        contacts: the readings as they came; see there how wrench sensors are scaled to k readings a foot.
        cells: assumed positions of the cells on their plates, (2, k, 2) [m]; of wrench sensors, the levers.
        joint_angles: assumed joint angles, (m, n_joints) [rad].
        cell_forces: assumed readings of the cells [N] or wrench sensors, (m, 2 k).
        plate_poses: assumed poses of the plates, (m, 2, 3) [m, m, rad]. A sensor in a foot has its own in
            place of it: from where it should be, in the foot's axes.
        stance_tilt, swing_tilt: roll and pitch of the soles against the ground, (m, 2) [rad].
        swing_rise: height of the swing foot's sole point over the stance foot's, (m,) [m].
        shift: displacement of the centre of pressure by forces other than weight, (m, 2) [m].
        lift: vertical force in addition to the weighed weight, positive downwards, (m,) [N]; at first that of
            the known masses of joined experiments, and `motion`.
        push: horizontal force other than by the feet's tilt, over `loaded_weight`, (m, 2) [-].
        standard: nominal standard parameters of the links (eq. 5), (n_links, 4) [kg, kg m].
        board_share: share of a board's weight on each of its cells, right and left, (2,) [N].
        servo_gain: torque of each joint's servo per error of its angle, (n_joints,) [Nm/rad].
        servo_stiffness: the same in series with what yields between encoder and link, (n_joints,) [Nm/rad].
        cell_sd: noise of a cell's reading, by the data sheet or else as it was estimated [N].
        time_fraction: time of every posture as a fraction of its experiment's time, 0 to 1, (m,).
        on_four_cells: whether all cells of the right and the left plate are loaded, (m, 2) bool. On three
            cells the twist of a board holds no information. A tared cell without load reads minus its share
            of the board's weight; if the empty board rocked when it was tared, nothing.
        motion: what motion adds to shift, lift and push, see `BeyondWeight`; nothing if the robot is held.
        friction: torque of dry friction on each joint that turns, against its rate, by the nominal robot,
            (m, n_joints) [Nm].
        sag: of servos, the part that feed-forward leaves, by the commands, (m,), see `joint_loads`.
        noise_in_time: how the noise of rows is correlated in time; None: it is not.
        cad: what CAD says about the base parameters; None: the postures determine them.
        compliances: means of the prior of corrected compliances, by label; those of the others are zero.
        heavier: estimated weight less the weighed or nominal one [N]; wrench sensors' readings are over it.
    """

    nominal: Nominal
    measurements: Measurements
    contacts: ContactReadings
    tree: Tree
    cells: np.ndarray
    joint_angles: np.ndarray
    cell_forces: np.ndarray
    plate_poses: np.ndarray
    stance_tilt: np.ndarray
    swing_tilt: np.ndarray
    swing_rise: np.ndarray
    shift: np.ndarray
    lift: np.ndarray
    push: np.ndarray
    standard: np.ndarray
    board_share: np.ndarray
    servo_gain: np.ndarray
    servo_stiffness: np.ndarray
    cell_sd: float
    time_fraction: np.ndarray
    on_four_cells: np.ndarray
    friction: np.ndarray
    sag: np.ndarray
    motion: BeyondWeight = HELD
    noise_in_time: NoiseInTime | None = None
    cad: CadPrior | None = None
    compliances: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    heavier: float = 0.0

    def __len__(self) -> int:
        return len(self.joint_angles)

    @property
    def moves(self) -> bool:
        """Return whether rates or accelerations of the joints were measured."""
        return len(self.motion.by_cad) > 0

    @cached_property
    def weight(self) -> float:
        """Return the weight of the robot from its weighed or else its nominal mass, and `heavier` [N]."""
        weighed = self.measurements.weighed_mass
        return (weighed[0] if weighed else self.nominal.mass) * self.measurements.gravity + self.heavier

    @cached_property
    def segment(self) -> np.ndarray:
        """Return the number of the segment, in which the robot is not put down again, (m,).

        A new placement begins a new segment. So does a gap in time, in which a posture was dropped and the
        robot may have been put down again; without times, gaps in the posture numbers are used.
        """
        placement, time = self.measurements.placement, self.measurements.time
        timed = np.isfinite(time).all()
        clock = time if timed else self.measurements.posture.astype(float)
        order = np.lexsort((time if timed else np.arange(len(time)), placement))
        gap, same = np.diff(clock[order]), placement[order][1:] == placement[order][:-1]
        usual = np.median(gap[same]) if same.any() else 0.0
        number = np.empty(len(time), int)
        number[order] = np.append(0, np.cumsum(~same | (gap > LONG_GAP * usual) | (gap < 0)))
        return number

    @cached_property
    def stance(self) -> np.ndarray:
        """Return the number of the stance, within which the feet do not move, (m,).

        That is a segment. But below moving legs feet creep and slip: there a stance ends after `STILL`.
        """
        number, time = self.segment, self.measurements.time
        if not (self.moves and np.isfinite(time).all()):
            return number
        begins = np.array([time[number == one].min() for one in range(number.max() + 1)])
        part = np.column_stack([number, (time - begins[number]) // STILL])
        return np.unique(part, axis=0, return_inverse=True)[1]

    @cached_property
    def in_time(self) -> Decorrelation | None:
        """Return what makes the noise of rows uncorrelated in time; None: it is, in holds and logs.

        Noise lasts beyond a stance, but where a constant of the stance is unknown, so is what lasts.
        """
        if (lasting := self.noise_in_time) is None:
            return None
        m, used = self.measurements, np.ones((len(self), SIZE), bool)
        used[:, TWISTS] = self.on_four_cells
        closure = list(range(SIZE))[CLOSURE]
        others = [residual for residual in range(SIZE) if residual not in closure]
        return decorrelation(
            (m.time, float(m.window[0]), used),
            ((self.segment, lasting, others), (self.stance, lasting.of_closure(), closure)),
        )

    @cached_property
    def geometry(self) -> PostureGeometry:
        """Return the geometry of the postures; an observation with other readings of the cells shares it."""
        return PostureGeometry(
            self.nominal, self.tree, self.joint_angles, self.measurements.support, self.standard
        )

    @property
    def loaded_center(self) -> np.ndarray:
        """Return the nominal centre of mass of robot and known masses in the base frame, (m, 3) [m]."""
        center = self.geometry.center
        return center if self.ballast is None else self.ballast.loaded(center)

    @property
    def loaded_weight(self) -> np.ndarray:
        """Return the weight of robot and known masses, (m,) [N]."""
        return self.weight + known_weight(self.measurements)

    @property
    def depth(self) -> float:
        """Return how far below the plates' top the plane lies to which the readings refer [m].

        Cells stand on the floor; a wrench on the ground is stated at the top of its plate.
        """
        contacts = self.measurements.contacts
        return float(self.measurements.top_height[0]) if contacts is None else contacts.depth

    @property
    def height(self) -> np.ndarray:
        """Return the height of `loaded_center` over the plane of the readings, (m,) [m]."""
        return self.loaded_center[:, 2] + self.depth

    @property
    def swing_sole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the swing sole point, (m, 3) [m], and the foot's rotation, (m, 3, 3), with flat soles."""
        return self.geometry.swing_sole

    @property
    def in_feet(self) -> bool:
        """Return whether the contact sensors move with the feet."""
        return not self.measurements.on_plates

    @property
    def upright(self) -> bool:
        """Return whether the sensors in the feet were logged in the world's axes, which do not lean."""
        return any(
            (one.what, one.hypothesis, one.applied) == (AXES, WORLD, True)
            for one in self.measurements.conventions
        )

    def seen_from(self, lean: np.ndarray) -> np.ndarray:
        """Return the readings of wrench sensors in feet that lean, (m, 2, 2) [rad], (m, 2 k)."""
        contacts = self.measurements.contacts
        assert contacts is not None
        forces = self.cell_forces.reshape(len(self), 2, -1) @ self.contacts.by_reading.T
        out = np.empty_like(forces)
        for side, pose in enumerate(contacts.pose):
            turn = turned_about(pose[3:])
            angle = np.column_stack([lean[:, side], np.zeros(len(self))]) @ turn
            for part in (slice(0, 3), slice(3, 6)):
                out[:, side, part] = forces[:, side, part] - np.cross(angle, forces[:, side, part])
        assert self.contacts.by_channel is not None
        return (out @ self.contacts.by_channel.T).reshape(len(self), -1)

    @cached_property
    def foot_loads(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the vertical force on both feet, (m, 2) [N], and its point on the ground, (m, 2, 2) [m]."""
        forces = self.cell_forces.reshape(len(self), 2, -1)
        down = (forces * self.contacts.bears).sum(axis=2)
        moment = (forces[..., None] * self.cell_places.reshape(*forces.shape, 2)).sum(axis=2)
        return down, moment / np.where(np.abs(down) > 1e-6, down, np.inf)[..., None]

    @cached_property
    def sole_loads(self) -> np.ndarray:
        """Return force times lever about the centre of each sole along the foot's x and y, (m, 2, 2) [Nm].

        Cells give the point of the force on the floor; at the height of the sole it is displaced by the
        horizontal force of the ground.
        """
        stance, swing = np.moveaxis(self.depth * self.loads.sideways, 1, 0)
        _, turn = self.swing_sole
        yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
        return self._about_centers(self.cell_forces) + np.stack([stance, turned(-yaw, swing)], axis=1)

    def _about_centers(self, readings: np.ndarray) -> np.ndarray:
        """Return force times lever about the centres of the soles of readings of the contacts, (m, 2, 2)."""
        forces = readings.reshape(len(self), 2, -1)
        down = (forces * self.contacts.bears).sum(axis=2)[..., None]
        stance, swing = (
            (forces[..., None] * self.cell_places.reshape(*forces.shape, 2)).sum(axis=2).swapaxes(0, 1)
        )
        place, turn = self.swing_sole
        yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
        swing = turned(-yaw, swing - down[:, 1] * place[:, :2])
        return np.stack([stance, swing], axis=1) - down * self.nominal.sole_centers

    @cached_property
    def contact_poses(self) -> np.ndarray:
        """Return the poses of the contact sensors in the base frame, (m, 2, 3) [m, m, rad]."""
        if not self.in_feet:
            return self.plate_poses
        rotations, _ = self.geometry.frames
        turn = rotations[:, [self.nominal.parameters.base, self.nominal.swing_frame]]
        yaw = np.arctan2(turn[..., 1, 0], turn[..., 0, 0])
        soles = np.stack([self.geometry.stance_sole, self.swing_sole[0]], axis=1)[..., :2]
        return np.concatenate([soles + turned(yaw, self.plate_poses[..., :2]), yaw[..., None]], axis=2) + (
            self.plate_poses * [0.0, 0.0, 1.0]
        )

    @cached_property
    def cell_places(self) -> np.ndarray:
        """Return the cells' positions in the base frame, (m, 2 k, 2) [m].

        Of wrench sensors: force times place of a unit of each reading.
        """
        poses = self.contact_poses
        levers = turned(poses[:, :, None, 2], self.cells[None])
        return (levers + poses[:, :, None, :2] * self.contacts.bears[..., None]).reshape(len(self), -1, 2)

    @cached_property
    def loads(self) -> Loads:
        """Return the loads of joints and feet."""
        down, point = self.foot_loads
        plane = np.full((len(self), 2, 1), -self.depth)
        return joint_loads(
            self.geometry,
            self.weight,
            down,
            np.concatenate([point, plane], axis=2),
            self.cell_places.reshape(len(self), 2, -1, 2),
            self.contacts.bears,
            self.cell_sd,
            0.0 if self.in_feet else max(self.measurements.sensors.known_placement_sd[:2]),
            self.measurements.support == "double",
            self.servo_stiffness,
            self.servo_gain,
            self.sag,
            self.friction,
            self.motion.of_links,
            self._outside_push,
        )

    @property
    def _outside_push(self) -> np.ndarray:
        """Return the ground's horizontal force against what is no motion, (m, 2) [N]."""
        known = self.motion.by_cad[:, 3:] if self.moves and self.motion.shown else 0.0
        return self.loaded_weight[:, None] * (self.push - known)

    @property
    def torques(self) -> np.ndarray:
        """Return the torque of the load on every joint about its axis, (m, n_joints) [Nm]."""
        return self.loads.torques

    @cached_property
    def ballast(self) -> Ballast | None:
        """Return what the known masses weigh and where they are, None without any."""
        return ballast_of(self.measurements, self.geometry, self.weight)

    def weighing(self, heavier: float) -> Observation:
        """Return the observation of a robot that is heavier than stated [N]; so are its inertial forces."""
        if heavier == self.heavier:
            return self
        ratio = (self.weight - self.heavier + heavier) / self.weight
        force, motion = np.array([1.0, 1.0, ratio, 1.0, 1.0]), self.motion
        lift = self.lift + (ratio - 1) * motion.by_cad[:, 2] if self.moves and motion.shown else self.lift
        return self.changed(
            heavier=heavier,
            lift=lift,
            motion=replace(
                motion,
                by_cad=motion.by_cad * force,
                slope=motion.slope * force[:, None],
                unknown=motion.unknown * force[:, None],
                rocking=motion.rocking * force[:, None],
                yielding=motion.yielding * force[:, None],
                rate=motion.rate * force,
                of_links=motion.of_links * ratio,
            ),
        )

    def accelerated(self, added: np.ndarray) -> Observation:
        """Return the observation with more forces beyond its weight, (m, 5), see `BeyondWeight`."""
        return self.changed(
            shift=self.shift + added[:, :2], lift=self.lift + added[:, 2], push=self.push + added[:, 3:]
        )

    def take(self, rows: np.ndarray) -> Observation:
        """Return some postures of the experiment, by their numbers."""
        kept = {
            f.name: getattr(self, f.name)[rows]
            for f in fields(self)
            if isinstance(getattr(self, f.name), np.ndarray)
            and f.name not in ("cells", "standard", "board_share", "servo_gain", "servo_stiffness")
            and len(getattr(self, f.name)) == len(self)
        }
        if self.moves:
            kept["motion"] = self.motion.take(rows)
        kept |= {name: getattr(self, name).take(rows) for name in ("measurements", "contacts")}
        return replace(self, **kept)

    def changed(self, **fields: Any) -> Observation:
        """Return the observation with some fields replaced."""
        other = object.__new__(Observation)  # thousands in a calibration; `replace` takes five times as long
        other.__dict__.update({name: self.__dict__[name] for name in NAMES} | fields)
        if other.joint_angles is self.joint_angles:
            same = other.tree is self.tree
            other.__dict__["geometry"] = self.geometry if same else self.geometry.with_lengths(other.tree)
        return other


NAMES = tuple(one.name for one in fields(Observation))


def observe(measurements: Measurements, nominal: Nominal, inertias: np.ndarray | None = None) -> Observation:
    """Return the observation of an experiment in the nominal laboratory.

    Args:
        inertias: directions of inertial parameters, see `beyond_weight`.
    """
    measurements, m = as_joined(measurements), len(measurements)
    contacts = contact_readings(measurements, nominal)
    motion = beyond_weight(nominal, measurements, inertias)
    added = motion.by_cad if len(motion.by_cad) else np.zeros((m, 5))
    share = np.array(plate_masses(nominal.robot)) * measurements.gravity / 4
    gain = servo_stiffness(nominal.robot, measurements.gains)
    observed = Observation(
        nominal=nominal,
        measurements=measurements,
        tree=nominal.parameters.tree,
        contacts=contacts,
        cells=contacts.levers,
        joint_angles=measurements.joint_angles,
        cell_forces=contacts.values,
        plate_poses=measurements.plate_poses,
        stance_tilt=np.zeros((m, 2)),
        swing_tilt=np.zeros((m, 2)),
        swing_rise=np.zeros(m),
        shift=added[:, :2],
        lift=known_weight(measurements) + added[:, 2],
        push=added[:, 3:],
        friction=dry_friction(nominal.robot, rates_of(measurements)[0]),
        sag=np.ones(m),
        motion=motion,
        standard=standard_parameters(nominal.robot.model),
        board_share=share,
        servo_gain=gain,
        servo_stiffness=gain,
        cell_sd=contacts.sd,
        time_fraction=_each(measurements, lambda rows: fraction_of_time(measurements.time[rows])),
        on_four_cells=_of_boards(measurements, contacts, share, len(motion.by_cad) > 0),
    )
    if measurements.command is not None:
        # No feed-forward knows friction: what the sags show is compared with the loads without it.
        loads = observed.changed(friction=np.zeros_like(observed.friction)).loads
        sags = measurements.command - measurements.joint_angles
        observed = observed.changed(sag=sag_left(loads, sags, measurements.of_experiment))
    rates = contacts.rates(measurements) if observed.moves else None
    return observed if rates is None else observed.changed(motion=_yielding(observed, rates))


def _yielding(observed: Observation, rates: list[np.ndarray]) -> BeyondWeight:
    """Return what motion adds, with what it adds in a robot that yields to loads with these rates."""
    m, (rate, faster) = observed.measurements, rates_of(observed.measurements)

    def torques(at: float) -> np.ndarray:
        return observed.changed(
            joint_angles=observed.joint_angles + at * rate + at**2 / 2 * faster,
            cell_forces=observed.cell_forces + at * rates[0] + at**2 / 2 * rates[1],
        ).torques

    return replace(
        observed.motion,
        load_rates=np.stack([observed._about_centers(each) for each in rates], axis=1),
        rocking=rocking(observed.nominal, m),
        yielding=yielding(observed.geometry, m, torques),
    )


def _of_boards(
    measurements: Measurements, contacts: ContactReadings, share: np.ndarray, moves: bool
) -> np.ndarray:
    """Compute `Observation.on_four_cells`."""
    if measurements.contacts is not None:
        return np.zeros((len(measurements), 2), bool)
    margin = margin_of_load(measurements.sensors.cell_sd or 0.0)
    spread = measurements.cell_forces_sd.reshape(-1, 2, 4) if moves else None
    return _each(
        measurements,
        lambda rows: on_four_cells(
            contacts.values[rows].reshape(-1, 2, 4), margin, share, None if spread is None else spread[rows]
        ),
    )


def _each(measurements: Measurements, of_rows: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Compute something of the rows of each experiment by itself, (m, ...)."""
    number = measurements.of_experiment
    parts = [np.flatnonzero(number == k) for k in np.unique(number)] or [np.arange(0)]
    out = np.concatenate([of_rows(rows) for rows in parts])
    return out[np.argsort(np.concatenate(parts), kind="stable")]


def turned(yaw: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return vectors (..., 2) turned by angles (...) about the vertical."""
    c, s, x, y = np.cos(yaw), np.sin(yaw), vector[..., 0], vector[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def fraction_of_time(time: np.ndarray) -> np.ndarray:
    """Return time as a fraction of the experiment's, 0 at the first posture and 1 at the last, (m,)."""
    span = float(np.ptp(time)) if len(time) else 0.0
    return (time - time.min()) / span if span > 0 else np.zeros(len(time))
