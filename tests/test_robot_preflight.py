"""Robots as people bring them: what the laboratory supplies, warns of or refuses, at once and by name."""

import dataclasses
import warnings
from typing import Any

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.test_refusals import check_words, rows
from tulip_testbed.effects.targets import LEG_LINKS, LINKS
from tulip_testbed.experiments.checks import IMBALANCE, verdict
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of
from tulip_testbed.experiments.usable_plan import random_plan
from tulip_testbed.experiments.validate import balance_checks
from tulip_testbed.measurements import PosturePlan, write_measurements
from tulip_testbed.sim.drives import LEAST_ARMATURE
from tulip_testbed.sim.random_robots import draw_robot
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot_check import robot_findings
from tulip_testbed.sim.scene import laboratory_scene

POSES = np.array([[0.03, -0.16, 0.02], [0.05, 0.17, -0.01]])
OPTION = '<option timestep="0.001" integrator="Euler" cone="elliptic"/>'
# Changes of TULip's files.
ODD_OPTION = (
    f'tulip.xml: {OPTION} => <option timestep="0.005" integrator="RK4" cone="pyramidal" iterations="1" '
    'ls_iterations="1" solver="CG" impratio="50" noslip_iterations="3" density="1.2" jacobian="sparse">'
    '<flag warmstart="disable" island="disable"/></option><size memory="100K"/>'
)
PAIR = (
    'tulip.xml: <actuator> => <contact><pair geom1="right_foot_front_left" geom2="left_foot_front_left"/>'
    '<exclude body1="torso" body2="right_foot"/></contact><actuator>'
)
GEOM, SITE = '<geom contype="0" conaffinity="0"', '<site group="4" size="0.005"/>'
ODD_GEOM = f'tulip.xml: {GEOM}/> => {GEOM} margin="0.01"/>'
ODD_DEFAULT = (
    f'tulip.xml: {SITE} => {SITE}<equality solref="0.5 1"/><pair margin="0.01"/><tendon stiffness="3"/>'
)
SHANK = '<body name="right_ankle"'
FRAME = f'tulip.xml: {SHANK} => <body name="imu" pos="0 0 0.1"><site name="imu_site"/></body>{SHANK}'
SOFT_DRIVE = (
    'tulip.xml: <joint armature="0.0148" damping="0.4" frictionloss="0.51"/> => <joint armature="0.001" '
    'damping="0.4" frictionloss="0.51" solreffriction="0.02 1" solimpfriction="0.9 0.95 0.001"/>'
)


def planned(plan: PosturePlan, robot: tt.Robot, placements: int) -> PosturePlan:
    few = plan.take(np.flatnonzero(plan.placement <= placements))
    return dataclasses.replace(few, robot={"model": robot.model_file.name, "sha256": robot.model_hash})


def test_a_frame_without_mass_is_no_target_and_draws_no_numbers(robot, edited_tulip):
    """TULip, and TULip with an IMU's frame at its right shank."""
    plain, framed = robot, edited_tulip(FRAME)
    for targets in (LINKS, LEG_LINKS):
        assert targets.of(plain, ()) == targets.of(framed, ())
    drawn = [draw_robot(one.model, 0.1, np.random.default_rng(1)) for one in (plain, framed)]
    names = [framed.model.body(k).name for k in range(1, framed.model.nbody)]
    assert np.array_equal(drawn[0], np.delete(drawn[1], names.index("imu"), axis=0))


def test_hips_that_a_leg_continues_along_their_axis_have_no_width_of_their_own(edited_tulip, robot):
    yaw, hip = ('name="right_hip_yaw" class="drive_60w_66" axis="0 0 1"', '<body name="right_hip">')
    along = (yaw.replace("0 0 1", "0 1 0"), hip.replace(">", ' pos="0 -0.02 0">'))
    changed = edited_tulip(f"tulip.xml: {yaw} => {along[0]}", f"tulip.xml: {hip} => {along[1]}")
    _, *others = LEG_LINKS.of(robot, ())
    assert LEG_LINKS.of(changed, ()) == ("right_hip_yaw", *others)


@pytest.mark.slow
@pytest.mark.parametrize(
    "texts",
    [
        pytest.param([ODD_OPTION], id="options"),
        pytest.param([PAIR], id="contacts"),
        pytest.param([ODD_GEOM, ODD_DEFAULT], id="defaults"),
    ],
)
def test_what_is_set_in_the_robots_file_does_not_act_in_its_scene(edited_tulip, plan, texts):
    forces = []
    for robot in (edited_tulip(name="plain"), edited_tulip(*texts, name="odd")):
        one = planned(plan, robot, 1).take(np.arange(1))
        run = tt.Laboratory(robot, "ideal").run(one, 1, "dynamics", 1)
        forces.append(run.measurements.cell_forces)
    assert np.array_equal(forces[0], forces[1])


def test_gravity_stays_the_robots(edited_tulip):
    moon = edited_tulip(f'tulip.xml: {OPTION} => {OPTION[:-2]} gravity="0 0 -1.62"/>')
    assert laboratory_scene(preset_rig("ideal", moon), POSES).option.gravity[2] == -1.62


def test_a_scene_written_by_hand_keeps_its_time_step_and_takes_the_solver(edited_tulip):
    spec = laboratory_scene(preset_rig("ideal", edited_tulip(ODD_OPTION, built=False)), POSES)
    assert spec.option.timestep == 0.005
    assert spec.option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert (spec.option.iterations, spec.option.tolerance) == (100, 1e-12)
    assert spec.option.solver == mujoco.mjtSolver.mjSOL_NEWTON


