"""What MJCF can hold beyond links and joints: the statics have it as the dynamics, or it is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_equilibrium import compare, without_friction
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot_check import check_scene
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.shipped import PLANS
from tulip_testbed.sim.statics.solved_plan import solve_plan


def test_an_edit_that_statics_does_not_have_is_refused_by_it(robot, two):
    def floating(spec):
        spec.body("torso").gravcomp = 0.5

    rig = dataclasses.replace(preset_rig("ideal", robot), edit=floating)
    with pytest.raises(tt.InputError, match="static equilibrium: found gravcomp in body 'torso'"):
        solve_plan(rig, two)


REF = 0.5  # rad


def test_a_joint_that_is_drawn_bent_is_the_same_robot(edited_tulip, robot):
    """`ref` moves the zero of a joint's angle; static run and dynamics agree, and with the robot without."""
    degrees = np.degrees(REF)
    drive = '<joint name="right_knee" class="drive_90w_111"'
    moved = f'ref="{degrees}" range="{degrees} {120 + degrees}"'
    bent = edited_tulip(f'tulip.xml: {drive} range="0 120" => {drive} {moved}')
    plan = read_plan(PLANS / "random", robot)
    plan = plan.take(np.flatnonzero(plan.placement == 2))
    angles = plan.joint_angles.copy()
    angles[:, plan.joints.index("right_knee")] += REF
    shifted = dataclasses.replace(plan, joint_angles=angles)
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
    quiet = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    compared = compare(solve_plan(quiet, shifted), list(run_dynamics(quiet, shifted, 1).truth.attempts))
    assert len(compared.held) >= 3
    assert np.abs(compared.angles).max() < 1e-4
    assert np.abs(compared.cells).max() < 0.05
    assert compared.center.max() < 1e-5
    soles = [nominal_robot(one).swing_sole(at.joint_angles) for one, at in ((robot, plan), (bent, shifted))]
    assert np.abs(soles[0] - soles[1]).max() < 1e-9


def test_contact_pairs_of_the_robot_do_not_act_in_a_scene_that_is_built(edited_tulip):
    pair = '<contact><pair geom1="right_foot_front_left" geom2="left_foot_front_left"/></contact>'
    robot = edited_tulip(f"tulip.xml: <actuator> => {pair}<actuator>")
    assert load_scene(robot).compile().npair == 8


def test_a_clipped_range_in_a_scene_written_by_hand_is_refused(edited_tulip):
    """Of a robot that the scene includes from another file than the description."""
    robot = edited_tulip('scene_plates.xml: file="tulip.xml" => file="odd.xml"', built=False)
    text = (robot.folder / "tulip.xml").read_text()
    (robot.folder / "odd.xml").write_text(text.replace('range="0 120"', 'range="120 0"', 1))
    with pytest.raises(tt.InputError, match=r"joint 'right_knee': found range \[120, 0\]"):
        check_scene(preset_rig("ideal", tt.load_robot(robot.path)))
