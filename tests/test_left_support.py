"""Postures on the swing (left) foot alone, in both engines; their base frame is the left foot's."""

from __future__ import annotations

import dataclasses
import re

import mujoco
import numpy as np
import pytest

from studies.study_equilibrium import compare, without_friction
from tests.test_single_support import STANCE, TO_COME, joined
from tulip_testbed.base.errors import InputError
from tulip_testbed.drawings import support_polygons
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.center_of_pressure import center_of_pressure, loaded_cells
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import sole_corners, sole_point
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics
from tulip_testbed.standing import link_frames, soles_in_base
from tulip_testbed.viewer.subject import planned

OVER = np.array([0.03, 0.0])  # m, where the centre of mass is to be, in the frame of the foot that carries
COUNT = 6
# The mirror swaps the legs, and what turns about x or z changes its sign.
MIRROR = np.array([-1.0, -1.0, 1.0, 1.0, 1.0, -1.0])
ACROSS = np.array([1.0, -1.0])
MIRRORED_CELLS = [5, 4, 7, 6, 1, 0, 3, 2]  # front left of one plate is front right of the other
PLANAR = np.array([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def on_the_right(model, plan) -> PosturePlan:
    """Postures on the right foot, in two placements, by MuJoCo alone."""
    low, high = np.transpose([model.joint(name).range for name in plan.joints])
    rng, angles, poses = np.random.default_rng(23), [], []
    while len(angles) < COUNT:
        tried = np.clip(STANCE + rng.normal(0, 0.1, 12), low + 0.02, high - 0.02)
        for _ in range(8):
            steps = np.zeros((2, 12))
            steps[[0, 1], [4, 5]] = 1e-5
            center = center_in(model, tried, "right_foot")
            slope = np.transpose([center_in(model, tried + step, "right_foot") - center for step in steps])
            tried[[4, 5]] -= np.linalg.solve(slope / 1e-5, center - OVER)
        other, turn = foot_in(model, tried, "left_foot", "right_foot")
        if (tried > low).all() and (tried < high).all() and other[2] > TO_COME:
            angles.append(tried)
            poses.append([other[0], other[1], np.arctan2(turn[1, 0], turn[0, 0])])
    placement = np.repeat([1, 2], COUNT // 2)
    first = np.unique(placement, return_index=True)[1][placement - 1]
    return dataclasses.replace(
        plan.take(np.arange(COUNT)),
        joint_angles=np.array(angles),
        placement=placement,
        support=np.full(COUNT, "right"),
        swing_pose=np.array(poses)[first],
    )


@pytest.fixture(scope="module")
def on_the_left(on_the_right) -> PosturePlan:
    """Their mirror images, on the left foot."""
    right, left = np.hsplit(on_the_right.joint_angles, 2)
    return dataclasses.replace(
        on_the_right,
        joint_angles=np.hstack([left * MIRROR, right * MIRROR]),
        support=np.full(COUNT, "left"),
        swing_pose=on_the_right.swing_pose * PLANAR,
    )


@pytest.fixture(scope="module")
def quiet(robot) -> Rig:
    """A laboratory without sensor noise and dry friction; nothing is measured twice."""
    rig = preset_rig("ideal", robot)
    protocol = dataclasses.replace(rig.protocol, repeats=0)
    return dataclasses.replace(rig, edit=without_friction(), protocol=protocol)


@pytest.fixture(scope="module")
def exact(quiet) -> Rig:
    """The same, and boards and joints go where they are sent."""
    return dataclasses.replace(
        quiet,
        protocol=dataclasses.replace(quiet.protocol, plate_sd=(0.0, 0.0, 0.0)),
        controller=dataclasses.replace(quiet.controller, command_sd=0.0),
    )


@pytest.fixture(scope="module")
def held(quiet, on_the_left) -> Outcome:
    return run_dynamics(quiet, on_the_left, 5)


def test_dynamics_read_mujocos_centre_of_mass_in_the_left_foots_frame(model, held):
    measured = held.measurements
    assert len(measured) == COUNT
    assert set(measured.support) == {"left"}
    assert (np.abs(measured.cell_forces[:, :4]) < 1e-6).all()  # nobody stands on the right plate
    true = np.array([a.true_plates for a in held.truth.measured])
    own = np.array([center_in(model, q, "left_foot") for q in measured.joint_angles])
    seen = center_of_pressure(dataclasses.replace(measured, plate_poses=true))
    np.testing.assert_allclose(seen, own, rtol=0, atol=5e-6)
    np.testing.assert_allclose([h.com for h in held.truth.held], own, rtol=0, atol=5e-6)
    # The foot creeps on its board after its pose was recorded.
    np.testing.assert_allclose(measured.plate_poses, true, rtol=0, atol=1e-4)
    for one in held.truth.held:
        assert one.balance.centre < 1e-5
        assert abs(one.balance.weight) < 1e-3


def test_statics_read_mujocos_centre_of_mass_in_the_left_foots_frame(model, quiet, on_the_left):
    measured = statics(quiet, on_the_left)
    assert len(measured) == COUNT
    assert (np.abs(measured.cell_forces[:, :4]) < 1e-9).all()
    own = np.array([center_in(model, q, "left_foot") for q in measured.joint_angles])
    np.testing.assert_allclose(center_of_pressure(measured), own, rtol=0, atol=5e-6)


def test_statics_is_where_the_dynamics_come_to_rest(quiet, on_the_left, held):
    found = compare(solve_plan(quiet, on_the_left), list(held.truth.attempts))
    assert len(found.held) == COUNT
    assert np.abs(found.angles).max() < 1e-5
    assert np.abs(found.cells).max() < 0.01


def test_tulip_is_symmetric_and_so_are_its_experiments(exact, on_the_right, on_the_left):
    first, second = statics(exact, on_the_right), statics(exact, on_the_left)
    check_mirrored(first, second, 1e-8, 1e-6)
    few = [0, COUNT // 2]
    one, two = (run_dynamics(exact, plan.take(np.array(few)), 5) for plan in (on_the_right, on_the_left))
    check_mirrored(one.measurements, two.measurements, 1e-6, 1e-3)
    centers = [np.array([h.com for h in run.truth.held]) for run in (one, two)]
    np.testing.assert_allclose(centers[1], centers[0] * ACROSS, rtol=0, atol=1e-6)


def test_the_empty_board_lies_below_the_right_foot(robot, exact, on_the_left):
    boards = boards_under(exact, on_the_left.foot_poses)
    soles = boards[:, 0] - on_the_left.swing_pose
    assert np.hypot(*soles[:, :2].T).max() < 0.15  # m, of a board half a metre long
    assert (boards[:, 1, 1] - boards[:, 0, 1] > 0.3).all()  # the left board is on the left
    np.testing.assert_array_equal(on_the_left.foot_poses[:, 1], 0.0)


def test_a_gain_of_the_left_plates_cell_shows_and_one_of_the_right_does_not(robot, on_the_left):
    true = preset_rig("ideal", robot)
    clean = Laboratory(robot, "ideal", nominal=still(true)).run(on_the_left, 3, "statics").measurements
    for cell, k in (("left.front_left", 4), ("right.front_left", 0)):
        hidden = Laboratory(robot, "ideal", nominal=still(true)).with_effects(f"cell-gain:{cell}=0.02")
        found = hidden.run(on_the_left, 3, "statics").measurements
        expected = clean.cell_forces.copy()
        expected[:, k] *= 1.02
        np.testing.assert_allclose(found.cell_forces, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("engine", ["statics", "dynamics"])
def test_an_encoders_offset_moves_only_its_reading(robot, on_the_left, engine):
    few = on_the_left.take(np.arange(2))
    sound = Laboratory(robot, "ideal", nominal=still(preset_rig("ideal", robot)))
    clean = sound.run(few, 3, engine, workers=1).measurements
    found = sound.with_effects("encoder-offset:left_knee=0.01").run(few, 3, engine, workers=1).measurements
    change = found.joint_angles - clean.joint_angles
    expected = np.where(np.array(few.joints) == "left_knee", 0.01, 0.0)
    np.testing.assert_allclose(np.abs(change), np.tile(expected, (2, 1)), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.cell_forces, clean.cell_forces)


@pytest.mark.parametrize("engine", ["statics", "dynamics"])
def test_the_robot_leans_over_a_yielding_left_ankle_and_not_over_the_right_one(
    robot, model, on_the_left, engine
):
    """All above the ankle turns about it by compliance times its weight's moment."""
    few, compliance = on_the_left.take(np.arange(2)), 2e-4
    above = model.body_subtreemass[0] - model.body("left_foot").mass[0]
    sound = Laboratory(robot, "ideal", nominal=still(preset_rig("ideal", robot)))
    for joint, loaded in (("left_ankle_pitch", True), ("right_ankle_pitch", False)):
        hidden = sound.with_effects(f"joint-compliance:{joint}={compliance}")
        found = hidden.run(few, 3, engine, workers=1).measurements
        ahead, height = np.transpose([lean_of(model, q) for q in found.joint_angles])
        expected = loaded * compliance * above * 9.81 * ahead * height * above / model.body_subtreemass[0]
        read = np.array([center_in(model, q, "left_foot") for q in found.joint_angles])
        moved = center_of_pressure(found) - read
        np.testing.assert_allclose(moved[:, 0], expected, rtol=0.03, atol=2e-5)
        assert (not loaded) or (moved[:, 0] > 3e-4).all()


def test_two_base_frames_in_a_placement_are_refused(robot, quiet, plan, on_the_right, on_the_left, tmp_path):
    mixed = joined(on_the_right, on_the_left)
    apart = mixed.placement.copy()
    mixed = dataclasses.replace(mixed, placement=np.repeat([1, 2], [COUNT // 2, 2 * COUNT - COUNT // 2]))
    message = f"row {COUNT + 1}: found 'left' after 'right' in placement 2, expected 'left' in all"
    with pytest.raises(InputError, match=message):
        solve_plan(quiet, mixed)
    with pytest.raises(InputError, match=message):
        run_dynamics(quiet, mixed, 1)
    with pytest.raises(InputError, match=message):
        Laboratory(robot, "ideal").run(mixed, engine="statics")
    write_plan(tmp_path / "mixed", mixed)
    with pytest.raises(InputError, match=message):
        read_plan(tmp_path / "mixed", robot)
    write_plan(tmp_path / "apart", dataclasses.replace(mixed, placement=apart))
    read = read_plan(tmp_path / "apart", robot)
    three = joined(plan.take(plan.placement <= 2), read)
    assert set(statics(quiet, three).support) == {"double", "right", "left"}


def test_pictures_show_the_left_foot_on_the_origin(robot, model, on_the_right, on_the_left):
    both = joined(on_the_right, on_the_left)
    subject = planned(both, robot)
    feet = np.array(["right_foot", "left_foot"])[(both.support == "left").astype(int)]
    own = [center_in(model, q, foot) for q, foot in zip(both.joint_angles, feet, strict=True)]
    np.testing.assert_allclose(subject.com["nominal model"], own, rtol=0, atol=1e-12)
    assert (subject.margin > 0.02).all()
    tree = subject.nominal.parameters.tree
    rotations, positions = link_frames(subject.nominal, both.joint_angles, both.support)
    soles = soles_in_base(subject.nominal, both.joint_angles, both.support)
    for row, (angles, foot) in enumerate(zip(both.joint_angles, feet, strict=True)):
        height = -sole_point(model, foot)[2]
        for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
            place, turn = foot_in(model, angles, link, foot)
            np.testing.assert_allclose(
                positions[row, frame], place + np.array([0, 0, height]), rtol=0, atol=1e-12
            )
            np.testing.assert_allclose(rotations[row, frame], turn, rtol=0, atol=1e-12)
        side = list(robot.feet).index(foot)
        on = sole_corners(model, foot)[:, :2]
        np.testing.assert_allclose(soles[row, side], on, rtol=0, atol=1e-12)
    mirrored = soles[:COUNT, ::-1, [1, 0, 3, 2]] * ACROSS
    np.testing.assert_allclose(soles[COUNT:], mirrored, rtol=0, atol=1e-12)


def test_the_picture_of_a_plan_on_the_left_foot_is_the_mirrored_one(robot, on_the_right, on_the_left):
    pictures = [support_polygons(robot, plan) for plan in (on_the_right, on_the_left)]
    first, second = (re.findall(r"least margin (\S+) mm", picture) for picture in pictures)
    assert len(first) == 2
    assert first == second
    assert min(map(float, first)) > 20


def statics(rig: Rig, plan: PosturePlan) -> Measurements:
    (run,) = run_statics(solve_plan(rig, plan), np.random.SeedSequence(3).spawn(1))
    return run.measurements


def still(rig: Rig) -> Rig:
    """The same laboratory; nothing is measured twice."""
    return dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))


def check_mirrored(right: Measurements, left: Measurements, length: float, force: float) -> None:
    """Compare an experiment on the right foot with its mirror image on the left [m and rad, N]."""
    assert len(right) == len(left)
    np.testing.assert_allclose(left.cell_forces, right.cell_forces[:, MIRRORED_CELLS], rtol=0, atol=force)
    first, second = np.hsplit(right.joint_angles, 2)
    mirrored = np.hstack([second * MIRROR, first * MIRROR])
    np.testing.assert_allclose(left.joint_angles, mirrored, rtol=0, atol=length)
    np.testing.assert_allclose(left.plate_poses, right.plate_poses[:, ::-1] * PLANAR, rtol=0, atol=length)
    np.testing.assert_array_equal(loaded_cells(left), loaded_cells(right)[:, MIRRORED_CELLS])
    np.testing.assert_allclose(
        center_of_pressure(left), center_of_pressure(right) * ACROSS, rtol=0, atol=length
    )


def center_in(model: mujoco.MjModel, angles: np.ndarray, foot: str) -> np.ndarray:
    """MuJoCo's centre of mass above the plane of a foot's sole, in the foot's frame, (2,) [m]."""
    data = posed(model, angles)
    body = data.body(foot)
    return (body.xmat.reshape(3, 3).T @ (data.subtree_com[1] - body.xpos))[:2]


def lean_of(model: mujoco.MjModel, angles: np.ndarray) -> tuple[float, float]:
    """How far the centre of mass of all but the left foot is ahead of and above the left ankle [m]."""
    data = posed(model, angles)
    foot = data.body("left_foot")
    ankle = model.joint("left_ankle_pitch").id
    mass = model.body_mass * (np.arange(model.nbody) != foot.id)
    center = foot.xmat.reshape(3, 3).T @ (mass @ data.xipos / mass.sum() - data.xanchor[ankle])
    return float(center[0]), float(center[2])


def foot_in(model: mujoco.MjModel, angles: np.ndarray, foot: str, base: str) -> tuple[np.ndarray, np.ndarray]:
    """Place and turn of a foot in another one's frame, (3,) [m] and (3, 3)."""
    data = posed(model, angles)
    other, body = data.body(foot), data.body(base)
    frame = body.xmat.reshape(3, 3).T
    return frame @ (other.xpos - body.xpos), frame @ other.xmat.reshape(3, 3)


def posed(model: mujoco.MjModel, angles: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[3], data.qpos[7:] = 1.0, angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data
