"""The experiment that settles the rest: what it is expected to settle, its plan folder, the whole loop."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.test_refusals import refuse
from tulip_testbed.cli.main import main
from tulip_testbed.discovery.experiment_information import (
    Explanation,
    entropy,
    expected_entropy,
    probabilities,
    separations,
)
from tulip_testbed.discovery.next_experiment import (
    Doubt,
    doubts_of,
    minutes_of,
    rank_experiments,
    within_limits,
)
from tulip_testbed.discovery.story import story
from tulip_testbed.experiments.proposed_experiment import Proposals, read_experiment
from tulip_testbed.measurements import Experiment, joined

SEED = 31


@pytest.fixture(scope="module")
def lab(robot) -> tt.Laboratory:
    return tt.Laboratory(robot, sensors="force-plate")


def explanations(robot, *texts):
    return tuple(Explanation(tt.EffectInstance.parse(text, robot), 20.0) for text in texts)


@pytest.fixture(scope="module")
def ranked(robot, lab, twelve):
    """Two cells that a single experiment confuses, and the experiments that would tell them apart."""
    made = lab.with_effects("cell-tare:right.front_left=0.8").manipulated(session="one")
    measured = joined([made.run(twelve, seed=SEED, engine="statics", workers=1).measurements])
    both = explanations(robot, "cell-tare:right.front_left=0.8", "cell-tare:right.rear_right=0.8")
    return rank_experiments(measured, robot, [Doubt(both)], twelve)


def test_turning_the_plate_tells_its_cells_apart_and_the_other_one_does_not(ranked):
    by_words = {one.words: one for one in ranked}
    right = by_words["right plate turned by 180 deg"]
    left, more = by_words["left plate turned by 180 deg"], by_words["nothing changed, more postures"]
    assert ranked[0].words in ("right plate turned by 180 deg", "cells re-tared")
    assert right.settled > 0.9
    assert left.settled < 0.1
    assert right.separation > 10 * more.separation
    assert right.settled_per_minute > 5 * more.settled_per_minute


def test_a_hoist_is_told_from_a_gain_by_taking_it_off_alone(robot, lab, twelve):
    """A large force: the readings that it changes are those with it, planned or measured."""
    measured = lab.with_effects("hoist=12").run(twelve, seed=4, engine="statics", workers=1).measurements
    share = 12 / (9.81 * 23.0)
    doubt = Doubt(explanations(robot, "hoist=12", f"common-gain={-share}"))
    by_words = {one.words: one for one in rank_experiments(measured, robot, [doubt])}
    assert by_words["nothing changed, more postures"].settled < 0.1
    assert by_words["cable removed"].settled > 0.9


def test_an_expectation_against_one_by_hand():
    """One size each, orthogonal columns: the new data's ln BF is that of a normal deviate."""
    one, other = (
        Explanation(dataclasses.replace(instance, values=(1.0,)), 5.0)
        for instance in [tt.EffectInstance.parse("cell-tare:right.front_left=1", tt.load_robot())] * 2
    )
    before, after = np.diag([0.0, 0.0]), np.diag([9.0, 9.0])
    apart = separations([one, other], after)
    assert apart[0, 1] == pytest.approx(4.5)
    rng = np.random.default_rng(1)
    expected = expected_entropy([one, other], before, after, rng)
    # The same by brute force: draw the size from its prior, the data, and both evidences.
    draws = np.random.default_rng(2)
    size = 1.0 + draws.standard_normal(20000)
    pulls = np.stack([9 * size + 3 * draws.standard_normal(20000), 3 * draws.standard_normal(20000)])
    logs = 0.5 * pulls**2 / 10 - 0.5 * np.log(10)
    share = np.exp(logs - logs.max(axis=0))
    share = share / share.sum(axis=0)
    by_hand = float(entropy(share.T).mean())
    assert expected == pytest.approx(by_hand, abs=0.04)
    assert expected < 0.7 * float(entropy(probabilities([0.0, 0.0])))


def test_a_measured_angle_beyond_its_range_is_planned_at_the_limit(robot, twelve):
    low, high = robot.model.joint("left_hip_roll").range
    k = twelve.joints.index("left_hip_roll")
    angles = twelve.joint_angles.copy()
    angles[0, k], angles[1, k] = high + 0.0006, low - 0.0006
    planned = within_limits(dataclasses.replace(twelve, joint_angles=angles), robot).joint_angles
    assert (planned[0, k], planned[1, k]) == (high, low)
    angles[[0, 1], k] = planned[[0, 1], k]
    np.testing.assert_array_equal(planned, angles)


