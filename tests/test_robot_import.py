"""Published robots, as MJCF and URDF, become robots that the laboratory takes."""

import re
import tomllib

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.posed import posed
from tests.published_robot import MASS, SOLE, mjcf, write_changed, write_published
from tests.test_cli import told
from tests.test_refusals import check_words, refuse, rows
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.robot_import import published
from tulip_testbed.experiments.robot_import.robot_import import import_robot
from tulip_testbed.experiments.usable_plan import random_plan
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.link_clearances import clearances_at, overlaps_at_reference, unjoined_pairs
from tulip_testbed.sim import sandbox
from tulip_testbed.sim.robot import load_robot, sole_corners


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    return write_published(tmp_path_factory.mktemp("published") / "humanoid")


@pytest.fixture(scope="module")
def prepared(urdf, tmp_path_factory):
    found = import_robot(urdf)
    return found, found.write(tmp_path_factory.mktemp("prepared") / "robot")


def test_what_a_urdf_says_is_found(prepared):
    found, robot = prepared
    assert found.found["feet"] == ["right_ankle_roll_link", "left_ankle_roll_link"]
    assert found.found["mass"] == pytest.approx(MASS)
    assert robot.model.body_mass.sum() == pytest.approx(MASS)
    assert found.found["joints"] == 12 + 1 + 4  # legs, waist, arms; the head is light
    front, rear, outer, inner, height = SOLE
    left = sole_corners(robot.model, "left_ankle_roll_link")
    wanted = [
        [front, outer, -height],
        [front, inner, -height],
        [rear, inner, -height],
        [rear, outer, -height],
    ]
    np.testing.assert_allclose(left, wanted, atol=1e-6)
    assert found.found["leg"] == pytest.approx(0.3 + 0.3 + height)
    assert found.found["torque"]["left_knee"] == 60


def test_the_centre_of_mass_is_that_of_the_published_file(urdf, prepared):
    """By MuJoCo's reader of URDF, without meshes and with all joints."""
    shapes = r"<(visual|collision)>.*?</(visual|collision)>"
    spec, (_, robot) = mujoco.MjSpec.from_string(re.sub(shapes, "", urdf.read_text())), prepared
    spec.compiler.fusestatic = False
    models, rng = (robot.model, spec.compile()), np.random.default_rng(3)
    names = [robot.model.joint(j).name for j in range(1, robot.model.njnt)]
    for _ in range(5):
        angles, centers = rng.uniform(-0.5, 0.5, len(names)), []
        for model in models:
            data = posed(model, angles, names)
            centers.append(data.subtree_com[1] - data.xpos[1])
        np.testing.assert_allclose(*centers, atol=1e-5)  # the MJCF has six digits


def test_it_stands_on_level_soles_with_bent_knees(prepared):
    _, robot = prepared
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = model.key("stand").qpos
    mujoco.mj_forward(model, data)
    heights = [
        (data.body(foot).xpos + data.body(foot).xmat.reshape(3, 3) @ corner)[2]
        for foot in robot.feet
        for corner in sole_corners(model, foot)
    ]
    np.testing.assert_allclose(heights, 0.0, atol=2e-4)
    assert abs(data.subtree_com[1, 0]) < 0.05
    assert data.qpos[model.joint("left_knee").qposadr[0]] > 0.2


def test_a_forearm_inside_of_the_chest_is_moved_out_and_overlaps_that_stay_are_told(tmp_path):
    """At zero angles the forearms are 50 mm inside of the chest; the thighs always lie in each other."""
    path = write_published(tmp_path / "humanoid")
    text = path.read_text().replace('<box size="0.04 0.04 0.22"/>', '<box size="0.04 0.2 0.22"/>')
    path.write_text(text)
    robot = import_robot(path).write(tmp_path / "robot")
    assert overlaps_at_reference(robot) == {}
    distance = clearances_at(unjoined_pairs(robot), np.zeros((1, 17)), 1.0).distance[0]
    assert distance.min() == pytest.approx(-0.05, abs=1e-4)
    moved = robot.model.key("stand").qpos[7:]
    arms = [robot.model.joint(name).qposadr[0] - 7 for name in robot.settings["planning"]["joints_deg"]]
    assert 0 < np.count_nonzero(np.abs(moved[arms]) > 0.01) < len(arms)  # no joint moves for nothing
    path.write_text(text.replace('<box size="0.06 0.06 0.2"/>', '<box size="0.06 0.3 0.2"/>'))
    report = tt.describe_robot(path)
    assert "Problems:" in repr(report)
    (told,) = [line for line in report.problems if "overlap" in line]
    assert told.startswith("links that overlap in the posture stand, and may do so in plans: ")
    assert "right_hip_pitch_link and left_hip_pitch_link (60 mm)" in told


@rows("told")
def test_what_is_assumed_left_out_or_changed_is_told(tmp_path, changes, words):
    file = write_changed(tmp_path, changes)
    found = import_robot(file)
    check_words(words, "\n".join((*found.assumed, *found.problems)))
    assert found.found["mass"] == pytest.approx({".urdf": MASS, ".xml": 22.0}[file.suffix])


