"""Effects that are corrected for twice or belong to another robot; a catalogue that nobody changes."""

from __future__ import annotations

import copy
import dataclasses
import json
import operator
import pickle
from typing import Any

import pytest

import tulip_testbed as tt
from tests.rigs import write_rig
from tests.test_cli import refused
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.rig_folder import read_rig

KNEE, ANKLE = "encoder-offset:right_knee=0.01", "encoder-offset:left_ankle_roll=0.002"
TWICE = r"found encoder-offset:right_knee twice \(encoder-offset:right_knee=0.01 and .*expected it once"


def test_a_correction_counts_once(run, robot, tmp_path):
    twice = [EffectInstance.parse(text, robot) for text in (KNEE, ANKLE, "encoder-offset:right_knee=0.02")]
    for call in (
        lambda: tt.identify(run, robot, corrections=twice),
        lambda: tt.identify(run, robot, corrections=[KNEE, KNEE]),
        lambda: tt.check(run, robot, corrections=[KNEE, KNEE]),
        lambda: tt.Laboratory(robot, known=(twice[0], twice[2])),
        lambda: tt.Laboratory(robot).with_known(KNEE).with_known(KNEE),
    ):
        with pytest.raises(tt.InputError, match=TWICE):
            call()
    with pytest.warns(tt.InputWarning, match="but the measurements show"):  # the robot has neither
        assert len(tt.identify(run, robot, corrections=[KNEE, ANKLE])) == 25
    slips = ["encoder-slip:right_knee=0.01,0.5", "encoder-slip:right_knee=0.01,0.7"]
    assert len(tt.Laboratory(robot).with_known(*slips).known) == 2


@pytest.fixture
def rig(robot, tmp_path):
    found = EffectInstance.parse(KNEE, robot)
    write_rig(tmp_path / "rig", robot, [dataclasses.replace(found, intervals=((0.008, 0.012),))])
    return tmp_path / "rig"


def edit(rig, change):
    document = json.loads((rig / "rig.json").read_text())
    change(document["effects"])
    (rig / "rig.json").write_text(json.dumps(document))


def test_a_rig_with_an_effect_twice_is_refused(rig, robot, run, tmp_path, capsys):
    edit(rig, lambda effects: effects.append(effects[0]))
    with pytest.raises(tt.InputError, match=rf"rig\.json: key 'effects': {TWICE}"):
        read_rig(rig, robot)
    tt.write_measurements(tmp_path / "data", run.measurements)
    assert "right_knee twice" in refused(capsys, "identify", tmp_path / "data", "--corrections", rig)


def test_an_effect_of_another_robot_is_refused_with_the_valid_targets(robot, foreign, run):
    others = EffectInstance.parse("encoder-offset:abdomen_z=0.01", foreign["humanoid"])
    for call in (
        lambda: tt.Laboratory(robot).with_effects(others),
        lambda: tt.Laboratory(robot).with_known(others),
        lambda: tt.Laboratory(robot, hidden=(others,)),
        lambda: tt.identify(run, robot, corrections=others),
        lambda: tt.check(run, robot, corrections=[others]),
    ):
        with pytest.raises(tt.InputError, match=r"unknown target 'abdomen_z'; valid: right_hip_yaw, .*"):
            call()
    for values, intervals in (((), ()), ((0.1, 0.2), ()), ((0.1,), (None, None))):
        odd = dataclasses.replace(EffectInstance.parse(KNEE, robot), values=values, intervals=intervals)
        with pytest.raises(tt.InputError, match="expected 1 values, and an interval for each or for none"):
            tt.Laboratory(robot).with_effects(odd)


def test_nobody_can_change_the_catalogue():
    catalogue: Any = tt.effects.catalogue()
    names = list(catalogue)
    for change in (
        lambda: catalogue.clear(),
        lambda: catalogue.pop("payload"),
        lambda: catalogue.update({}),
        lambda: operator.setitem(catalogue, "payload", None),
        lambda: operator.delitem(catalogue, "payload"),
    ):
        with pytest.raises((AttributeError, TypeError)):
            change()
    assert list(tt.effects.catalogue()) == names == sorted(names)
    assert catalogue.get("payloda") is None
    assert catalogue["payload"].name == "payload"
    for again in (pickle.loads(pickle.dumps(catalogue)), copy.deepcopy(catalogue)):
        assert again is catalogue


def test_a_joint_that_yields_in_two_places_yields_by_both(robot):
    """An ordinary laboratory, for instance, in which a joint yields more than usual."""
    one = "joint-compliance:right_knee"
    laboratory = tt.Laboratory(robot).with_effects(f"{one}=0.001").with_effects(f"{one}=0.003")
    runs = [
        lab.run(tt.plans.random.take(tt.plans.random.placement <= 1), 3, "statics").measurements
        for lab in (laboratory, tt.Laboratory(robot).with_effects(f"{one}=0.004"))
    ]
    assert runs[0].cell_forces == pytest.approx(runs[1].cell_forces, abs=1e-6)
