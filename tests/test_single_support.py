"""Postures on one foot, in both engines and in the estimate, in the frame of the foot that carries."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import changed, plus
from tests.effect_changes import statically
from tests.posed import posed, seen_from
from tests.statics_against_dynamics import compare, without_friction
from tests.test_refusals import refuse
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.usable_plan import joined as one_after_another
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.center_of_pressure import center_of_pressure, load_shares
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

# Leaning over the stance hip, so that its roll drive holds the rest of the robot; the other leg lifted.
STANCE = np.array([0.0, -0.35, -0.3, 0.5, -0.2, 0.05, 0.0, 0.1, -0.6, 1.0, -0.3, 0.0])
OVER = np.array([0.03, 0.0])  # m, where the centre of mass is to be, in the frame of the foot that carries
LIFTED = 0.1  # m, of the other foot at least
COUNT, MORE = 4, 20
# The mirror swaps the legs, and what turns about x or z changes its sign.
MIRROR = np.array([-1.0, -1.0, 1.0, 1.0, 1.0, -1.0])
PLANAR = np.array([1.0, -1.0, -1.0])
FEET = {"right": "right_foot", "left": "left_foot"}


@pytest.fixture(scope="module")
def balanced(model, plan) -> tt.PosturePlan:
    """Twenty postures on the right foot, in ten placements, by MuJoCo alone."""
    low, high = np.transpose([model.joint(name).range for name in plan.joints])
    rng, angles, poses = np.random.default_rng(23), [], []
    while len(angles) < MORE:
        tried = np.clip(STANCE + rng.normal(0, 0.1, 12), low + 0.02, high - 0.02)
        for _ in range(8):
            steps = np.zeros((2, 12))
            steps[[0, 1], [4, 5]] = 1e-5
            center = center_in(model, tried, "right_foot")
            slope = np.transpose([center_in(model, tried + step, "right_foot") - center for step in steps])
            tried[[4, 5]] -= np.linalg.solve(slope / 1e-5, center - OVER)
        other, turn = body_in(model, tried, "left_foot", "right_foot")
        if (tried > low).all() and (tried < high).all() and other[2] > LIFTED:
            angles.append(tried)
            poses.append([other[0], other[1], np.arctan2(turn[1, 0], turn[0, 0])])
    placement = np.arange(MORE) // (COUNT // 2) + 1
    first = np.unique(placement, return_index=True)[1][placement - 1]
    return dataclasses.replace(
        plan.take(np.arange(MORE)),
        joint_angles=np.array(angles),
        placement=placement,
        support=np.full(MORE, "right"),
        swing_pose=np.array(poses)[first],
    )


@pytest.fixture(scope="module")
def on(balanced) -> dict[str, tt.PosturePlan]:
    """Four of them, and their mirror images on the left foot."""
    right = balanced.take(np.arange(COUNT))
    first, second = np.hsplit(right.joint_angles, 2)
    left = dataclasses.replace(
        right,
        joint_angles=np.hstack([second * MIRROR, first * MIRROR]),
        support=np.full(COUNT, "left"),
        swing_pose=right.swing_pose * PLANAR,
    )
    return {"right": right, "left": left}


@pytest.fixture(scope="module")
def quiet(robot) -> Rig:
    """A laboratory without sensor noise and dry friction; nothing is measured twice."""
    return dataclasses.replace(still(preset_rig("ideal", robot)), edit=without_friction())


@pytest.fixture(scope="module", params=[pytest.param("right", marks=pytest.mark.slow), "left"])
def held(request, quiet, on) -> Any:
    """The side that carries, and the experiment in the full dynamics."""
    return request.param, run_dynamics(quiet, on[request.param], 5)


def test_both_engines_read_mujocos_centre_of_mass_in_the_frame_of_the_foot(model, held, quiet, on):
    side, run = held
    other = slice(4) if side == "left" else slice(4, 8)
    true = np.array([a.true_plates for a in run.truth.measured])
    placed = dataclasses.replace(run.measurements, plate_poses=true)
    for measured, empty in ((placed, 1e-6), (statically(quiet, on[side]), 1e-9)):
        assert len(measured) == COUNT
        assert set(measured.support) == {side}
        assert (np.abs(measured.cell_forces[:, other]) < empty).all()  # nobody stands on that plate
        own = np.array([center_in(model, q, FEET[side]) for q in measured.joint_angles])
        np.testing.assert_allclose(center_of_pressure(measured), own, rtol=0, atol=5e-6)
    own = [center_in(model, q, FEET[side]) for q in placed.joint_angles]
    np.testing.assert_allclose([h.com for h in run.truth.held], own, rtol=0, atol=5e-6)
    # The foot creeps on its board after its pose was recorded.
    np.testing.assert_allclose(run.measurements.plate_poses, true, rtol=0, atol=1e-4)
    for hold in run.truth.held:
        assert hold.balance.centre < 1e-5
        assert abs(hold.balance.weight) < 1e-3


def test_statics_is_where_the_dynamics_come_to_rest(quiet, on, held):
    side, run = held
    found = compare(solve_plan(quiet, on[side]), list(run.truth.attempts))
    assert len(found.held) == COUNT
    assert np.abs(found.angles).max() < 1e-5
    assert np.abs(found.cells).max() < 0.01


@pytest.mark.parametrize("engine", ["statics", "dynamics"])
def test_the_robot_leans_over_a_yielding_left_ankle_and_not_over_the_right_one(robot, model, on, engine):
    """All above the ankle turns about it by compliance times its weight's moment."""
    sound = tt.Laboratory(robot, "ideal", nominal=still(preset_rig("ideal", robot)))
    few, compliance = on["left"].take(np.arange(2)), 2e-4
    above = model.body_subtreemass[0] - model.body("left_foot").mass[0]
    for joint, loaded in (("left_ankle_pitch", True), ("right_ankle_pitch", False)):
        hidden = sound.with_effects(f"joint-compliance:{joint}={compliance}")
        found = hidden.run(few, 3, engine, workers=1).measurements
        ahead, height = np.transpose([lean_of(model, q) for q in found.joint_angles])
        expected = loaded * compliance * above * 9.81 * ahead * height * above / model.body_subtreemass[0]
        read = np.array([center_in(model, q, "left_foot") for q in found.joint_angles])
        moved = center_of_pressure(found) - read
        np.testing.assert_allclose(moved[:, 0], expected, rtol=0.03, atol=2e-5)
        assert (not loaded) or (moved[:, 0] > 3e-4).all()


