"""Preflight of wrench sensors: what they carry, what must cancel, and which checks need cells."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import changed, plus, put, within
from tulip_testbed.experiments.check_folder import check_measurements, counts_line
from tulip_testbed.measurements.contacts import VERTICAL, WRENCH

FEET_NOISE = np.diag([1.0, 1.0, 1.0, 0.05, 0.05, 0.05]) ** 2


@pytest.fixture(scope="module")
def standing(robot, plan):
    """Readings of sensors in the feet, at the ankle, whose zeros are taken off."""
    run: Any = tt.Laboratory(robot, "foot-ideal").run(plan.take(plan.placement <= 4), 1, "statics")
    m = run.measurements
    contacts = dataclasses.replace(m.contacts, covariance=FEET_NOISE, zero_sd=np.zeros((2, 6)))
    return dataclasses.replace(m, contacts=contacts, wrenches=m.wrenches - run.truth.zeros)


def checks(m, robot):
    return {one["name"]: one for one in check_measurements(m, robot).to_json()["checks"]}


def test_forces_that_cancel_pass_and_those_of_cells_are_skipped_with_a_reason(standing, robot):
    found = checks(standing, robot)
    assert found["horizontal forces"]["result"] == "pass"
    assert found["carried weight"]["result"] == "pass"
    for name in ("cell loads", "plate poses", "repeats", "scatter about the model"):
        assert found[name]["result"] == "not evaluated"
        assert "there are wrench sensors" in found[name]["seen"]


def test_forces_that_do_not_cancel_are_told_and_weighed_by_the_height_of_the_sensor(standing, robot):
    pushed = changed(standing, wrenches=plus(30.0, ..., 0, 0))
    found = checks(pushed, robot)["horizontal forces"]
    # 30 N of 225 N at the ankle, 60 mm over the sole, are 8 mm.
    assert found["result"] == "fail"
    assert "they do not cancel" in found["seen"]
    pose = np.zeros((2, 6))
    pose[:, 2] = -0.06
    assert checks(within("contacts", pushed, pose=pose), robot)["horizontal forces"]["result"] == "warn"


def test_a_turned_foot_turns_its_forces(standing, robot):
    """Without the feet's yaw the same readings would not cancel."""
    yaw = np.zeros((2, 6))
    yaw[1, 5] = np.pi / 2
    found = checks(within("contacts", standing, pose=yaw), robot)["horizontal forces"]
    assert found["result"] != "pass"


def test_the_threshold_is_that_of_noise_and_zeros_or_a_share_of_the_weight(standing, robot):
    pushed = changed(standing, wrenches=plus(12.0, ..., 0, 0))
    zero = np.zeros((2, 6))
    zero[:, :3] = 3.0
    assert checks(pushed, robot)["horizontal forces"]["result"] != "pass"
    assert checks(within("contacts", pushed, zero_sd=zero), robot)["horizontal forces"]["result"] == "pass"
    unstated = checks(within("contacts", pushed, covariance=None), robot)["horizontal forces"]
    assert unstated["result"] != "pass"
    assert "2 % of the weight" in unstated["expected"]
    unknown = checks(within("contacts", pushed, zero_sd=np.full((2, 6), np.inf)), robot)
    assert unknown["carried weight"]["result"] == "not evaluated"
    assert "zeros" in unknown["carried weight"]["seen"]
    assert unknown["horizontal forces"]["result"] == "pass"  # a zero is constant
    more = changed(pushed, wrenches=plus(12.0, -1, 0, 0))
    pulled = within("contacts", more, zero_sd=np.full((2, 6), np.inf))
    assert "a constant and" in checks(pulled, robot)["horizontal forces"]["seen"]
    assert checks(pulled, robot)["horizontal forces"]["result"] != "pass"


def test_vertical_channels_have_no_horizontal_forces(standing, robot):
    places = [WRENCH.index(channel) for channel in VERTICAL]
    m = within(
        "contacts",
        dataclasses.replace(
            standing, wrenches=standing.wrenches[..., places], wrenches_sd=standing.wrenches_sd[..., places]
        ),
        channels=VERTICAL,
        covariance=None,
        zero_sd=np.zeros((2, 3)),
    )
    found = checks(m, robot)["horizontal forces"]
    assert found["result"] == "not evaluated"
    assert "vertical forces and their moments only" in found["seen"]


def test_a_wrong_weight_is_told(standing, robot):
    heavy = put(..., 2, value=1.3 * standing.wrenches[..., 2])
    found = checks(changed(standing, wrenches=heavy), robot)["carried weight"]
    assert found["result"] == "fail"
    assert "(+28.4 %)" in found["seen"]  # what hangs below the sensors is not on them


def test_a_dead_channel_is_told_but_not_a_constant_joint(standing, robot):
    m = changed(standing, wrenches=put(..., 1, 3, value=0.25), joint_angles=put(..., 0, value=0.1))
    assert "q.right_hip_yaw reads 0.1 in all postures" in checks(m, robot)["stuck readings"]["seen"]
    m = dataclasses.replace(m, constant_joints={"right_hip_yaw": 0.1})
    found = checks(m, robot)["stuck readings"]
    assert "wrench.left.mx reads 0.25" in found["seen"]
    assert "right_hip_yaw" not in found["seen"]


def test_a_pass_says_what_was_not_evaluated_and_why(standing, robot):
    found = check_measurements(standing, robot)
    counts = found.counts
    evaluated = sum(counts.values()) - counts["not evaluated"]
    assert counts["not evaluated"] > 5
    assert counts_line(counts).startswith(f"{evaluated} of {sum(counts.values())} checks evaluated: ")
    lines = [part for part in found.tables() if isinstance(part, str) and part.startswith("Not evaluated: ")]
    assert lines[0].endswith("(needs the readings of vertical cells; there are wrench sensors).")
    skipped = [name for line in lines for name in line.partition(": ")[2].partition(" (")[0].split(", ")]
    assert set(skipped) == {one.name for one in found.checks if one.result == "not evaluated"}
