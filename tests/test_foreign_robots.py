"""Robots that nobody here wrote and robots that are drawn: the whole project takes them."""

import dataclasses
import json
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.foreign_robots import ROBOTS
from tests.posed import check_standing
from tulip_testbed.cli.main import main
from tulip_testbed.effects.targets import LEG_LINKS
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.planning_ranges import free_joint_ranges, planning_ranges
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.random_robots import draw_robot, edit_of, half_edges
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import between_feet, joint_names
from tulip_testbed.sim.scene import laboratory_scene, nominal_plates
from tulip_testbed.sim.specs import compile_spec

NAMES = sorted(ROBOTS)


@pytest.mark.parametrize("name", ["humanoid", pytest.param("humanoid_CMU", marks=pytest.mark.slow)])
def test_planned_postures_stand_on_both_soles_and_move_every_joint(name, foreign, humanoid_plan):
    robot, plan = foreign[name], humanoid_plan
    if name != "humanoid":
        plan = random_postures(robot, nominal_plates(robot)[0], 8, 5, 110)
    model, ranges = robot.model, planning_ranges(robot)
    check_standing(robot, plan)
    names = joint_names(model)
    drawn = free_joint_ranges(robot, model, ranges)
    assert set(drawn) == {
        n for n, between in zip(names, between_feet(model, robot), strict=True) if not between
    }
    for joint, (low, high) in drawn.items():
        angles = plan.joint_angles[:, names.index(joint)]
        assert low <= angles.min() < angles.max() <= high
        assert np.ptp(angles) > 0.5 * (high - low)
    # So every base parameter shows: 40 postures are 80 rows for 34 and 75 columns.
    assert np.linalg.cond(stacked_regressor(base_parameters(robot), plan.joint_angles)) < 1e4


@pytest.mark.slow
def test_the_main_job_on_a_foreign_robot(foreign, tmp_path, capsys):
    """Plan, simulate in full, identify, compare with the truth; all by the command line."""
    robot, plan, run = foreign["humanoid"], str(tmp_path / "plan"), tmp_path / "run"
    drawing = ["--placements", "7", "--per-placement", "5", "--seed", "112", "--out", plan]
    assert main(["plan", "random", *drawing, "--robot", str(robot.path), "--json"]) == 0
    options = f"--sensors ideal --imperfections 0 --seed 113 --workers 2 --out {run}".split()
    assert main(["validate", plan, "--robot", str(robot.path), *options]) == 0
    out = capsys.readouterr().out
    assert "Verdict: pass" in out
    assert "Table II" not in out
    report = json.loads((run / "result.json").read_text())["identification"]
    estimate = np.array(report["full"]["value"])
    truth = base_parameters(robot).values(standard_parameters(robot.model))
    assert len(estimate) == 34
    assert np.abs(estimate - truth).max() < 1e-3
    assert report["mass"][0] == pytest.approx(40.844, abs=1e-3)


def test_the_example_in_the_documentation_is_this_robots(foreign):
    text = (Path(__file__).parent.parent / "docs" / "how-to" / "your-robot.md").read_text()
    example = text.split("```toml\n")[1].split("```")[0]
    assert tomllib.loads(example) == foreign["humanoid"].settings


SPREAD = 0.2


@pytest.fixture(scope="module")
def robots(model):
    rng = np.random.default_rng(121)
    return np.array([draw_robot(model, SPREAD, rng) for _ in range(2000)])


def test_masses_scatter_as_stated(robots, model):
    logarithm = np.log(robots[:, :, 0] / model.body_mass[1:])
    np.testing.assert_allclose(logarithm.std(axis=0), SPREAD, rtol=0.08)
    np.testing.assert_allclose(robots[:, :, 0].mean(axis=0), model.body_mass[1:], rtol=0.02)
    between = np.corrcoef(logarithm.T) - np.eye(13)
    assert np.abs(between).max() < 0.1  # left and right too


def test_centres_of_mass_scatter_within_their_boxes(robots, model):
    moved = (robots[:, :, 1:] / robots[:, :, :1] - model.body_ipos[1:]) / half_edges(model)
    assert np.abs(moved).max() <= 1.0
    np.testing.assert_allclose(moved.std(axis=0), SPREAD, rtol=0.08)
    wide = draw_robot(model, 1.0, np.random.default_rng(122))
    moved = (wide[:, 1:] / wide[:, :1] - model.body_ipos[1:]) / half_edges(model)
    assert np.abs(moved).max() <= 1.0


def test_half_edges_of_a_solid_box():
    text = """<mujoco><worldbody><body><freejoint/><geom type="box" size=".1 .2 .3" euler="0 0 30"/>
      <body><joint/><geom type="box" size=".05 .05 .2" pos="0 .1 0"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    found = np.sort(half_edges(model), axis=1)
    np.testing.assert_allclose(found, [[0.1, 0.2, 0.3], [0.05, 0.05, 0.2]], rtol=1e-6)


def test_lengths_are_those_between_the_feet_whatever_hangs_from_the_trunk(foreign):
    legs = [f"{side}_{link}" for side in ("right", "left") for link in ("thigh", "shin")]
    assert LEG_LINKS.of(foreign["humanoid"], ()) == ("pelvis", *legs)


@pytest.mark.parametrize("name", ["tulip", *NAMES])
def test_the_scene_becomes_the_robot(name, robot, foreign):
    robot = robot if name == "tulip" else foreign[name]
    model = robot.model
    standard = draw_robot(model, SPREAD, np.random.default_rng(123))
    rig = dataclasses.replace(preset_rig("ideal", robot), edit=edit_of(model, standard))
    scene = compile_spec(laboratory_scene(rig, np.zeros((2, 3))), "scene")
    links = [scene.body(model.body(k).name).id for k in range(1, model.nbody)]
    np.testing.assert_allclose(scene.body_mass[links], standard[:, 0], rtol=1e-12)
    moments = scene.body_mass[links, None] * scene.body_ipos[links]
    np.testing.assert_allclose(moments, standard[:, 1:], rtol=1e-9, atol=1e-12)
    inertia = scene.body_inertia[links]
    ratio = inertia / model.body_inertia[1:]
    np.testing.assert_allclose(ratio, (standard[:, 0] / model.body_mass[1:])[:, None] * np.ones(3), rtol=1e-9)
    assert (2 * inertia.max(axis=1) <= inertia.sum(axis=1) * (1 + 1e-12)).all()
