"""Readings of faulty instruments, worked out by hand.

Simulation and removal of an instrument effect may share a formula: these numbers hold sign and definition.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Misreading
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.instruments import effects_on
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements, SensorSheet

KNEE = [0.2, 0.4, -0.1]  # rad
COMMAND = [0.21, 0.38, -0.1]  # rad, of the knee
# N, at front left, front right, rear right and rear left.
RIGHT = [[10, 20, 30, 40], [20, 20, 20, 20], [0, 10, 20, 30]]
LEFT = [[50, 60, 70, 80], [40, 40, 40, 40], [100, 60, 20, 20]]
RIGHT_POSE = [[0.01, 0.02, 0.1], [0.01, 0.02, 0.1], [0.01, 0.02, 0.1]]  # m, m, rad
LEFT_POSE = [[-0.01, 0.20, -0.2], [-0.01, 0.20, -0.2], [0.03, 0.25, 0.0]]
TIME = [100.0, 200.0, 300.0]  # s: 0, 1/2 and 1 of the experiment's
PLACEMENT = [1, 1, 2]

# What the faulty instruments give for the true values above, by the fields that differ.
READINGS = {
    # reading = angle + 0.01
    "encoder-offset:right_knee=0.01": {"knee": [0.21, 0.41, -0.09]},
    # reading = 1.02 angle
    "encoder-gain:right_knee=0.02": {"knee": [0.204, 0.408, -0.102]},
    # reading = angle + 0.05 from half of the time on
    "encoder-slip:right_knee=0.05,0.5": {"knee": [0.2, 0.45, -0.05]},
    # recorded = true - (3, -2) mm
    "plate-translation:left=0.003,-0.002": {
        "left_pose": [[-0.013, 0.202, -0.2], [-0.013, 0.202, -0.2], [0.027, 0.252, 0.0]]
    },
    # recorded = true - 0.01 rad
    "plate-yaw:right=0.01": {"right_pose": [[0.01, 0.02, 0.09], [0.01, 0.02, 0.09], [0.01, 0.02, 0.09]]},
    # recorded = true - (10, -5) mm in placement 2
    "placement-blunder:2=0.01,-0.005": {
        "left_pose": [[-0.01, 0.20, -0.2], [-0.01, 0.20, -0.2], [0.02, 0.255, 0.0]]
    },
    # reading = 1.1 load
    "cell-gain:left.front_left=0.1": {"left": [[55, 60, 70, 80], [44, 40, 40, 40], [110, 60, 20, 20]]},
    # reading = load + 3 N
    "cell-tare:right.front_right=3": {"right": [[10, 23, 30, 40], [20, 23, 20, 20], [0, 13, 20, 30]]},
    # reading = load + 0, 2 and 4 N
    "cell-drift:left.rear_left=4": {"left": [[50, 60, 70, 80], [40, 40, 40, 42], [100, 60, 20, 24]]},
    # reading = 1, 1.1 and 1.2 times the load
    "thermal-gain-drift=0.2": {
        "right": [[10, 20, 30, 40], [22, 22, 22, 22], [0, 12, 24, 36]],
        "left": [[50, 60, 70, 80], [44, 44, 44, 44], [120, 72, 24, 24]],
    },
    # reading = load + a tenth of the other three loads, whose sums are 90, 80, 70, 60; 60; 60, 50, 40, 30 N
    # and 210, 200, 190, 180; 120; 100, 140, 180, 180 N
    "cell-crosstalk=0.1": {
        "right": [[19, 28, 37, 46], [26, 26, 26, 26], [6, 15, 24, 33]],
        "left": [[71, 80, 89, 98], [52, 52, 52, 52], [110, 74, 38, 38]],
    },
    # reading = 0.9 load + 0.1 previous load, which is 0 in the first posture of each placement
    "cell-hysteresis=0.1": {
        "right": [[9, 18, 27, 36], [19, 20, 21, 22], [0, 9, 18, 27]],
        "left": [[45, 54, 63, 72], [41, 42, 43, 44], [90, 54, 18, 18]],
    },
    # A tenth of the creep is kept from one posture to the next. Loads 50, 40 and 100 N, means 45 and 70 N:
    # creep 0, 0.9 x 0.2 x 45 = 8.1 and 0.1 x 8.1 + 0.9 x 0.2 x 70 = 13.41 N
    "creep:left.front_left=0.2,0.21714724095162588": {
        "left": [[50, 60, 70, 80], [48.1, 40, 40, 40], [113.41, 60, 20, 20]]
    },
    # reading = load + 0, 2 and 4 N in all four cells
    "plate-drift:right=4": {"right": [[10, 20, 30, 40], [22, 22, 22, 22], [4, 14, 24, 34]]},
    # reading = angle + 0.001 rad/N times 100, 80 and 60 N on the right plate
    "encoder-load:right_knee=0.001": {"knee": [0.3, 0.48, -0.04]},
    # reading = 0.9 angle + 0.1 previous angle; placement 2 begins afresh
    "lag:right_knee=0.1": {"knee": [0.2, 0.38, -0.1]},
    # first and third column exchanged
    "swapped-cells:right=front_left,rear_right": {
        "right": [[30, 20, 10, 40], [20, 20, 20, 20], [20, 10, 0, 30]]
    },
}

UNDONE_BY_LOADS = "logged-command"  # its own test below


@pytest.fixture(scope="module")
def measured(nominal):
    """Measurements with the true values above, or with readings in their place."""
    joints = nominal.parameters.tree.joints

    def make(knee=KNEE, right=RIGHT, left=LEFT, right_pose=RIGHT_POSE, left_pose=LEFT_POSE) -> Measurements:
        angles = np.zeros((3, len(joints)))
        angles[:, joints.index("right_knee")] = knee
        command = np.zeros_like(angles)
        command[:, joints.index("right_knee")] = COMMAND
        forces = np.hstack([right, left]).astype(float)
        return Measurements(
            joints=joints,
            posture=np.array([1, 2, 3]),
            placement=np.array(PLACEMENT),
            support=np.array(["double"] * 3),
            time=np.array(TIME),
            window=np.ones(3),
            samples=np.ones(3, int),
            joint_angles=angles,
            joint_angles_sd=np.zeros_like(angles),
            command=command,
            motor=None,
            cell_forces=forces,
            cell_forces_sd=np.zeros_like(forces),
            plate_poses=np.stack([right_pose, left_pose], axis=1),
            cells=np.zeros((2, 4, 2)),
            top_height=np.zeros(2),
            weighed_mass=None,
            gravity=9.81,
            sensors=SensorSheet(),
            robot={"model": None, "sha256": None, "stance_foot": None, "swing_foot": None},
        )

    return make


def misreading(text, robot) -> tuple[Misreading, str, tuple[float, ...]]:
    found = EffectInstance.parse(text, robot, PLACEMENT)
    assert isinstance(found.effect.mechanism, Misreading)
    mechanism = found.effect.mechanism
    return mechanism, mechanism.acts_on(robot, found.target), found.values


def assert_same(found, expected):
    for name in ("joint_angles", "cell_forces", "plate_poses"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-13, abs=1e-13)


def rearranged(m: Measurements, rows) -> Measurements:
    names = (
        "posture",
        "placement",
        "support",
        "time",
        "joint_angles",
        "command",
        "cell_forces",
        "plate_poses",
    )
    return dataclasses.replace(m, **{name: getattr(m, name)[rows] for name in names})


def test_every_instrument_effect_has_a_reading_worked_out_by_hand(robot):
    names = [EffectInstance.parse(text, robot, PLACEMENT).effect.name for text in READINGS]
    names.append(UNDONE_BY_LOADS)
    on_plates = [effect.name for effect in effects_on(None) if effect.misreads]
    assert sorted(names) == on_plates  # those of wrench sensors: tests/test_wrench_sensors.py


@pytest.mark.parametrize("text", READINGS)
def test_instruments_misread_by_definition(text, measured, robot):
    mechanism, target, values = misreading(text, robot)
    assert_same(mechanism.apply(measured(), target, values), measured(**READINGS[text]))


@pytest.mark.parametrize("text", READINGS)
def test_misreadings_are_corrected_by_definition(text, measured, nominal, robot):
    mechanism, target, values = misreading(text, robot)
    observed = observe(measured(**READINGS[text]), nominal)
    assert_same(mechanism.undo(observed, target, values), measured())


@pytest.mark.parametrize("text", READINGS)
def test_the_order_of_rows_does_not_matter(text, measured, nominal, robot):
    """Time and placement decide, not the row."""
    mechanism, target, values = misreading(text, robot)
    rows = [2, 0, 1]
    true, read = rearranged(measured(), rows), rearranged(measured(**READINGS[text]), rows)
    assert_same(mechanism.apply(true, target, values), read)
    assert_same(mechanism.undo(observe(read, nominal), target, values), true)


def test_cells_forget_their_load_when_the_robot_is_set_down_on_one_foot(measured, nominal, robot):
    mechanism, target, values = misreading("cell-hysteresis=0.1", robot)
    support = np.array(["double", "right", "right"])
    true = dataclasses.replace(measured(), support=support)
    forces = 0.9 * true.cell_forces  # the plates were empty before every posture
    read = dataclasses.replace(true, cell_forces=forces)
    assert_same(mechanism.apply(true, target, values), read)
    assert_same(mechanism.undo(observe(read, nominal), target, values), true)


def test_a_logged_command_is_undone_by_the_servo_s_error(measured, nominal, robot):
    """A servo of 25.4 Nm at 0.02 rad has 1270 Nm/rad: it yields to 12.7, -25.4 and 0 Nm by these angles."""
    mechanism, target, values = misreading("logged-command:right_knee=command", robot)
    read = mechanism.apply(measured(), target, values)
    assert_same(read, measured(knee=COMMAND))
    observed, knee = observe(read, nominal), read.joints.index("right_knee")
    torques = np.zeros((3, len(read.joints)))
    torques[:, knee] = [12.7, -25.4, 0.0]
    observed.__dict__["loads"] = dataclasses.replace(observed.loads, torques=torques)
    assert_same(mechanism.undo(observed, target, values), measured(knee=[0.22, 0.36, -0.1]))


def test_a_logged_command_is_undone_by_the_motor_s_encoder(measured, nominal, robot):
    mechanism, target, values = misreading("logged-command:right_knee=command", robot)
    true = dataclasses.replace(measured(), motor=measured().joint_angles)
    read = mechanism.apply(true, target, values)
    assert_same(read, measured(knee=COMMAND))
    assert_same(mechanism.undo(observe(read, nominal), target, values), true)


def test_where_the_log_is_not_the_command_the_fault_is_added(measured, nominal, robot):
    """The motor is 0.01 rad below, 0.02 above and at the command: a log of commands would err by as much."""
    mechanism, target, values = misreading("logged-command:right_knee=command", robot)
    true = dataclasses.replace(measured(), motor=measured(knee=[0.2, 0.4, -0.1]).joint_angles)
    read = dataclasses.replace(true, joint_angles=measured(knee=[0.3, 0.5, 0.0]).joint_angles)
    added = mechanism.undo(observe(read, nominal), target, values)
    assert_same(added, measured(knee=[0.31, 0.48, 0.0]))


def test_a_board_rocks_towards_its_short_foot_by_hand(measured, nominal):
    """Cells at (+-0.1, +-0.1) m, the front left foot short by sqrt(2) mm, sqrt(0.02) m from its diagonal.

    The board falls 0.01 m/m towards front left: 0.01 / sqrt(2) = 0.00707 both forwards, a pitch, and to the
    left, a negative roll. Its diagonal passes 0.05 m in front of the sole point, which so rises by 0.00707 x
    0.05 = 0.354 mm; the swing foot is lower by that. Under a load at the rear right the board is level, on
    the diagonal half way.
    """
    corners = [[0.1, 0.1], [0.1, -0.1], [-0.1, -0.1], [-0.1, 0.1]]
    loads = [[40, 10, 0, 10], [0, 10, 40, 10], [0, 25, 0, 25]]
    true = measured(right=loads, right_pose=[[0.05, 0.0, 0.0]] * 3)
    observed = observe(dataclasses.replace(true, cells=np.array([corners, corners])), nominal)
    assert not observed.on_four_cells[:, 0].any()
    found = catalogue()["rocking"].predict(observed, "right.front_left", (0.00141421356,))
    assert found.stance_tilt == pytest.approx(
        np.array([[-0.00707107, 0.00707107], [0, 0], [-0.00353553, 0.00353553]]), abs=1e-8
    )
    assert found.swing_rise == pytest.approx([-0.000353553, 0, -0.000176777], abs=1e-9)
    assert not found.swing_tilt.any()


def test_without_commands_there_is_no_logged_command(measured, nominal, robot):
    mechanism, target, values = misreading("logged-command:right_knee=command", robot)
    without = dataclasses.replace(measured(), command=None)
    assert_same(mechanism.apply(without, target, values), without)
    assert_same(mechanism.undo(observe(without, nominal), target, values), without)
    encoder = misreading("logged-command:right_knee=encoder", robot)[2]
    assert_same(mechanism.apply(measured(), target, encoder), measured())
    assert_same(mechanism.undo(observe(measured(), nominal), target, encoder), measured())


def test_a_part_of_an_experiment_creeps_as_in_the_whole(measured, nominal, robot):
    """Its first load was there before: 90 % of the creep under the 40 N of the second posture."""
    mechanism, target, values = misreading("creep:left.front_left=0.2,0.21714724095162588", robot)
    observed = observe(measured(), nominal).take(np.array([1]))
    loads = mechanism.undo(observed, target, values).cell_forces[:, 4]
    assert loads == pytest.approx([40 / (1 + 0.9 * 0.2)])
