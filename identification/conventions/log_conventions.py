"""How a log may write wrenches and joint angles: axes, signs, points and orders, and how late it may be."""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from tulip_testbed.identification.kinematics import turned_about
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.stated_convention import WORLD
from tulip_testbed.sim.robot import rotation_matrices

SENSOR, PREPARED, PUBLISHED = "sensor", "base link", "base link as published"
FOOT = "a point of the foot"
ON_ROBOT, ON_GROUND = "of the ground on the robot", "of the robot on the ground"
FORCES, MOMENTS = "forces first", "moments first"
OUTSIDE = np.radians(10.0)  # of a joint's range, that a reading may be
APART = np.radians(3.0)  # a range so nearly symmetric has no wrong end
OF_ANGLES = ("joint_angles", "joint_rates", "joint_accelerations", "joint_jerks")


@dataclass(frozen=True)
class WrenchConvention:
    """How a wrench is written; the first value of each is the contract's.

    Attributes:
        axes: `SENSOR` as its pose is stated; the free body's, as it is in the robot's file, or `PUBLISHED`:
            as it was before the robot was prepared; or `WORLD`.
        sign: whose force. about: the point of the moments, fixed in the foot or in the base link.
        order: of the channels.
        yaw: of the world's axes in the base foot's [rad].
    """

    axes: str = SENSOR
    sign: str = ON_ROBOT
    about: str = FOOT
    order: str = FORCES
    yaw: float = 0.0


ASPECTS = {
    "axes": (SENSOR, PREPARED, PUBLISHED, WORLD),
    "sign": (ON_ROBOT, ON_GROUND),
    "about": (FOOT, PREPARED),
    "order": (FORCES, MOMENTS),
}
ALL = tuple(
    WrenchConvention(axes, sign, about, order)
    for axes, sign, about, order in itertools.product(*ASPECTS.values())
)


@dataclass(frozen=True)
class ContactFrames:
    """Where sensors and base link are in the base frame, of m rows.

    Attributes:
        sensors: axes of both sensors, (m, 2, 3, 3). origins: of both, (m, 2, 3) [m].
        body: axes of the base link, (m, 3, 3). place: of its origin, (m, 3) [m].
        published: rotation from the base link's axes to those of the file it was prepared from, (3, 3).
    """

    sensors: np.ndarray
    origins: np.ndarray
    body: np.ndarray
    place: np.ndarray
    published: np.ndarray


def contact_frames(nominal: Nominal, measurements: Measurements) -> ContactFrames:
    """Compute the frames of flat feet from the joint angles."""
    m, tree, contacts = measurements, nominal.parameters.tree, measurements.contacts
    assert contacts is not None
    feet = [tree.frame(foot) for foot in nominal.robot.feet]
    turns, places = nominal_robot(nominal.robot, "mixed").geometry(m.joint_angles, m.support).frames
    pose = np.array([turned_about(one[3:]) for one in contacts.pose])
    arms = (turns[:, feet] @ contacts.pose[:, :3, None])[..., 0]
    # In its initial posture a prepared robot has the world's axes where its published file had the body's.
    (prepared,) = rotation_matrices(nominal.robot.model.body_quat[1:2])
    return ContactFrames(turns[:, feet] @ pose, places[:, feet] + arms, turns[:, 0], places[:, 0], prepared.T)


def in_base(wrenches: np.ndarray, frames: ContactFrames, convention: WrenchConvention) -> np.ndarray:
    """Return logged wrenches in the base frame, on the robot, about the base foot's sole, (m, 2, 6)."""
    c = convention
    values = wrenches if c.order == FORCES else np.roll(wrenches, 3, axis=-1)
    axes = {
        SENSOR: frames.sensors,
        PREPARED: frames.body[:, None],
        PUBLISHED: (frames.body @ frames.published)[:, None],
        WORLD: turned_about(np.array([0.0, 0.0, c.yaw])),
    }[c.axes]
    point = frames.origins if c.about == FOOT else frames.place[:, None]
    force, moment = ((axes @ part[..., None])[..., 0] for part in (values[..., :3], values[..., 3:]))
    sign = 1 if c.sign == ON_ROBOT else -1
    return sign * np.concatenate([force, moment + np.cross(point, force)], axis=-1)


