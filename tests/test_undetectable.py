"""What an experiment cannot show or hardly shows: by target, and from which size on it would be found."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import tulip_testbed as tt
from tests.meshed_robot import meshed_plan
from tulip_testbed.base.errors import InputWarning
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.discovery.detectability import by_kind, least_multiple
from tulip_testbed.experiments.discovery_tables import weak_table
from tulip_testbed.identification.distributions import chi2_isf
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot

ARMS = {f"{side}_{joint}" for side in ("left", "right") for joint in ("elbow", "wrist_yaw", "wrist_roll")}


@pytest.fixture(scope="module")
def armed(meshed, plan) -> tuple[Robot, PosturePlan]:
    """TULip with arms and a head, and a plan that moves them."""
    few = plan.take(np.flatnonzero(plan.placement <= 12))
    return meshed, meshed_plan(meshed, few, np.random.default_rng(1))


@pytest.fixture(scope="module")
def found(armed):
    """An offset of 1.7 deg in an elbow, which the base parameters absorb."""
    robot, plan = armed
    laboratory = tt.Laboratory(robot, "wii").with_effects("encoder-offset:left_elbow=0.03")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of what this robot lacks
        run = laboratory.run(plan, 3, "statics")
    return tt.discover(run, robot, check=False, workers=1)


@pytest.mark.slow
def test_an_offset_that_the_base_parameters_absorb_is_listed_by_its_joint(found):
    assert found.verdict == "none"
    hidden = {u.candidate.label for u in found.discovery.undetectable}
    assert {f"encoder-offset:{joint}" for joint in ARMS} <= hidden
    assert "encoder-offset:right_knee" not in hidden
    (sentence,) = [line for line in found.story if "cannot detect" in line]
    group = next(part for part in sentence.split("`") if "encoder-offset" in part)
    assert ": " in group
    assert "left_elbow" in group
    assert "right_knee" not in group


@pytest.mark.slow
def test_every_effect_is_shown_or_hides_or_shows_weakly(found):
    """What is in no list is found at a plausible size with nine in ten."""
    selection = found.discovery.selection
    weak = {one.candidate.label: one.multiple for one in selection.weak}
    hidden = {one.candidate.label for one in found.discovery.undetectable}
    assert not hidden & set(weak)
    assert min(weak.values()) > 1
    everything = {one.label for one in candidates(found.discovery.observed)}
    assert hidden | set(weak) < everything
    assert "encoder-offset:right_knee" in everything - hidden - set(weak)


@pytest.mark.slow
def test_kinds_without_targets_are_those_of_which_no_target_shows(found):
    kinds = by_kind([one.candidate for one in found.discovery.undetectable], found.discovery.observed)
    assert kinds["payload"] == []
    assert kinds["unsettled"] == []
    assert set(kinds["encoder-offset"]) >= ARMS


@pytest.mark.slow
def test_the_result_has_them_by_target(found):
    weak = found.weakly_detectable
    assert weak == found.discovery.selection.weak
    for effect in weak:
        sizes = effect.candidate.effect.sizes
        if len(sizes) > 1:
            assert effect.least is None
        else:
            size = effect.candidate.effect.parameters[sizes[0]]
            assert effect.least == pytest.approx(effect.multiple * size.prior)
            assert effect.size.unit == size.unit
    assert len(weak_table(weak).rows) == len({effect.candidate.effect.name for effect in weak})


@pytest.mark.slow
def test_the_least_size_is_found_nine_times_in_ten(found):
    """By the test's own distribution: a shift of the residuals by that size, in many draws of the noise."""
    one = found.discovery.selection.weak[0]
    level = 1e-4
    multiple = least_multiple(one.candidate, 0.5, level)
    freedom = len(one.candidate.prior)
    rng = np.random.default_rng(5)
    draws = rng.standard_normal((200_000, freedom))
    draws[:, 0] += 0.5 * multiple
    sides = 2 if one.candidate.positive.any() else 1
    share = ((draws**2).sum(axis=1) > chi2_isf(sides * level, freedom)).mean()
    assert share == pytest.approx(0.9, abs=0.01)