def test_two_base_frames_in_a_placement_are_refused(robot, quiet, plan, on, tmp_path):
    apart = joined(on["right"], on["left"])
    mixed = dataclasses.replace(apart, placement=np.repeat([1, 2], [COUNT // 2, 2 * COUNT - COUNT // 2]))
    write_plan(tmp_path / "mixed", mixed)
    for call in (
        lambda: solve_plan(quiet, mixed),
        lambda: run_dynamics(quiet, mixed, 1),
        lambda: read_plan(tmp_path / "mixed", robot),
    ):
        refuse(f"row {COUNT + 1}: found 'left' after 'right' in placement 2", call)
    write_plan(tmp_path / "apart", apart)
    three = joined(plan.take(plan.placement <= 2), read_plan(tmp_path / "apart", robot))
    assert set(statically(quiet, three).support) == {"double", "right", "left"}


def test_both_supports_together_tell_26_parameters(robot, plan, balanced):
    mixed = joined(plan.take(plan.placement <= 16), balanced)
    (run,) = run_statics(solve_plan(preset_rig("ideal", robot), mixed), np.random.SeedSequence(3).spawn(1))
    assert set(run.measurements.support) == {"double", "right"}
    found = identify(run.measurements, robot)
    truth = base_parameters(robot, support="right").values(run.truth.standard)
    assert len(found.full.value) == 26
    assert found.full.names[25] == found.simplified.names[-1] == "left_foot.z"
    # Feet tilt by micrometres on their contacts, which the estimator takes for flat.
    for model in (found.full, found.simplified):
        np.testing.assert_allclose(model.value, truth[model.numbers - 1], rtol=0, atol=1e-4)


def test_an_empty_plate_is_not_read_and_the_preflight_says_what_it_leaves_out(robot, balanced):
    measured = statically(preset_rig("wii", robot), balanced)
    louder = changed(measured, cell_forces=plus(5.0, ..., slice(4, None)))
    np.testing.assert_array_equal(center_of_pressure(louder), center_of_pressure(measured))
    np.testing.assert_array_equal(load_shares(louder)[:, 0], 1.0)
    findings = {finding.name: finding for finding in preflight(measured, nominal_robot(robot), None)}
    assert "stands on one foot" in findings["legs close"].seen
    assert "26 parameters" in findings["identifiable"].expected


def joined(first: tt.PosturePlan, second: tt.PosturePlan) -> tt.PosturePlan:
    """Two plans after one another, the second's numbers behind the first's."""
    names = ("posture", "placement")
    behind: Any = {name: getattr(first, name).max() + getattr(second, name) for name in names}
    return one_after_another([first, dataclasses.replace(second, **behind)])


def still(rig: Rig) -> Rig:
    """The same laboratory; nothing is measured twice."""
    return dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))


def center_in(model: mujoco.MjModel, angles: np.ndarray, foot: str) -> np.ndarray:
    """MuJoCo's centre of mass above the plane of a foot's sole, in the foot's frame, (2,) [m]."""
    data = posed(model, angles)
    return seen_from(data, foot, data.subtree_com[1])[:2]


def lean_of(model: mujoco.MjModel, angles: np.ndarray) -> tuple[float, float]:
    """How far the centre of mass of all but the left foot is ahead of and above the left ankle [m]."""
    data = posed(model, angles)
    foot, ankle = data.body("left_foot"), model.joint("left_ankle_pitch").id
    mass = model.body_mass * (np.arange(model.nbody) != foot.id)
    center = foot.xmat.reshape(3, 3).T @ (mass @ data.xipos / mass.sum() - data.xanchor[ankle])
    return float(center[0]), float(center[2])


def body_in(model: mujoco.MjModel, angles: np.ndarray, name: str, base: str) -> tuple[np.ndarray, np.ndarray]:
    """Place and turn of a body in a foot's frame, (3,) [m] and (3, 3)."""
    data = posed(model, angles)
    turn = data.body(base).xmat.reshape(3, 3).T @ data.body(name).xmat.reshape(3, 3)
    return seen_from(data, base, data.body(name).xpos), turn
