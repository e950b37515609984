"""The static equilibrium against MuJoCo's statics, its full dynamics, and itself."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ks_2samp

import tulip_testbed as tt
from tests.edited_rows import changed, plus
from tests.statics_against_dynamics import compare, excess_sag, laboratories, pulled
from tulip_testbed.experiments.imperfections import drawn
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.sensors import PRESETS, averaged_sd, sample, sample_mean
from tulip_testbed.sim.statics.forces import Load, StaticState, residual
from tulip_testbed.sim.statics.read_mechanism import read_mechanism
from tulip_testbed.sim.statics.slope import closed_slope, has_closed_slope
from tulip_testbed.sim.statics.solve import derivative, faults
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

# Backlash is in docs/explanation/equilibrium.md: where a load turns within the play there is more than
# one equilibrium.
LABORATORIES = (
    *("as it is", "gravity 2 deg off", "torso 1 kg heavier", "shank 1 mm longer", "pulled by ropes"),
    *("board rocks", "a knee at its stop", "flexible drives", "soft soles", "soft cells"),
)
LEVEL = 0.01


@pytest.fixture(scope="module")
def solved_plan(rig, plan):
    return solve_plan(rig, plan)


@pytest.mark.slow
@pytest.mark.parametrize("name", LABORATORIES)
def test_the_dynamics_come_to_rest_in_it(rig, plan, name):
    check_rest(laboratories(rig)[name], plan.take(np.flatnonzero(plan.placement == 2)))


def check_rest(rig, plan):
    """Check that the dynamics come to rest in the equilibria of statics."""
    quiet = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    found = compare(solve_plan(quiet, plan), list(run_dynamics(quiet, plan, 1).truth.attempts))
    assert len(found.held) >= 3
    assert np.abs(found.angles).max() < 1e-4
    assert np.abs(found.cells).max() < 0.05
    assert found.center.max() < 1e-5


def test_with_dry_friction_sag_and_load_share_are_distributed_alike(solved_plan, ideal):
    """Kolmogorov and Smirnov's test for every joint and the load share, familywise level 1 %."""
    held = [a for a in ideal.simulation.attempts if a.held is not None]
    actual, predicted = excess_sag(solved_plan, held, np.random.default_rng(301))
    chances = [ks_2samp(a, p).pvalue for a, p in zip(actual.T, predicted.T, strict=True)]
    assert min(chances) > LEVEL / len(chances)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_gravity_and_ropes_are_what_mujoco_says(rig, seed):
    """The generalised forces against `qfrc_bias` and `qfrc_passive` at rest, anywhere."""
    rng = np.random.default_rng(seed)
    roped = dataclasses.replace(rig, edit=pulled)
    m = read_mechanism(roped)
    model = laboratory_scene(roped, np.zeros((2, 3))).compile()
    data = mujoco.MjData(model)
    free = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
    first, dof = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
    angles = rng.uniform(-0.1, 0.1, len(m.names))  # within all limits but the knees'
    angles[[3, 9]] = rng.uniform(0.1, 1.0, 2)
    pose, quaternion = rng.uniform(-1, 1, 3), rng.standard_normal(4)
    data.qpos[first : first + 3] = pose
    data.qpos[first + 3 : first + 7] = quaternion / np.linalg.norm(quaternion)
    for name, angle in zip(m.names, angles, strict=True):
        data.joint(name).qpos[:] = angle
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    rotation = data.body("torso").xmat.reshape(3, 3)
    state = StaticState(pose, rotation, angles, np.zeros((2, 6)))
    load = Load(angles[m.joints], np.zeros(12), np.zeros((2, 3)), np.zeros((2, 3)), m.mass, m.center)
    left = residual(m, state, load)
    expected = data.qfrc_passive - data.qfrc_bias
    rows = [model.joint(name).dofadr[0] for name in m.names]
    np.testing.assert_allclose(left[6:18], expected[rows], atol=1e-9)
    np.testing.assert_allclose(left[:3], expected[dof : dof + 3], atol=1e-9)
    np.testing.assert_allclose(rotation.T @ left[3:6], expected[dof + 3 : dof + 6], atol=1e-9)


