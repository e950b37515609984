"""Random robots: possible bodies, as scattered as stated, and the laboratory's scene becomes them."""

import dataclasses
import pickle

import mujoco
import numpy as np
import pytest

from tulip_testbed.experiments.validate import NEGLIGIBLE
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.sim.random_robots import draw_robot, edit_of, half_edges
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec

SPREAD = 0.2


@pytest.fixture(scope="module")
def robots(model):
    rng = np.random.default_rng(121)
    return np.array([draw_robot(model, SPREAD, rng) for _ in range(2000)])


def scene_of(rig, model, standard) -> mujoco.MjModel:
    changed = dataclasses.replace(rig, edit=edit_of(model, standard))
    return compile_spec(laboratory_scene(changed, np.zeros((2, 3))), "scene")


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


def test_the_scene_becomes_the_robot(robot, model):
    standard = draw_robot(model, SPREAD, np.random.default_rng(123))
    scene = scene_of(preset_rig("ideal", robot), model, standard)
    links = [scene.body(model.body(k).name).id for k in range(1, model.nbody)]
    np.testing.assert_allclose(scene.body_mass[links], standard[:, 0], rtol=1e-12)
    moments = scene.body_mass[links, None] * scene.body_ipos[links]
    np.testing.assert_allclose(moments, standard[:, 1:], rtol=1e-9, atol=1e-12)
    inertia = scene.body_inertia[links]
    ratio = inertia / model.body_inertia[1:]
    np.testing.assert_allclose(ratio, (standard[:, 0] / model.body_mass[1:])[:, None] * np.ones(3), rtol=1e-9)
    assert (2 * inertia.max(axis=1) <= inertia.sum(axis=1) * (1 + 1e-12)).all()


def test_the_edit_of_the_nominal_robot_changes_nothing(robot, model):
    rig = preset_rig("ideal", robot)
    same = scene_of(rig, model, standard_parameters(model))
    plain = compile_spec(laboratory_scene(rig, np.zeros((2, 3))), "scene")
    for name in ("body_mass", "body_ipos", "body_iquat", "body_inertia"):
        np.testing.assert_allclose(getattr(same, name), getattr(plain, name), rtol=1e-12, atol=1e-15)


def test_robots_that_nobody_here_wrote(foreign):
    for robot in foreign.values():
        model = mujoco.MjSpec.from_file(str(robot.model_file)).compile()
        standard = draw_robot(model, SPREAD, np.random.default_rng(124))
        scene = scene_of(preset_rig("ideal", robot), model, standard)
        links = [scene.body(model.body(k).name).id for k in range(1, model.nbody)]
        np.testing.assert_allclose(scene.body_mass[links], standard[:, 0], rtol=1e-9)


def test_the_simplified_model_no_longer_holds(robots, parameters, robot):
    truth = np.array([parameters.values(standard) for standard in robots[:50]])
    dropped = sorted(set(range(1, 26)) - set(robot.settings["simplified"]))
    assert (np.abs(truth[:, np.array(dropped) - 1]).max(axis=1) > NEGLIGIBLE).all()


def test_edits_travel_and_streams_repeat(model):
    first, again = (draw_robot(model, SPREAD, np.random.default_rng(125)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    edit = pickle.loads(pickle.dumps(edit_of(model, first)))
    np.testing.assert_array_equal(edit.args[1], first[:, 0])
