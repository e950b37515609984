"""Readings of faulty instruments, worked out by hand.

Simulation and removal of an instrument effect may share a formula: these numbers hold sign and definition.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tulip_testbed.effects.catalogue import catalogue, effects_on
from tulip_testbed.effects.laws import LAW
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.removal import without
from tulip_testbed.identification.observation import observe

KNEE = [0.2, 0.4, -0.1]  # rad
OTHER_KNEE = [0.25, -0.5, 0.5]
COMMAND = [0.21, 0.38, -0.1]  # rad, of the knee
# N, at front left, front right, rear right and rear left.
RIGHT = [[10, 20, 30, 40], [20, 20, 20, 20], [0, 10, 20, 30]]
LEFT = [[50, 60, 70, 80], [40, 40, 40, 40], [100, 60, 20, 20]]
RIGHT_POSE = [[0.01, 0.02, 0.1], [0.01, 0.02, 0.1], [0.01, 0.02, 0.1]]  # m, m, rad
LEFT_POSE = [[-0.01, 0.20, -0.2], [-0.01, 0.20, -0.2], [0.03, 0.25, 0.0]]
CELLS = [[0.1, 0.2], [0.1, -0.2], [-0.1, -0.2], [-0.1, 0.2]]  # m
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
    # at t = 0, 1/2 and 1, sqrt(2) times (4 + 6/3, 0 and -4 - 6/3 N)
    "cell-wander:left.front_left=4,0,6,0": {
        "left": [[58.48528137423857, 60, 70, 80], [40, 40, 40, 40], [91.51471862576143, 60, 20, 20]]
    },
    # sqrt(2) times (10 + 20/2 + 40/4, -20/2 + 40/4 and -10 + 20/2 + 40/4 mrad)
    "encoder-wander:right_knee=0.01,0.02,0,0.04": {"knee": [0.24242640687119285, 0.4, -0.08585786437626905]},
    "common-gain=0.2": {
        "right": [[12, 24, 36, 48], [24, 24, 24, 24], [0, 12, 24, 36]],
        "left": [[60, 72, 84, 96], [48, 48, 48, 48], [120, 72, 24, 24]],
    },
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
    # Half of the plate: 0.1 and 0.2 m. Places of the load over it: (-2/13, 0), (0, 0) and (0.6, 0.2). The
    # centre of pressure moves forward by 10 mm xx + 5 mm xy: 40/169, 0 and 4.2 mm; left by 20 mm yy: 0, 0
    # and 0.8 mm. Moments of 260 and 200 N: 0.8/13 and 0.84 Nm, 0.16 Nm; a cell bears a quarter over its place
    "plate-map:left=0.01,0.005,0,0,0,0.02": {
        "left": [
            [50 + 2 / 13, 60 + 2 / 13, 70 - 2 / 13, 80 - 2 / 13],
            [40, 40, 40, 40],
            [102.3, 61.9, 17.7, 18.1],
        ]
    },
    # reading = angle + 0.001 rad/N times 100, 80 and 60 N on the right plate
    "encoder-load:right_knee=0.001": {"knee": [0.3, 0.48, -0.04]},
    # reading = 0.9 angle + 0.1 previous angle; placement 2 begins afresh
    "lag:right_knee=0.1": {"knee": [0.2, 0.38, -0.1]},
    # first and third column exchanged
    "swapped-cells:right=front_left,rear_right": {
        "right": [[30, 20, 10, 40], [20, 20, 20, 20], [20, 10, 0, 30]]
    },
    # angle + 0.01 sin(2 angle) + 0.02 cos(2 angle)
    "law:encoder:right_knee/own-angle/sine=0.01,0.02,2,-1,1": {
        "knee": [0.222315404, 0.421107695, -0.082385361]
    },
    # angle + 0.05 beyond 0.3 rad
    "law:encoder:right_knee/own-angle/step=0.05,0.3,-1,1": {"knee": [0.2, 0.45, -0.1]},
    # angle + 0.02 times the other knee's 0.25, -0.5 and 0.4 rad over 0.5 rad: 0.5 rad is out of the range
    "law:encoder:right_knee/angle:left_knee/linear=0.02,-0.5,0.4": {"knee": [0.21, 0.38, -0.084]},
    # u = 0.5, 0.4, 0.3 by the load of the right plate over 200 N: angle + 0.01 u + 0.02 u^2
    "law:encoder:right_knee/leg-load/quadratic=0.01,0.02,0,200": {"knee": [0.21, 0.4072, -0.0952]},
    # beyond 0.15 rad of 0.45: angle + 0.03 times 0.05 / 0.3, 0.25 / 0.3 and 0
    "law:encoder:right_knee/own-angle/dead-band=0.03,0.15,-0.4,0.45": {"knee": [0.205, 0.425, -0.1]},
    # a curve through points of a straight line is that line: angle + 0.05 angle
    "law:encoder:right_knee/own-angle/curve=-0.02,-0.01,0,0.01,0.02,-0.4,0.4": {"knee": [0.21, 0.42, -0.105]},
    # the knee is bent further in the second posture; the third begins a placement
    "law:encoder:right_knee/direction/step=0.01": {"knee": [0.2, 0.41, -0.1]},
    # 0.4 + 0.1 (0.2 - 0.4) in the second posture
    "law:encoders:right/posture-before/relaxation=0.1": {"knee": [0.2, 0.38, -0.1]},
    # 2 (1 - exp(-2 t)) N at t = 0, 1/2 and 1
    "law:cell:left.front_left/time/saturating=2,0.5": {
        "left": [[50, 60, 70, 80], [41.264241118, 40, 40, 40], [101.729329434, 60, 20, 20]]
    },
    # 100 s after its placement began: load + 0.1 times 100 / 200 of the load
    "law:cell:left.front_left/time-since-loading/linear-gain=0.1,0,200": {
        "left": [[50, 60, 70, 80], [42, 40, 40, 40], [100, 60, 20, 20]]
    },
    # 1.1, 1.08 and 1.06 times the load
    "law:cells:right/plate-load/linear-gain=0.1,0,100": {
        "right": [[11, 22, 33, 44], [21.6, 21.6, 21.6, 21.6], [0, 10.6, 21.2, 31.8]]
    },
    # x of the load over 0.1 m: -0.153846, 0, 0.6; y over 0.2 m: 0, 0, 0.2; load + x + 2 y
    "law:cell:left.front_left/cop/linear=1,2,-0.1,0.1,-0.2,0.2": {
        "left": [[49.846153846, 60, 70, 80], [40, 40, 40, 40], [101, 60, 20, 20]]
    },
    # recorded = true + (2 mm, -1 mm, 0.01 rad) times 0, 1/2 and 1
    "law:plate:left/time/linear=0.002,-0.001,0.01": {
        "left_pose": [[-0.01, 0.20, -0.2], [-0.009, 0.1995, -0.195], [0.032, 0.249, 0.01]]
    },
}

ROUNDED = 2e-8  # of laws: their readings by hand are rounded, and their removal iterates
UNDONE_BY_LOADS = "logged-command"  # its own tests below
COMMANDED = "logged-command:right_knee=command"


@pytest.fixture(scope="module")
def measured(nominal):
    """Measurements with the true values above, or with readings in their place."""
    joints = nominal.parameters.tree.joints

    def make(
        knee=KNEE, right=RIGHT, left=LEFT, right_pose=RIGHT_POSE, left_pose=LEFT_POSE
    ) -> tt.Measurements:
        angles = np.zeros((3, len(joints)))
        angles[:, joints.index("right_knee")], angles[:, joints.index("left_knee")] = knee, OTHER_KNEE
        command = np.zeros_like(angles)
        command[:, joints.index("right_knee")] = COMMAND
        cells, height, robot = np.array([CELLS, CELLS]), np.zeros(2), dict.fromkeys(("model", "sha256"))
        return tt.Measurements.from_arrays(
            tt.MeasurementHeader(
                robot=robot,
                joints=joints,
                cells=cells,
                top_height=height,
                gravity=9.81,
                sensors=tt.SensorSheet(),
            ),
            posture=np.array([1, 2, 3]),
            placement=np.array(PLACEMENT),
            time=np.array(TIME),
            joint_angles=angles,
            command=command,
            cell_forces=np.hstack([right, left]).astype(float),
            plate_poses=np.stack([right_pose, left_pose], axis=1),
        )

    return make


@pytest.fixture(scope="module")
def fault(robot, nominal):
    """A written effect as two functions: true measurements to faulty ones, and their observation back."""

    def make(text: str):
        found = tt.EffectInstance.parse(text, robot, PLACEMENT)
        mechanism = found.effect.mechanism
        assert isinstance(mechanism, Misreading)
        return (
            lambda true: mechanism.apply(true, robot, found.target, found.values),
            lambda read: mechanism.remove(observe(read, nominal), found.target, found.values),
        )

    return make


def assert_same(found, expected, within=1e-13):
    for name in ("joint_angles", "cell_forces", "plate_poses"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=within, abs=within)


def test_every_instrument_effect_has_a_reading_worked_out_by_hand():
    names = {text.partition("=")[0].partition(":")[0] for text in READINGS} | {UNDONE_BY_LOADS}
    on_plates = {effect.name for effect in effects_on(None) if effect.misreads}
    assert names == on_plates | {LAW}  # those of wrench sensors: tests/test_wrench_sensors.py


@pytest.mark.parametrize("rows", [[0, 1, 2], [2, 0, 1]], ids=["in order", "in another order"])
@pytest.mark.parametrize("text", READINGS)
def test_instruments_misread_by_definition_and_are_corrected(text, rows, measured, fault):
    """Time and placement decide, not the row."""
    misread, corrected = fault(text)
    true, read = measured().take(np.array(rows)), measured(**READINGS[text]).take(np.array(rows))
    within = ROUNDED if text.startswith(LAW) else 1e-13
    assert_same(misread(true), read, within)
    assert_same(corrected(read), true, within)


def test_cells_forget_their_load_when_the_robot_is_set_down_on_one_foot(measured, fault):
    misread, corrected = fault("cell-hysteresis=0.1")
    true = dataclasses.replace(measured(), support=np.array(["double", "right", "right"]))
    # The plates were empty before every posture.
    read = dataclasses.replace(true, cell_forces=0.9 * true.cell_forces)
    assert_same(misread(true), read)
    assert_same(corrected(read), true)


def test_a_logged_command_is_undone_by_the_servo_s_error(measured, fault, nominal):
    """A servo of 25.4 Nm at 0.02 rad has 1270 Nm/rad: it yields to 12.7, -25.4 and 0 Nm by these angles.

    Its dry friction of up to 1.27 Nm, 0.001 rad, opposes the movement upward to the second posture.
    """
    read = fault(COMMANDED)[0](measured())
    assert_same(read, measured(knee=COMMAND))
    observed, knee = observe(read, nominal), read.joints.index("right_knee")
    torques = np.zeros((3, len(read.joints)))
    torques[:, knee] = [12.7, -25.4, 0.0]
    observed.__dict__["loads"] = dataclasses.replace(observed.loads, torques=torques)
    found = catalogue()["logged-command"].remove(observed, "right_knee", (1.0,))
    assert_same(found, measured(knee=[0.22, 0.36 - 0.0008, -0.1]))
    unsure: Any = catalogue()["logged-command"].unsure(observed, "right_knee", (1.0,))
    assert unsure.joint_angles[:, knee] - found.joint_angles[:, knee] == pytest.approx([1e-3, 5e-4, 1e-3])


def test_in_a_motion_friction_opposes_the_rate(measured, fault, nominal):
    """By 1.27 Nm and 1 Nms/rad of 1270 Nm/rad: -1.57, 1.57 and 1.27 Nm at 0.3, -0.3 and nearly 0 rad/s."""
    read = fault(COMMANDED)[0](measured())
    rates, knee = np.zeros((3, len(read.joints))), read.joints.index("right_knee")
    rates[:, knee] = [0.3, -0.3, -1e-9]
    observed = observe(read, nominal)
    observed = dataclasses.replace(observed, measurements=dataclasses.replace(read, joint_rates=rates))
    observed.__dict__["loads"] = dataclasses.replace(observed.loads, torques=np.zeros((3, len(read.joints))))
    found = catalogue()["logged-command"].remove(observed, "right_knee", (1.0,))
    off = found.joint_angles[:, knee] - COMMAND
    assert off == pytest.approx(np.array([-1.57, 1.57, 1.27]) / 1270)


def test_a_logged_command_is_undone_by_the_motor_s_encoder(measured, fault):
    misread, corrected = fault(COMMANDED)
    true = dataclasses.replace(measured(), motor=measured().joint_angles)
    assert_same(misread(true), measured(knee=COMMAND))
    assert_same(corrected(misread(true)), true)


def test_where_the_log_is_not_the_command_the_fault_is_added(measured, fault):
    """The motor is 0.01 rad below, 0.02 above and at the command: a log of commands would err by as much."""
    true = dataclasses.replace(measured(), motor=measured(knee=[0.2, 0.4, -0.1]).joint_angles)
    read = dataclasses.replace(true, joint_angles=measured(knee=[0.3, 0.5, 0.0]).joint_angles)
    assert_same(fault(COMMANDED)[1](read), measured(knee=[0.31, 0.48, 0.0]))


def test_without_commands_there_is_no_logged_command(measured, fault):
    without = dataclasses.replace(measured(), command=None)
    for text, true in ((COMMANDED, without), ("logged-command:right_knee=encoder", measured())):
        misread, corrected = fault(text)
        assert_same(misread(true), true)
        assert_same(corrected(true), true)


def test_a_part_of_an_experiment_creeps_as_in_the_whole(measured, nominal):
    """Its first load was there before: 90 % of the creep under the 40 N of the second posture."""
    observed = observe(measured(), nominal).take(np.array([1]))
    found = catalogue()["creep"].remove(observed, "left.front_left", (0.2, 0.21714724095162588))
    assert found.cell_forces[:, 4] == pytest.approx([40 / (1 + 0.9 * 0.2)])


def test_a_cell_in_the_air_is_seen_though_it_reads_a_part_of_the_others_load(measured, nominal):
    """Cross-talk of 0.9 % of 120 N makes 1.08 N of nothing: a board's twist on three cells says nothing."""
    share = observe(measured(), nominal).board_share[0]
    loads = np.array([[40, 40, 40, 1.08 - share], [40, 40, 40, 3.0 - share], [30, 30, 30, 30]])
    observed = observe(measured(right=loads), nominal)
    assert observed.on_four_cells[:, 0].tolist() == [False, True, True]


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
    found = catalogue()["rocking"].remove(observed, "right.front_left", (0.00141421356,))
    assert found.stance_tilt == pytest.approx(
        np.array([[-0.00707107, 0.00707107], [0, 0], [-0.00353553, 0.00353553]]), abs=1e-8
    )
    assert found.swing_rise == pytest.approx([-0.000353553, 0, -0.000176777], abs=1e-9)
    assert not found.swing_tilt.any()


def test_a_law_warns_of_postures_beyond_its_range(measured, nominal, robot):
    law = tt.EffectInstance.parse("law:encoder:right_knee/own-angle/linear=0.01,-0.05,0.3", robot)
    with pytest.warns(UserWarning, match="postures 2, 3 outside the range"):
        without(measured(), nominal, [law])