@pytest.mark.parametrize(("preset", "readings"), [("wii", "cell_forces"), ("foot-ft", "wrenches")])
def test_runs_are_the_same_bits_however_they_are_grouped(robot, plan, preset, readings):
    solved_plan = solve_plan(preset_rig(preset, robot), plan.take(plan.placement <= 4))
    streams = np.random.SeedSequence(5).spawn(5)
    together: list[Any] = list(run_statics(solved_plan, streams))
    for run, stream in zip(together, streams, strict=True):
        alone: Any = run_statics(solved_plan, [stream])[0]
        assert alone.truth.dropped == run.truth.dropped
        assert np.array_equal(alone.truth.zeros, run.truth.zeros)
        for name in ("joint_angles", readings, "plate_poses", "time", "command"):
            assert np.array_equal(getattr(alone.measurements, name), getattr(run.measurements, name))


def test_its_readings_scatter_as_sampled_ones_do():
    s = PRESETS["wii"]
    rng = np.random.default_rng(7)
    truth = rng.uniform(0, 50, 20000)
    for noise in (s.cell_noise, 0.01):
        figures = (s.cell_repeatability, noise, s.cell_resolution)
        mean, spread = sample(truth, figures, 30, rng)
        slow = mean - truth
        square = 29 / 30 * (noise**2 + s.cell_resolution**2 / 12)  # of the readings' s.d., of 30 samples
        assert noise == 0.01 or (spread**2).mean() == pytest.approx(square, rel=0.01)
        fast = sample_mean(truth, figures, 30, rng)[0] - truth
        sd = averaged_sd(*figures, 30)
        for error in (slow, fast):
            assert abs(error.std() / sd - 1) < 5 / np.sqrt(2 * len(truth))
            assert abs(error.mean()) < 5 * sd / np.sqrt(len(truth))


def test_a_posture_that_nobody_can_hold_is_not_solved(rig, plan):
    """Leaning so far that the torque limits do not carry it, with a sole outside its corners."""
    few = plan.take(np.arange(5))
    solved_plan = solve_plan(rig, changed(few, joint_angles=plus(0.6, 2, [4, 10])))
    (run,) = run_statics(solved_plan, np.random.SeedSequence(1).spawn(1))
    assert int(few.posture[2]) in [number for number, _ in run.truth.dropped]


def test_a_sole_is_held_against_its_own_edges(solved_plan):
    """Pressure near the toes of a foot turned by half a radian is inside of it; beside them it is not."""
    m, near = solved_plan.mechanism, solved_plan.reference.state
    yaw = 0.5
    state = near.take(np.zeros(2, int))
    feet = np.zeros((2, 2, 3))
    feet[:, 1] = [0.0, 0.2, yaw]
    for k, (x, y) in enumerate(((0.12, 0.0), (0.03, 0.06))):
        wx, wy = np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y
        state.wrench[k] = 0.0
        state.wrench[k, 0, 2] = state.wrench[k, 1, 2] = 100.0
        state.wrench[k, 1, 3:5] = [100 * wy, -100 * wx]
    load = Load(np.zeros(12), np.zeros(12), feet, feet, m.mass, m.center)
    reasons = faults(m, state, load, np.full((2, 8), 25.0), ("right_foot", "left_foot"))
    assert reasons[0] == ""
    assert reasons[1].startswith("lost sole corner left_foot_")


def test_the_feet_stay_when_the_last_posture_is_measured_again(rig, plan):
    """A repeat that follows its own first try is a move, not a new set-up."""
    one = plan.take(np.flatnonzero(plan.placement == 2))
    every = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=len(one)))
    measured = run_statics(solve_plan(every, one.take(np.array([0]))), [np.random.SeedSequence(1)])[0]
    nominal = nominal_robot(rig.robot)
    place = nominal.swing_sole(measured.measurements.joint_angles)[:, [0, 1, 5]]
    assert len(place) == 2
    np.testing.assert_allclose(place[1], place[0], atol=1e-9)


@pytest.mark.parametrize("imperfections", [0.0, 1.0])
def test_the_closed_slope_is_the_derivative(robot, plan, imperfections):
    """By central differences of the residual, with sole and joint springs and with one foot in the air."""
    several = tt.plans.mixed.take(np.arange(12))
    rig = drawn(tt.Laboratory(robot, "wii"), imperfections, np.random.SeedSequence(5)).rig
    solved, m = solve_plan(rig, several), read_mechanism(rig)
    assert has_closed_slope(m)
    load = Load(
        command=several.joint_angles,
        friction=np.zeros(len(m.names)),
        feet=several.foot_poses,
        plates=solved.boards[solved.placement],
        mass=m.mass,
        center=m.center,
        foot_contact=feet_in_contact(several.support),
    )
    found = closed_slope(m, solved.reference.state, load)
    assert found == pytest.approx(derivative(m, solved.reference.state, load), rel=1e-6, abs=1e-5)
