"""A joint with so much play that its link seldom rests at an end."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tulip_testbed.calibration.self_calibration import _negative, self_calibrate
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.discovery.discover import _is_rest, discover
from tulip_testbed.discovery.loose_parts import hidden_joints, speaks_of
from tulip_testbed.discovery.patterns import Pattern
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.laws import law_effect
from tulip_testbed.experiments.identify import identify, warn_of_unrest
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe

JOINT, WIDTH = "left_ankle_roll", 0.016


@pytest.fixture(scope="module")
def measured(robot, plan) -> tt.Measurements:
    """Cheap cells, as on balance boards: an ankle's load is known within half a newton metre."""
    hidden = (tt.EffectInstance(catalogue()["backlash"], JOINT, (WIDTH,)),)
    return tt.Laboratory(robot, "wii", hidden=hidden).run(plan, 1007, "statics").measurements


@pytest.fixture(scope="module")
def observed(measured, robot):
    return observe(measured, nominal_robot(robot))


def test_no_joint_yields_against_its_load(observed):
    found = self_calibrate(observed)
    assert "joint-compliance" in found.absent
    assert "joint-compliance" not in [one.family.name for one in found.families]
    begun = self_calibrate(observed, start=found, rounds=1)
    assert begun.absent == found.absent  # what begins at another has its families
    play = tt.EffectInstance(catalogue()["backlash"], JOINT, (WIDTH,))
    assert not self_calibrate(observed, rounds=1, absent=()).absent
    sized = self_calibrate(observed, effects=[play], start=found)
    assert sized.solved.log_evidence > found.solved.log_evidence + 50


def test_who_identifies_is_told_of_negative_compliances(measured, robot):
    with pytest.warns(
        tt.InputWarning, match="joint-compliance.* negative beyond doubt.* `discover` says more"
    ):
        warn_of_unrest(identify(measured, robot), "loose")


@pytest.mark.parametrize(("center", "negative"), [(0.0, True), (0.002, False)])
def test_a_compliance_is_negative_with_its_mean(center, negative):
    family = SimpleNamespace(name="joint-compliance", positive=True, center=np.array([center, center]))
    known = SimpleNamespace(
        family=family, value=np.array([1e-4, -1e-3]), standard_error=np.array([2e-4, 2e-4])
    )
    other = SimpleNamespace(family=SimpleNamespace(positive=False))
    found: Any = SimpleNamespace(families=(known, other))
    assert _negative(found) == (["joint-compliance"] if negative else [])


@pytest.mark.slow
def test_a_play_between_whose_ends_the_link_rests_is_named(measured, robot):
    found = discover(measured, robot)
    assert found.verdict == "named"
    assert [one.label for one in found.adopted] == [f"backlash:{JOINT}"]


def _term(kind: str, target: str, *values: float) -> Any:
    candidate = SimpleNamespace(effect=catalogue()[kind], target=target)
    return SimpleNamespace(candidate=candidate, values=values)


def test_what_rests_unseen_hides_its_encoder(observed):
    assert hidden_joints(observed, [_term("backlash", JOINT, WIDTH)]) == {JOINT}
    # A knee is loaded: its link rests at an end, and the readings show at which.
    assert not hidden_joints(observed, [_term("backlash", "left_knee", 0.002)])
    assert not hidden_joints(observed, [_term("encoder-offset", JOINT, 0.01)])
    assert not hidden_joints(observed, [_term("rocking", "left.rear_left", 0.0003)])
    sentence = f"encoder:{JOINT}/leg-load/linear"
    law: Any = SimpleNamespace(effect=law_effect(sentence), target=sentence)
    gain: Any = _term("encoder-gain", JOINT, 0.01).candidate
    for told in (gain, law):
        assert speaks_of(told, {JOINT})
        assert not speaks_of(told, {"right_knee"})
    assert not speaks_of(_term("joint-compliance", JOINT, 0.001).candidate, {JOINT})


@pytest.mark.parametrize(
    ("channel", "reading", "rests"),
    [("C", "", True), ("AC", JOINT, True), ("AC", "right_knee", False), ("AC", "", False), ("A", "", False)],
)
def test_where_a_link_rests_leaves_a_pattern_in_the_closure_of_the_legs(channel, reading, rests):
    pattern = Pattern(channel, "", 0.0, 0, 0.0, 0.0, reading)
    assert _is_rest(pattern, {JOINT}) == rests
    assert not _is_rest(pattern, set())


def test_loose_parts_are_ranked_at_plausible_sizes(observed):
    (play,) = [one for one in candidates(observed) if one.label == f"backlash:{JOINT}"]
    sized = play.at_sizes((0.5, 2.0))
    assert not sized.effect.sizes
    assert sized.settings == pytest.approx(play.prior * np.array([[0.5], [2.0]]))
    assert sized.values(np.zeros(0), 1) == pytest.approx(2.0 * play.prior)