def test_minutes_are_those_that_are_stated():
    assert minutes_of(Experiment("", ("plates exchanged", "cable removed")), 6, 30) == 12 + 30 + 5 + 2


def test_only_gaps_with_several_explanations_are_doubtful(robot):
    """The other gaps' best explanations are taken as true; nothing is doubtful unless it is ambiguous."""
    texts = ("cell-tare:right.front_left=0.8", "cell-tare:right.rear_right=0.8")
    first, second = explanations(robot, *texts)
    (knee,) = explanations(robot, "encoder-offset:right_knee=0.01")
    third = [dataclasses.replace(knee, gap=2, log_bayes_factor=factor) for factor in (9.0, 5.0)]
    (doubt,) = doubts_of("ambiguous", [first, second, third[0]])
    assert doubt == Doubt((first, second), (third[0].instance,))
    assert len(doubts_of("ambiguous", [first, second, *third])) == 2
    assert doubts_of("named", [first, second]) == []


def test_nothing_to_settle_is_said(robot, lab, twelve):
    with pytest.raises(tt.InputError, match="expected one to settle"):
        rank_experiments(lab.run(twelve, engine="statics").measurements, robot, [])
    refuse("found the verdict named", Proposals("named", (), 2, "").save, "anywhere")


def test_the_plan_folder_holds_postures_manipulations_and_steps(robot, lab, ranked, tmp_path):
    found = Proposals("ambiguous", tuple(ranked), 2, "one")
    found.save(tmp_path / "next")
    experiment, number = read_experiment(tmp_path / "next")
    assert (experiment, number) == (found.best.experiment, 2)
    again = tt.plans.read(tmp_path / "next", robot)
    assert np.array_equal(again.posture, found.best.plan.posture)
    text = (tmp_path / "next" / "steps.md").read_text()
    assert text.startswith("# Experiment 2: ")
    assert "\n1. " in text
    assert "\n4. State in the manifest" in text
    document = found.to_json()
    assert document["experiments"][0]["manipulations"] == list(experiment.manipulations)
    json.dumps(document, allow_nan=False)
    assert "settled" in str(found)


def test_simulate_carries_an_experiment_out(ranked, tmp_path, capsys):
    Proposals("ambiguous", tuple(ranked), 2, "one").save(tmp_path / "next")
    command = ["simulate", "--experiment", str(tmp_path / "next"), "--sensors", "force-plate"]
    command += ["--engine", "statics", "--effects", "cell-tare:right.front_left=50"]
    assert main([*command, "--out", str(tmp_path / "second")]) == 0
    found = tt.read_measurements(tmp_path / "second")
    assert found.experiments == (ranked[0].experiment,)
    if ranked[0].words == "right plate turned by 180 deg":
        front, _, rear, _ = found.cell_forces[:, :4].T
        assert (rear - front).mean() > 0  # about -25 without the tare, -75 with it in front
    assert (
        main(["simulate", "plan", "--experiment", str(tmp_path / "next"), "--out", str(tmp_path / "x")]) == 2
    )
    assert "expected the plan of its own folder" in capsys.readouterr().err


@pytest.mark.slow
def test_two_cells_tares_are_settled_by_turning_the_plate(lab, tmp_path):
    made = lab.with_effects("cell-tare:right.front_left=0.8")
    data = [tmp_path / "first", tmp_path / "second"]
    run = made.manipulated(session="one").run(tt.plans.random, seed=3, engine="statics")
    tt.write_measurements(data[0], run.measurements)
    found = tt.discover(data[0], check=False)
    assert found.verdict == "ambiguous"
    without: Any = found.discovery
    assert "measure the quantity in question directly" in " ".join(story(without, []))
    proposals = tt.next_experiment(found, plan=tt.plans.random)
    proposals.save(tmp_path / "plan")
    assert tt.next_experiment(found).best.words in found.story[-2]  # by the measured postures
    turned = next(one for one in proposals.experiments if "right plate turned" in one.words)
    assert turned.settled_per_minute >= 0.99 * proposals.best.settled_per_minute
    inside = made.manipulated(*turned.experiment.manipulations, session="one")
    tt.write_measurements(data[1], inside.run(turned.plan, seed=4, engine="statics").measurements)
    both = tt.discover(data, check=False)
    assert both.verdict == "named"
    assert [one.label for one in both.adopted] == ["cell-tare:right.front_left"]
    (low, high), *_ = [one for one in both.adopted[0].intervals if one is not None]
    assert low < 0.8 < high
