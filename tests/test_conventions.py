"""The audit of conventions: records of a robot 10 % off, on a rocking foot, with cross-talk, by MuJoCo."""

import copy
import dataclasses
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.first_look import cases
from tests.moving_robots import GRAVITY, by_inverse_dynamics, moving, random_robot
from tulip_testbed.identification.conventions.audit_conventions import (
    DECISIVE,
    NAMES,
    Conventions,
    _best_two,
    audit_conventions,
)
from tulip_testbed.identification.conventions.log_conventions import (
    FOOT,
    FORCES,
    MOMENTS,
    ON_GROUND,
    ON_ROBOT,
    PREPARED,
    PUBLISHED,
    SENSOR,
    WORLD,
    WrenchConvention,
    contact_frames,
)
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import Measurements

COUNT, STEP = 90, 0.25  # rows, s
ROCKING = np.radians([0.5, 0.8]) / 0.06  # rad for the weight at one metre
YAW = np.radians(50.0)
PUBLISHED_YAW = np.radians(90.0)


class Record(NamedTuple):
    """A robot by its file, its motion, what its sensor reads, and where free body and foot are."""

    robot: object
    motion: Measurements
    wrench: np.ndarray
    body: np.ndarray
    place: np.ndarray
    tilt: np.ndarray


@pytest.fixture(scope="module")
def record(foreign) -> Record:
    rng, nominal = np.random.default_rng(220), foreign["humanoid"]
    model = copy.copy(nominal.model)
    model.body_quat[1] = np.roll(Rotation.from_euler("z", PUBLISHED_YAW).as_quat(), 1)
    robot = dataclasses.replace(nominal, model=model)
    true, side = random_robot(nominal, rng, 0.1), 1
    m, time = moving(robot, rng, COUNT), STEP * np.arange(COUNT)
    shape = 3, len(m.joints)
    pace, phase = 2 * np.pi * rng.uniform(0.02, 0.15, shape), rng.uniform(0, 6, shape)
    angle = pace * time[:, None, None] + phase
    low, high = nominal_robot(robot).parameters.tree.joint_range.T
    half = np.minimum((high - low) / 6, 0.1)
    m = dataclasses.replace(
        m,
        time=time,
        support=np.full(COUNT, "left"),
        joint_angles=np.clip(0.0, low + 3 * half, high - 3 * half) + half * np.sin(angle).sum(axis=1),
        joint_rates=half * (pace * np.cos(angle)).sum(axis=1),
        joint_accelerations=-half * (pace**2 * np.sin(angle)).sum(axis=1),
    )
    sole, weight = nominal_robot(robot).points[side], nominal_robot(robot).mass * GRAVITY
    units = np.repeat([1.0, 0.03], 3)
    talk = np.eye(6) + 0.01 * rng.standard_normal((6, 6)) * units[:, None] / units
    wrench, body = np.empty((COUNT, 6)), np.empty((COUNT, 3, 3))
    place, tilts = np.empty((COUNT, 3)), np.empty((COUNT, 3, 3))
    moving_joints = np.array([m.joint_angles, m.joint_rates, m.joint_accelerations])
    for row in range(COUNT):
        motion = moving_joints[:, row]
        level, *_ = by_inverse_dynamics(true, robot.swing_foot, sole, *motion)
        tilt = Rotation.from_rotvec([*(ROCKING * level[3:5] / weight), 0.0])
        gravity = tilt.inv().apply([0, 0, -GRAVITY])
        found = by_inverse_dynamics(true, robot.swing_foot, sole, *motion, gravity=gravity)
        wrench[row], body[row], place[row], _ = found
        tilts[row] = tilt.as_matrix()
    noise = rng.standard_normal((COUNT, 6)) * np.repeat([0.3, 0.02], 3)
    return Record(robot, m, wrench @ talk.T + np.repeat([2.0, 0.1], 3) + noise, body, place, tilts)


def logged(record: Record, convention: WrenchConvention) -> Any:
    """The record as a log with this convention has it; its sensor is at the origin of the foot's frame."""
    force, moment = record.wrench[:, :3], record.wrench[:, 3:]
    sensor = -nominal_robot(record.robot).points[1]
    moment = moment - np.cross(sensor if convention.about == FOOT else record.place, force)
    published = Rotation.from_euler("z", PUBLISHED_YAW).as_matrix().T
    axes = {
        SENSOR: np.eye(3),
        PREPARED: record.body,
        PUBLISHED: record.body @ published,
        WORLD: record.tilt.mT @ Rotation.from_euler("z", convention.yaw).as_matrix(),
    }[convention.axes]
    parts = [(np.swapaxes(axes, -1, -2) @ part[..., None])[..., 0] for part in (force, moment)]
    rows = np.concatenate(parts if convention.order == FORCES else parts[::-1], axis=1)
    wrenches = np.zeros((len(rows), 2, 6))
    wrenches[:, 1] = rows if convention.sign == ON_ROBOT else -rows
    return dataclasses.replace(record.motion, wrenches=wrenches)


