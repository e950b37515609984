"""What MJCF can hold beyond links and joints: the statics have it as the dynamics, or it is refused."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_equilibrium import compare, without_friction
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene_check import check_scene
from tulip_testbed.sim.shipped import PLANS, TULIP
from tulip_testbed.sim.statics.solved_plan import solve_plan


@pytest.fixture
def own(tmp_path):
    """Load TULip with other texts in its model; its scene is built."""

    def loaded(*texts, file="tulip.xml", built=True):
        folder = shutil.copytree(TULIP.parent, tmp_path / "own")
        edits = [(file, *pair) for pair in texts]
        if built:
            edits.append(("tulip.toml", 'scene = "scene_plates.xml"', 'plate = "plate.xml"'))
        for name, old, new in edits:
            text = (folder / name).read_text()
            assert old in text
            (folder / name).write_text(text.replace(old, new))
        return tt.load_robot(folder / "tulip.toml")

    return loaded


def test_a_scene_that_switches_physics_off_or_clips_a_cell_is_refused(own, tmp_path):
    odd = own(
        ("<default>", '<option><flag gravity="disable"/></option><default>'),
        file="scene_plates.xml",
        built=False,
    )
    with pytest.raises(tt.InputError, match=r"scene_plates\.xml: found .*gravity disabled"):
        check_scene(preset_rig("ideal", odd))
    shutil.rmtree(tmp_path / "own")
    other = own(
        ('<include file="tulip.xml"/>', '<include file="odd.xml"/>'), file="scene_plates.xml", built=False
    )
    text = (other.folder / "tulip.xml").read_text()
    (other.folder / "odd.xml").write_text(text.replace('range="0 120"', 'range="120 0"', 1))
    with pytest.raises(tt.InputError, match=r"joint 'right_knee': found range \[120, 0\]"):
        check_scene(preset_rig("ideal", tt.load_robot(other.path)))
    shutil.rmtree(tmp_path / "own")
    touch = '<touch name="plate_front_left"'
    clipped = own((touch, f'{touch} cutoff="50"'), file="plate.xml")
    with pytest.raises(tt.InputError, match="plate_front_left': found a cutoff of 50 N, expected none"):
        check_scene(preset_rig("ideal", clipped))


def test_an_edit_that_statics_does_not_have_is_refused_by_it(robot, two):
    def floating(spec):
        spec.body("torso").gravcomp = 0.5

    rig = dataclasses.replace(preset_rig("ideal", robot), edit=floating)
    with pytest.raises(tt.InputError, match="static equilibrium: found gravcomp in body 'torso'"):
        solve_plan(rig, two)


REF, KNEE = 0.5, '<joint name="right_knee"'  # rad


def test_a_joint_that_is_drawn_bent_is_the_same_robot(own, robot):
    """`ref` moves the zero of a joint's angle; static run and dynamics agree, and with the robot without."""
    degrees = np.degrees(REF)
    bent = own(
        (
            f'{KNEE} class="drive_90w_111" range="0 120"',
            f'{KNEE} class="drive_90w_111" ref="{degrees}" range="{degrees} {120 + degrees}"',
        )
    )
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


def test_contact_pairs_of_the_robot_do_not_act_in_a_scene_that_is_built(own):
    pair = '<contact><pair geom1="right_foot_front_left" geom2="left_foot_front_left"/></contact><actuator>'
    from tulip_testbed.sim.scene import load_scene

    assert load_scene(own(("<actuator>", pair))).compile().npair == 8