def total_in_base(
    measurements: Measurements, frames: ContactFrames, convention: WrenchConvention
) -> np.ndarray:
    """Return the wrench of all feet that stand, see `in_base`, (m, 6)."""
    assert measurements.wrenches is not None
    stands = feet_in_contact(measurements.support)[..., None]
    each = in_base(np.where(stands, measurements.wrenches, 0.0), frames, convention)
    return each.sum(axis=1)


def in_sensors(wrenches: np.ndarray, frames: ContactFrames, convention: WrenchConvention) -> np.ndarray:
    """Return logged wrenches as the contract has them: in the sensor's frame, on the robot, (m, 2, 6)."""
    there = in_base(wrenches, frames, convention)
    force, moment = there[..., :3], there[..., 3:] - np.cross(frames.origins, there[..., :3])
    parts = [(frames.sensors.mT @ part[..., None])[..., 0] for part in (force, moment)]
    return np.concatenate(parts, axis=-1)


def rewritten(
    measurements: Measurements, frames: ContactFrames, convention: WrenchConvention
) -> Measurements:
    """Return measurements with wrenches as the contract has them, see `in_sensors`."""
    assert measurements.wrenches is not None
    # The turned s.d. would need the readings' covariances; a mean over each triple keeps their size.
    sd = measurements.wrenches_sd
    if sd is not None and convention != WrenchConvention():
        sd = sd if convention.order == FORCES else np.roll(sd, 3, axis=-1)
        size = np.sqrt((sd.reshape(*sd.shape[:2], 2, 3) ** 2).mean(axis=3))
        sd = np.repeat(size, 3, axis=2)
    return replace(
        measurements, wrenches=in_sensors(measurements.wrenches, frames, convention), wrenches_sd=sd
    )


def other_readings(measurements: Measurements, joint_range: np.ndarray) -> Iterator[tuple[str, Measurements]]:
    """Yield what the joints' columns may mean instead, and the measurements if so.

    These are another sign, a zero at the other end of the range, and another order of the roll, pitch and
    yaw of one place. Readings outside a joint's range, (n_joints, 2) [rad], are left out.
    """
    m, joints = measurements, measurements.joints
    logged = [k for k, joint in enumerate(joints) if joint not in m.constant_joints]
    same, plain = np.arange(len(joints)), np.ones(len(joints))
    meanings: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]] = []  # with factor, source and zero
    for k in logged:
        ends, turned = joint_range[k].sum(), np.where(same == k, -1.0, 1.0)
        meanings.append((f"{joints[k]}: sign turned", turned, same, 0.0 * plain))
        if np.isfinite(ends) and abs(ends) > APART:
            what = f"{joints[k]}: counted from the other end of its range"
            meanings.append((what, turned, same, np.where(same == k, ends, 0.0)))
    groups: dict[str, list[int]] = {}
    for k in logged:
        stem = re.sub("roll|pitch|yaw", "*", joints[k])
        if stem != joints[k]:
            groups.setdefault(stem, []).append(k)
    for group in groups.values():
        for order in itertools.permutations(group):
            if list(order) != group:
                source = same.copy()
                source[group] = order
                names, others = (", ".join(joints[k] for k in some) for some in (group, order))
                meanings.append((f"{names}: read in the order {others}", plain, source, 0.0 * plain))
    low, high = joint_range.T
    for what, factor, source, zero in meanings:
        known = {name: values for name in OF_ANGLES if (values := getattr(m, name)) is not None}
        read = {name: factor * values[:, source] for name, values in known.items()}
        read["joint_angles"] += zero
        if ((read["joint_angles"] > low - OUTSIDE) & (read["joint_angles"] < high + OUTSIDE)).all():
            yield what, replace(m, **read)


def shifted(wrench: np.ndarray, time: np.ndarray, lag: float) -> np.ndarray:
    """Return rows of a total wrench, (m, 6), as they were a lag later, by the rising times of the rows."""
    return CubicSpline(time, wrench)(np.clip(time + lag, time[0], time[-1]))