OTHERS = [WrenchConvention(), WrenchConvention(PREPARED, ON_GROUND), WrenchConvention(PUBLISHED)]
OTHERS += [WrenchConvention(WORLD, ON_GROUND, yaw=YAW)]


@cases("convention", [WrenchConvention(PREPARED, ON_ROBOT, PREPARED, MOMENTS)], [(one,) for one in OTHERS])
def test_the_convention_of_a_record_is_found_and_undone(convention, record):
    found: Any = audit_conventions(logged(record, convention), nominal_robot(record.robot))
    assert dataclasses.replace(found.convention, yaw=0.0) == dataclasses.replace(convention, yaw=0.0)
    assert found.problems == ()
    if convention.axes == WORLD:
        assert found.convention.yaw == pytest.approx(YAW, abs=np.radians(3))
    else:
        expected = logged(record, WrenchConvention()).wrenches[:, 1]
        assert found.applied.wrenches[:, 1] == pytest.approx(expected, abs=1e-9)
    for what in NAMES.values():
        best, second, *_ = (row for row in found.rows if row.what == what)
        assert best.applied
        assert not second.applied
        assert second.log_likelihood < -DECISIVE


def test_the_zero_of_a_foot_in_the_air_tells_the_axes(record):
    """The weight of that foot hangs below its sensor, too."""
    nominal, some = nominal_robot(record.robot), np.arange(0, COUNT, 6)
    log = logged(record, WrenchConvention(PREPARED)).take(some)
    zero, weight = np.array([24.0, -6.0, 24.0]), 0.01 * nominal_robot(record.robot).mass * GRAVITY
    force = contact_frames(nominal, log).sensors[:, 0] @ zero - [0.0, 0.0, weight]
    wrenches = log.wrenches.copy()
    wrenches[:, 0, :3] = (record.body[some].mT @ force[..., None])[..., 0]
    silent = audit_conventions(log, nominal)
    found = audit_conventions(dataclasses.replace(log, wrenches=wrenches), nominal)
    assert found.convention == WrenchConvention(PREPARED)
    for axes in (SENSOR, WORLD, PUBLISHED):
        before, after = (next(r for r in one.rows if r.hypothesis == axes) for one in (silent, found))
        assert after.log_likelihood < before.log_likelihood - DECISIVE


@cases("joint", ["left_knee"], ["abdomen_y", "right_hip_y"])
def test_joints_that_are_read_wrongly_are_told(joint, record):
    log = logged(record, WrenchConvention())
    turned = np.where(np.array(log.joints) == joint, -1.0, 1.0)
    angles = ("joint_angles", "joint_rates", "joint_accelerations")
    wrong = dataclasses.replace(log, **{name: turned * getattr(log, name) for name in angles})
    found = audit_conventions(wrong, nominal_robot(record.robot))
    assert any(f"{joint}: sign turned" in text for text in found.problems)


@pytest.mark.slow
def test_a_delay_of_the_sensors_is_measured(record):
    found = _audited_late(record, 0.1)
    assert found.lag[0] == pytest.approx(0.1, abs=4 * found.lag[1])
    assert found.lag[1] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("late", "side"), [(0.6, "behind"), (-0.6, "ahead of")])
def test_a_delay_beyond_those_that_are_tried_is_told(late, side, record):
    assert f"the contact sensors are 0.5 s or more {side} the joints" in _audited_late(record, late).problems


def _audited_late(record: Record, late: float) -> Conventions:
    """Audit a log whose left wrenches come late [s]."""
    log = logged(record, WrenchConvention())
    wrenches = log.wrenches.copy()
    wrenches[:, 1] = np.transpose([np.interp(log.time - late, log.time, c) for c in wrenches[:, 1].T])
    return audit_conventions(dataclasses.replace(log, wrenches=wrenches), nominal_robot(record.robot))


def test_the_best_two_conventions_differ_in_more_than_a_yaw():
    world = [WrenchConvention(WORLD, yaw=yaw) for yaw in (0.0, 0.1)]
    first, second = _best_two([*world, WrenchConvention()])
    assert "axes of the wrench: world" in first
    assert "axes of the wrench: sensor" in second


@pytest.mark.slow
def test_a_record_that_fits_nothing_says_so_with_the_best_two(record):
    log = logged(record, WrenchConvention())
    rng = np.random.default_rng(221)
    turns = Rotation.random(len(log), rng=rng)
    wrenches = log.wrenches.copy()
    wrenches[:, 1, :3] = turns.apply(wrenches[:, 1, :3])
    log = dataclasses.replace(log, wrenches=wrenches)
    found = audit_conventions(log, nominal_robot(record.robot))
    assert "no convention explains the wrenches" in found.problems[0]
    assert found.convention == WrenchConvention()
    assert found.applied.wrenches is log.wrenches
