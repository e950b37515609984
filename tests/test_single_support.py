"""Postures on the stance foot alone: in the dynamics, in statics, in the estimate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from studies.study_equilibrium import compare, without_friction
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.validate import validate
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.center_of_pressure import center_of_pressure, load_shares
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.measurements import PosturePlan, read_measurements, write_measurements
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

# Leaning over the stance hip, so that its roll drive holds the rest of the robot; the other leg lifted.
STANCE = np.array([0.0, -0.35, -0.3, 0.5, -0.2, 0.05, 0.0, 0.1, -0.6, 1.0, -0.3, 0.0])
OVER = np.array([0.03, 0.0])  # m, where the centre of mass is to be
TO_COME = 0.1  # m, how far the swing foot is off the ground at least


@pytest.fixture(scope="module")
def balanced(robot, model, plan) -> PosturePlan:
    """Twenty postures on the stance foot, in four placements."""
    nominal, limits = nominal_robot(robot, "right"), [model.joint(name).range for name in plan.joints]
    low, high = np.transpose(limits)
    rng, found = np.random.default_rng(17), []
    while len(found) < 20:
        angles = np.clip(STANCE + rng.normal(0, 0.1, 12), low + 0.02, high - 0.02)
        for _ in range(8):
            steps = np.zeros((2, 12))
            steps[[0, 1], [4, 5]] = 1e-5
            center = nominal.center_of_mass(angles[None])[0]
            slope = (nominal.center_of_mass(angles + steps) - center).T / 1e-5
            angles[[4, 5]] -= np.linalg.solve(slope, center - OVER)
        inside = (angles > low).all() and (angles < high).all()
        if inside and nominal.swing_sole(angles[None])[0, 2] > TO_COME:
            found.append(angles)
    return dataclasses.replace(
        plan.take(np.arange(20)), joint_angles=np.array(found), support=np.full(20, "right")
    )


def test_statics_is_where_the_dynamics_come_to_rest(robot, balanced):
    rig = preset_rig("ideal", robot)
    few = balanced.take(np.arange(5))
    quiet = dataclasses.replace(
        rig, edit=without_friction(), protocol=dataclasses.replace(rig.protocol, repeats=0)
    )
    experiment = run_dynamics(quiet, few, 1)
    found = compare(solve_plan(quiet, few), list(experiment.truth.attempts))
    assert len(found.held) == 5
    assert np.abs(found.angles).max() < 1e-5
    assert np.abs(found.cells).max() < 0.01
    assert (np.abs(experiment.measurements.cell_forces[:, 4:]) < 1e-6).all()
    assert set(experiment.measurements.support) == {"right"}
    for attempt in found.held:
        assert attempt.held is not None
        assert attempt.held.balance.centre < 1e-5
        assert abs(attempt.held.balance.weight) < 1e-3


def test_both_supports_together_tell_26_parameters(robot, plan, balanced):
    mixed = joined(plan.take(plan.placement <= 16), balanced)
    rig = preset_rig("ideal", robot)
    (run,) = run_statics(solve_plan(rig, mixed), np.random.SeedSequence(3).spawn(1))
    assert set(run.measurements.support) == {"double", "right"}
    found = identify(run.measurements, robot)
    truth = base_parameters(robot, support="right").values(run.truth.standard)
    assert len(found.full.value) == 26
    assert found.full.names[25] == "left_foot.z"
    # Feet tilt by micrometres on their contacts, which the estimator takes for flat.
    np.testing.assert_allclose(found.full.value, truth, rtol=0, atol=1e-4)
    assert found.simplified.names[-1] == "left_foot.z"
    kept = truth[found.simplified.numbers - 1]
    np.testing.assert_allclose(found.simplified.value, kept, rtol=0, atol=1e-4)


def test_an_empty_plate_is_not_read(robot, balanced):
    (run,) = run_statics(solve_plan(preset_rig("wii", robot), balanced), np.random.SeedSequence(5).spawn(1))
    measured = run.measurements
    noisy = measured.cell_forces.copy()
    noisy[:, 4:] += 5.0
    louder = dataclasses.replace(measured, cell_forces=noisy)
    np.testing.assert_array_equal(center_of_pressure(louder), center_of_pressure(measured))
    np.testing.assert_array_equal(load_shares(louder)[:, 0], 1.0)


def test_on_both_feet_the_26th_parameter_has_no_effect(robot, plan, model):
    both, one = (base_parameters(robot, support=support) for support in ("double", "right"))
    columns = one.regressor(plan.joint_angles)
    np.testing.assert_allclose(columns[..., :25], both.regressor(plan.joint_angles), atol=1e-12)
    assert np.abs(columns[..., 25]).max() < 1e-6
    standard = standard_parameters(model)
    np.testing.assert_allclose(one.values(standard)[:25], both.values(standard), atol=1e-15)


@pytest.mark.slow
def test_the_whole_job_in_full_dynamics(robot, plan, balanced):
    mixed = joined(plan.take(plan.placement <= 8), balanced.take(np.arange(5)))
    result = validate(Laboratory(robot, "ideal"), mixed, 4, MIXED_MODEL, workers=2, imperfections=0)
    by_name = {check.name: check.result for check in result.checks}
    assert len(result.identification.full.value) == 26
    assert by_name["full model: largest error (mm)"] == "pass"
    assert by_name["total mass"] == "pass"


def test_the_preflight_says_what_it_leaves_out(robot, balanced, tmp_path):
    rig = preset_rig("wii", robot)
    (run,) = run_statics(solve_plan(rig, balanced), np.random.SeedSequence(4).spawn(1))
    write_measurements(tmp_path / "data", run.measurements)
    findings = preflight(read_measurements(tmp_path / "data"), nominal_robot(robot), None)
    by_name = {finding.name: finding for finding in findings}
    assert "stands on one foot" in by_name["legs close"].seen
    assert "26 parameters" in by_name["identifiable"].expected


def joined(first: PosturePlan, second: PosturePlan) -> PosturePlan:
    """Two plans after one another, the second's numbers behind the first's."""
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in ("joint_angles", "support", "swing_pose")
    }
    for name in ("posture", "placement"):
        ahead = getattr(first, name)
        columns[name] = np.concatenate([ahead, ahead.max() + getattr(second, name)])
    return dataclasses.replace(first, **columns)
