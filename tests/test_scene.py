"""Scenes, features of MJCF and files of a robot: built, changed while in use, or fatal to a compiler."""

import copy
import dataclasses
import pickle
import re
import shutil

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_files import change_texts
from tests.edited_rows import changed, plus
from tests.statics_against_dynamics import without_friction
from tests.test_equilibrium import check_rest
from tests.test_refusals import refuse
from tulip_testbed.identification.joint_loads import servo_stiffness
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim import sandbox
from tulip_testbed.sim.control import Controller, add_servos, torque_limit, torque_limits
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import joint_names, load_robot, load_spec
from tulip_testbed.sim.scene import laboratory_scene, load_scene
from tulip_testbed.sim.shipped import PLANS
from tulip_testbed.sim.statics.solved_plan import solve_plan

POSES = np.array([[0.03, -0.16, 0.02], [0.05, 0.17, -0.01]])
# What is observed and what things are called; everything else is physics.
LOOKS = re.compile(
    r"(n?(light|mat|tex|names?|skin|vis)(_|$|map|data))|nnames_map|nbuffer|signature|geom_matid|paths|ntex|nmat"
)


def test_every_physical_number_is_the_same(robot):
    """Shipped and built, compiled as the laboratory compiles them."""
    robots = (robot, dataclasses.replace(robot, scene_file=None))
    models = [laboratory_scene(preset_rig("ideal", r), POSES).compile() for r in robots]
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


@pytest.mark.parametrize("motor", MOTORS)
def test_torque_limit_is_that_on_the_joint(motor):
    """Held against what MuJoCo does: the servo, far off its command, pushes with this torque."""
    spec = mujoco.MjSpec.from_string(
        '<mujoco model="arm"><worldbody><body><joint name="elbow" actuatorfrcrange="-50 50"/>'
        f'<geom size="0.1"/></body></worldbody><actuator>{motor} name="m" joint="elbow"/></actuator></mujoco>'
    )
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
    assert planning_problem(other, plate).torques.tolist() == limits
    assert servo_stiffness(other, {}) == pytest.approx(servo_stiffness(robot, {}))
    names = list(joint_names(other.model))
    for actuator in laboratory_scene(preset_rig("ideal", other), POSES).actuators:
        assert actuator.forcerange[1] == limits[names.index(actuator.target)]


def floating(spec):
    spec.body("torso").gravcomp = 0.5


def tied(spec):
    spec.body("torso").add_site(name="a", pos=[0, 0, 0.1])
    spec.body("left_foot").add_site(name="b")
    tendon = spec.add_tendon(name="between", stiffness=10.0)
    tendon.wrap_site("a")
    tendon.wrap_site("b")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (floating, "static equilibrium: found gravcomp in body 'torso'"),
        (tied, "tendon 'between': expected joints, or one site on the robot"),
    ],
)
def test_an_edit_that_statics_does_not_have_is_refused_by_it(robot, two, edit, words):
    refuse(words, solve_plan, dataclasses.replace(preset_rig("ideal", robot), edit=edit), two)


REF = 0.5  # rad


@pytest.mark.slow
def test_a_joint_that_is_drawn_bent_is_the_same_robot(edited_tulip, robot):
    """`ref` moves the zero of a joint's angle; static run and dynamics agree, and with the robot without."""
    degrees = np.degrees(REF)
    drive = '<joint name="right_knee" class="drive_90w_111"'
    moved = f'ref="{degrees}" range="{degrees} {120 + degrees}"'
    bent = edited_tulip(f'tulip.xml: {drive} range="0 120" => {drive} {moved}')
    plan = read_plan(PLANS / "random", robot)
    plan = plan.take(np.flatnonzero(plan.placement == 2))
    shifted = changed(plan, joint_angles=plus(REF, ..., plan.joints.index("right_knee")))
    found = {}
    for name, one, at in (("plain", robot, plan), ("bent", bent, shifted)):
        rig = dataclasses.replace(preset_rig("ideal", one), edit=without_friction())
        found[name] = solve_plan(rig, at).reference
        assert found[name].solved.all()
    knee = solve_plan(rig, shifted).mechanism.names.index("right_knee")
    difference = found["bent"].state.angles - found["plain"].state.angles
    expected = np.zeros(difference.shape[1])
    expected[knee] = REF
    assert np.abs(difference - expected).max() < 1e-6
    check_rest(rig, shifted)
    soles = [nominal_robot(one).swing_sole(at.joint_angles) for one, at in ((robot, plan), (bent, shifted))]
    assert np.abs(soles[0] - soles[1]).max() < 1e-9