@pytest.mark.parametrize("turn", [np.pi, pytest.param(np.pi / 2, marks=pytest.mark.slow)])
def test_a_robot_that_faces_another_way_is_the_same_robot(turn, prepared, tmp_path):
    """iCub's x points to the back; the names of the sides tell."""
    _, robot = prepared
    found = import_robot(write_published(tmp_path / "turned", turn))
    other = found.write(tmp_path / "robot")
    assert any("frames turned to x forward" in text for text in found.assumed)
    for foot in robot.feet:
        np.testing.assert_allclose(
            sole_corners(other.model, foot), sole_corners(robot.model, foot), atol=1e-6
        )
    centers = []
    for one in (robot, other):
        data = mujoco.MjData(one.model)
        data.qpos[:] = one.model.key("stand").qpos
        mujoco.mj_kinematics(one.model, data)
        mujoco.mj_comPos(one.model, data)
        centers.append(data.subtree_com[1].copy())
    np.testing.assert_allclose(*centers, atol=1e-3)


def test_feet_that_point_forward_tell_the_front_without_names(tmp_path):
    found = import_robot(write_published(tmp_path / "turned", np.pi, names=("alpha", "beta")))
    assert found.found["feet"] == ["alpha_ankle_roll_link", "beta_ankle_roll_link"]


def test_the_published_files_are_not_changed_and_its_description_can_be_edited(urdf, prepared, tmp_path):
    before = {path: path.read_bytes() for path in urdf.parent.rglob("*.*")}
    found = import_robot(urdf)
    assert before == {path: path.read_bytes() for path in urdf.parent.rglob("*.*")}
    assert found.model == prepared[0].model  # the same again
    table = tomllib.loads(found.description)
    assert table["stance_foot"] == "right_ankle_roll_link"
    assert set(table["planning"]["joints_deg"]) == {
        *("waist", "right_shoulder", "right_elbow", "left_shoulder", "left_elbow")
    }
    refuse("found a model, expected a description ... : `tulip robot` makes", load_robot, urdf)


def test_it_goes_through_the_laboratory(urdf):
    robot = tt.load_robot(urdf)
    plan = random_plan(robot, 12, 5, seed=1)
    run = tt.Laboratory(robot, "ideal").run(plan, seed=1, engine="statics")
    found = tt.identify(run, robot, estimator="least-squares").full
    parameters = base_parameters(robot)
    true = parameters.values(standard_parameters(robot.model))
    assert np.abs(found.value - true).max() < 1e-3  # m


ROD = '<geom type="capsule" size=".01" fromto="-.05 0 -.05 .1 0 -.05"/>'


@rows("imported")
def test_what_cannot_work_is_refused_with_its_reason(tmp_path, changes, words):
    content, *stated = (eval(change, {"mjcf": mjcf, "ROD": ROD}) for change in changes)
    path = tmp_path / ("robot.xml" if content.startswith("<mujoco") else "robot.model")
    path.write_text(content)
    refuse(words if stated else f"{path} ... {words}", import_robot, path, *stated)


def test_an_mjcf_with_a_floor_no_motors_and_soles_that_are_stated(tmp_path):
    path = tmp_path / "plain.xml"
    path.write_text(mjcf())
    found = import_robot(path)
    assert found.found["feet"] == ["right5", "left5"]
    assert any(text.startswith("torque limit ") for text in found.assumed)
    path.write_text(mjcf(foot=""))
    stated = import_robot(path, ("right5", "left5"), (0.12, 0.08, 0.07, 0.05))
    robot = stated.write(tmp_path / "out")
    corners = sole_corners(robot.model, "left5")
    np.testing.assert_allclose(corners[0], [0.12, 0.035, -0.05], atol=1e-6)


def test_names_that_are_missing_or_hold_quotes(tmp_path):
    """A description is TOML: a quote in a name must not end it."""
    text = mjcf().replace('<joint name="right3" ', "<joint ").replace('"left', '"l&quot;eft')
    (tmp_path / "odd.xml").write_text(text)
    found = import_robot(tmp_path / "odd.xml")
    assert found.found["feet"] == ["right5", 'l"eft5']
    robot = found.write(tmp_path / "out")
    assert robot.swing_foot == 'l"eft5'
    assert found.found["joints"] == 12


def test_the_command(urdf, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(published, "call_safely", sandbox.call_safely)  # in a process of its own, as users do
    document = told(capsys, "robot", urdf, "--out", tmp_path / "out")
    monkeypatch.undo()
    assert document["found"]["joints"] == 17
    assert {"robot.toml", "robot.xml"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert load_robot(tmp_path / "out").path == (tmp_path / "out" / "robot.toml").resolve()
    assert main(["robot", str(urdf), "--out", str(tmp_path / "out")]) == 2
    assert main(["identify", "data", "--robot", str(urdf)]) == 2
    assert "`tulip robot` makes one of it" in capsys.readouterr().err
