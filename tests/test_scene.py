"""The scene that is built for a robot without one against the scene that was written by hand."""

import dataclasses
import re

import mujoco
import numpy as np
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.joint_loads import servo_stiffness
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.control import Controller, add_servos, torque_limit, torque_limits
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import joint_names, load_robot
from tulip_testbed.sim.scene import laboratory_scene, load_scene

POSES = np.array([[0.03, -0.16, 0.02], [0.05, 0.17, -0.01]])
# What is observed and what things are called; everything else is physics.
LOOKS = re.compile(
    r"(n?(light|mat|tex|names?|skin|vis)(_|$|map|data))|nnames_map|nbuffer|signature|geom_matid|paths|ntex|nmat"
)


@pytest.fixture(scope="module")
def models(robot):
    """Shipped and built, compiled as the laboratory compiles them."""
    robots = (robot, dataclasses.replace(robot, scene_file=None))
    return [laboratory_scene(preset_rig("ideal", r), POSES).compile() for r in robots]


def test_every_physical_number_is_the_same(models):
    shipped, built = models
    compared = 0
    for owner in ("", "opt"):
        a, b = (getattr(m, owner) if owner else m for m in models)
        for name in dir(a):
            value = None if name.startswith("_") or LOOKS.match(name) else getattr(a, name)
            if isinstance(value, int | float | np.ndarray):
                assert np.array_equal(value, getattr(b, name)), name
                compared += 1
    assert compared > 300
    assert shipped.npair == built.npair == 8


def test_names_are_the_same(models):
    counts = {"body": "nbody", "joint": "njnt", "geom": "ngeom", "site": "nsite", "sensor": "nsensor"}
    counts |= {"pair": "npair", "actuator": "nu", "key": "nkey"}
    for kind, count in counts.items():
        names = [[getattr(m, kind)(i).name for i in range(getattr(m, count))] for m in models]
        assert names[0] == names[1]


def test_the_boards_top_is_at_zero_and_only_soles_touch(foreign):
    for robot in foreign.values():
        model = load_scene(robot).compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        top = data.geom("left_plate_top")
        assert top.xpos[2] + model.geom("left_plate_top").size[2] == pytest.approx(0, abs=1e-15)
        soles = {f"{foot}_{corner}" for foot in robot.feet for corner in CORNERS}
        touching = {model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] == 1}
        assert touching == soles
        assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_own_plate(edited_tulip):
    robot = edited_tulip('plate.xml: size="0.25 0.15 0.015" => size="0.3 0.2 0.015"')
    assert load_scene(robot).geom("right_plate_top").size[:2] == pytest.approx([0.3, 0.2])
    assert [path.name for path in robot.files] == ["tulip.toml", "tulip.xml", "plate.xml"]


MOTORS = {
    '<motor gear="40" ctrlrange="-0.5 0.5"': 20.0,
    '<motor gear="-40" ctrlrange="-1 1" forcerange="-2 2"': 40.0,
    '<motor gear="2" forcerange="-5 3"': 6.0,
    '<position kp="9" forcerange="-7 7"': 7.0,
    '<general gainprm="4" ctrlrange="-2 2"': 8.0,
    '<motor gear="2" ctrlrange="-100 100"': 50.0,  # the joint's own limit
}


def one_joint(motor: str, limit: str = "") -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(
        f'<mujoco model="arm"><worldbody><body><joint name="elbow" {limit}/><geom size="0.1"/></body>'
        f'</worldbody><actuator>{motor} name="m" joint="elbow"/></actuator></mujoco>'
    )


@pytest.mark.parametrize("motor", MOTORS)
def test_torque_limit_is_that_on_the_joint(motor):
    """Held against what MuJoCo does: the servo, far off its command, pushes with this torque."""
    spec = one_joint(motor, 'actuatorfrcrange="-50 50"')
    assert torque_limit(spec, spec.actuators[0]) == pytest.approx(MOTORS[motor])
    add_servos(spec, Controller())
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(MOTORS[motor])


def test_planner_laboratory_and_identification_know_one_limit(edited_tulip, robot, plate):
    """Of position servos, whose ctrlrange is an angle; their limits are the joints' actuatorfrcrange."""
    folder = edited_tulip(built=False).folder
    text = (folder / "tulip.xml").read_text()
    motor = re.compile(r'(<joint armature[^>]*)/>(\s*)<motor ctrlrange="[^"]*" forcerange="([^"]*)"')
    servos = r'\1 actuatorfrcrange="\3"/>\2<position kp="300" ctrlrange="-1.2 0.9"'
    text, count = motor.subn(servos, text)
    assert count == 4
    (folder / "tulip.xml").write_text(text.replace("<motor name", "<position name"))
    other = load_robot(folder / "tulip.toml")
    limits = torque_limits(robot).tolist()
    assert torque_limits(other).tolist() == limits
    assert planning_problem(other, plate).torques[:, 1].tolist() == limits
    assert servo_stiffness(other, {}) == pytest.approx(servo_stiffness(robot, {}))
    names = list(joint_names(other.model))
    for actuator in laboratory_scene(preset_rig("ideal", other), POSES).actuators:
        assert actuator.forcerange[1] == limits[names.index(actuator.target)]


@pytest.mark.parametrize("motor", ["<motor", '<position kp="9" ctrlrange="-1 1"', '<muscle ctrlrange="0 1"'])
def test_no_torque_limit_is_refused(motor):
    with pytest.raises(
        InputError, match=r"model 'arm': actuator 'm': found no torque limit, expected forcerange"
    ):
        add_servos(one_joint(motor), Controller())