def test_an_imbalance_fails_the_verdict(robot, two):
    run = tt.Laboratory(robot, "ideal").run(two.take(np.arange(2)), 1, "dynamics", 1)
    check: Any = balance_checks(run)[0]
    assert check.result == "pass"
    assert check.value < 0.01
    held = run.truth.held[0]
    bound = IMBALANCE * run.truth.mass * 9.81
    for name, size in (("torques", 19.0), ("weight", -1.1 * bound), ("centre", 1.1 * IMBALANCE)):
        worse = dataclasses.replace(held, balance=dataclasses.replace(held.balance, **{name: size}))
        first, *rest = run.truth.attempts
        truth = dataclasses.replace(run.truth, attempts=(dataclasses.replace(first, held=worse), *rest))
        checks: Any = balance_checks(dataclasses.replace(run, truth=truth))
        assert verdict(checks) == "fail"
        assert checks[0].value > 1


def test_effects_are_judged_by_what_statics_leaves_over_alone(robot, two):
    """Cells that stand elsewhere set the centre of pressure apart: the effect, no fault of the simulation."""
    laboratory = tt.Laboratory(robot, "ideal").with_effects("cell-position-scale=0.05")
    (check,) = balance_checks(laboratory.run(two.take(np.arange(2)), 1, "dynamics", 1))
    assert check.result == "pass"
    assert check.source.startswith("torques")
    assert balance_checks(laboratory.run(two, 1, "statics", 1)) == []


def test_tulip_and_the_humanoids_lack_nothing(robot, foreign):
    for one in (robot, *foreign.values()):
        assert not list(robot_findings(one))


def test_too_little_armature_and_soft_friction_are_supplied_and_said(edited_tulip):
    robot = edited_tulip(SOFT_DRIVE)
    found = {finding.name: finding for finding in robot_findings(robot)}
    assert list(found) == ["armature", "friction"]
    assert "right_hip_yaw (0.001 of 0.014)" in found["armature"].found
    assert "chatter" in found["armature"].consequence
    assert "right_hip_yaw" in found["friction"].found
    assert "Items that this robot lacks for the laboratory" in repr(tt.describe_robot(robot.path))
    scene = laboratory_scene(preset_rig("ideal", robot), POSES)
    joint = scene.joint("right_hip_yaw")
    assert joint.armature == pytest.approx(LEAST_ARMATURE * 10.1)
    assert joint.solref_friction.tolist() == [0.002, 1.0]
    assert joint.solimp_friction[:3].tolist() == [0.9999, 0.9999, 0.001]
    assert robot.spec.joint("right_hip_yaw").armature == 0.001
    assert scene.joint("right_knee").armature == 0.0862


@rows("findings")
def test_what_a_robot_lacks_is_said(edited_tulip, changes, words):
    (finding,) = robot_findings(edited_tulip(*changes))
    check_words(words, f"{finding.name}: {finding.found}; {finding.assumed}; {finding.consequence}")


def test_findings_are_warned_of_once(edited_tulip, plan):
    robot = edited_tulip(SOFT_DRIVE)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        random_plan(robot, 4, 4, 1)
        tt.Laboratory(robot).run(planned(plan, robot, 1), 1, "statics", 1)
    assert [warning.category for warning in caught] == [tt.InputWarning, tt.InputWarning]
    assert "tulip.xml: found an armature below" in str(caught[0].message)
    assert "frictionloss softer than" in str(caught[1].message)


def test_a_free_joint_without_a_name_takes_its_bodys(edited_tulip, plan, robot):
    nameless = edited_tulip('tulip.xml: <freejoint name="torso"/> => <freejoint/>')
    assert nameless.model.joint(0).name == "torso"
    few = planned(plan, nameless, 1)
    run = tt.Laboratory(nameless, "ideal").run(few, 1, "statics", 1)
    shipped = tt.Laboratory(robot, "ideal").run(planned(plan, robot, 1), 1, "statics", 1)
    assert np.array_equal(run.measurements.cell_forces, shipped.measurements.cell_forces)


def test_the_preflight_guesses_no_units_by_another_robots_ranges(edited_tulip, plan, robot):
    run = tt.Laboratory(robot).run(planned(plan, robot, 1), 1, "statics", 1)
    stiff = edited_tulip('tulip.xml: range="0 120" => range="0 5"')
    checks = {check["name"]: check for check in tt.check(run.measurements, stiff).to_json()["checks"]}
    assert checks["robot"]["result"] == "fail"
    assert checks["units"]["result"] == "not evaluated"
    assert checks["units"]["seen"].startswith("correct the robot first")


def test_the_whole_verdict_has_the_balance(moved_wii):
    assert moved_wii.checks[-1].name == "imbalance over its bound"
    assert moved_wii.checks[-1].result == "pass"


def test_a_monte_carlo_counts_a_run_out_of_balance_as_failed(robot, two, monkeypatch):
    """A bound that no hold keeps stands for a hold that keeps no bound."""
    source = source_of(tt.Laboratory(robot), two.take(np.arange(2)), None, "dynamics")
    monkeypatch.setattr("tulip_testbed.experiments.checks.IMBALANCE", 1e-30)
    failure: Any = source([np.random.SeedSequence(1)])[0]
    assert failure.startswith("imbalance over its bound: torques against statics")


def test_data_of_another_robot_are_said_to_be_first(robot, foreign, plan, tmp_path):
    run = tt.Laboratory(robot).run(planned(plan, robot, 6), 1, "statics", 1)
    write_measurements(tmp_path / "data", run.measurements)
    with pytest.raises(tt.InputError, match=r"with other joints, expected robot\.xml of humanoid"):
        tt.check(tmp_path / "data", foreign["humanoid"])
