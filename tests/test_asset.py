"""The nominal model against what the paper fixes."""

import csv

import mujoco
import numpy as np
import pytest

from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.sim.robot import sole_corners

LIMITS = {
    "hip_yaw": ([-40, 40], [-40, 40]),
    "hip_roll": ([-30, 20], [-20, 30]),
    "hip_pitch": ([-90, 40], [-90, 40]),
    "knee": ([0, 120], [0, 120]),
    "ankle_pitch": ([-50, 40], [-50, 40]),
    "ankle_roll": ([-20, 17], [-17, 20]),
}


def test_base_parameters_agree_with_table_2(robot, parameters, model):
    """Those whose relative standard error is below 15 % in the simplified column, within two of them."""
    with (robot.path.parent / "table2.csv").open() as file:
        table = {int(row["number"]): row for row in csv.DictReader(file)}
    well = [
        n for n, row in table.items() if row["simplified_mm"] and float(row["simplified_rel_se_percent"]) < 15
    ]
    assert well == [1, 10, 12, 17, 19, 20, 21, 23, 24]
    for number in well:
        value = 1e3 * parameters.values(standard_parameters(model))[number - 1]
        paper, share = (float(table[number][name]) for name in ("simplified_mm", "simplified_rel_se_percent"))
        assert abs(value - paper) < 2 * abs(paper) * share / 100


def test_height_is_that_of_the_paper(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    head = data.geom("head")
    top = head.xpos[2] + model.geom("head").size[2]
    sole = min((data.body(f).xpos + sole_corners(model, f))[:, 2].min() for f in ("right_foot", "left_foot"))
    assert top - sole == pytest.approx(1.25, abs=1e-9)


@pytest.mark.parametrize("joint", LIMITS)
def test_joint_ranges(joint, model):
    for side, degrees in zip(("right", "left"), LIMITS[joint], strict=True):
        assert np.rad2deg(model.joint(f"{side}_{joint}").range) == pytest.approx(degrees)


def test_axes_point_forward_left_up(model):
    axes = {"yaw": [0, 0, 1], "roll": [1, 0, 0], "pitch": [0, 1, 0], "knee": [0, 1, 0]}
    for i in range(model.njnt):
        name = model.joint(i).name
        for ending, axis in axes.items():
            if name.endswith(ending):
                assert model.jnt_axis[i].tolist() == axis
    assert np.allclose(model.body_quat[1:], [1, 0, 0, 0])


def test_motor_limits_follow_from_power_and_ratio(model):
    no_load = 7500 * 2 * np.pi / 60  # rad/s, assumed
    drives = {
        "hip_yaw": (60, 66),
        "hip_roll": (90, 66),
        "hip_pitch": (90, 111),
        "knee": (90, 111),
        "ankle_pitch": (60, 111),
        "ankle_roll": (60, 66),
    }
    for joint, (power, ratio) in drives.items():
        actuator = model.actuator(f"left_{joint}")
        assert actuator.forcerange[1] == pytest.approx(2 * power / no_load * ratio, rel=0.005)
        assert actuator.user[0] == pytest.approx(no_load / ratio, rel=0.005)
        # Dry friction: 5 % of the torque limit, assumed.
        friction = model.joint(f"left_{joint}").frictionloss[0]
        assert friction == pytest.approx(0.05 * actuator.forcerange[1], rel=0.01)


def test_robot_is_left_right_symmetric(model):
    for i in range(1, model.nbody):
        name = model.body(i).name
        if name.startswith("right_"):
            twin = model.body(name.replace("right", "left"))
            assert twin.mass == model.body(name).mass
            assert twin.pos * [1, -1, 1] == pytest.approx(model.body(name).pos)
            assert twin.ipos * [1, -1, 1] == pytest.approx(model.body(name).ipos)