@pytest.fixture
def own(edited_tulip):
    """The description of a copy of TULip that may be edited."""
    return edited_tulip(built=False).path


def edit(path, old, new):
    change_texts(path.parent, [f"{path.name}: {old} => {new}"])


def test_a_robot_is_what_its_files_held_when_it_was_loaded(own):
    robot = tt.load_robot(own)
    edit(own.with_name("tulip.xml"), 'mass="10.7"', 'mass="20.7"')
    assert robot.model_hash == tt.load_robot().model_hash
    assert copy.deepcopy(robot) is robot
    with pytest.raises(tt.InputError, match=r"tulip\.xml was changed while the robot was in use"):
        tt.Laboratory(robot).run(tt.plans.random, engine="statics")
    refuse("a file of the robot was changed", pickle.loads, pickle.dumps(robot))


def test_an_included_file_and_another_working_directory(own, tmp_path, monkeypatch):
    own.with_name("tulip.xml").rename(own.with_name("inner.xml"))
    own.with_name("tulip.xml").write_text('<mujoco><include file="inner.xml"/></mujoco>')
    monkeypatch.chdir(own.parent)
    robot = tt.load_robot("tulip.toml")
    monkeypatch.chdir(tmp_path)
    assert pickle.loads(pickle.dumps(robot)).model_hash == robot.model_hash
    edit(own.with_name("inner.xml"), 'mass="10.7"', 'mass="20.7"')
    assert tt.load_robot(own).model_hash != robot.model_hash


def test_an_mjcf_may_lie_beside_the_folder_of_its_meshes_but_not_outside_the_robot_s(own):
    """robot/mjcf/robot.xml with meshdir ../meshes is how many robots come."""
    folder = own.parent
    (folder / "mjcf").mkdir()
    (folder / "meshes").mkdir()
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (folder / "meshes" / "a.obj").write_text(tetrahedron)
    shutil.move(folder / "tulip.xml", folder / "mjcf" / "tulip.xml")
    path = folder / "mjcf" / "tulip.xml"
    edit(path, "<compiler ", '<compiler meshdir="../meshes" ')
    edit(path, "<asset>", '<asset><mesh name="a" file="a.obj"/>')
    edit(folder / "tulip.toml", '"tulip.xml"', '"mjcf/tulip.xml"')
    assert tt.load_robot(own).visual_model.nmesh == 1
    refuse("attribute 'meshdir': found '../meshes', expected a path inside", load_spec, path)
    edit(path, "../meshes", "../../meshes")
    with pytest.raises(tt.InputError, match=r"line \d+, <compiler>, attribute 'meshdir'"):
        tt.load_robot(own)


def test_a_crash_and_an_endless_compilation_are_survived(own, monkeypatch):
    path = own.with_name("tulip.xml")
    monkeypatch.setattr(sandbox, "CHILD", "import os; os.abort()")
    known = {path: {path: "known"}}
    monkeypatch.setattr(sandbox, "compiled", {(path, frozenset(known[path].items()))})
    sandbox.try_to_compile(path, known)  # not again
    refuse(
        "tulip.xml: broken MJCF: MuJoCo crashed while compiling it (SIGABRT)",
        sandbox.try_to_compile,
        path,
        {path: {path: "crash"}},
    )
    monkeypatch.setattr(sandbox, "CHILD", sandbox.CHILD.replace("os.abort()", "os.kill(os.getpid(), 24)"))
    with pytest.raises(tt.InputError, match="MuJoCo did not compile it within 20 s of processor time"):
        sandbox.try_to_compile(path, {path: {path: "endless"}})
