"""Force-torque sensors in the feet: their readings as forces and levers, and what their zeros hide."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.removal import corrected
from tulip_testbed.experiments.identify import check_physical, identify
from tulip_testbed.identification.contact_readings import of_wrenches
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import packed, residuals, sensitivity, unpacked
from tulip_testbed.measurements.contacts import WRENCH, Contacts


@pytest.fixture(scope="module")
def run(robot):
    """Double support alone, exact sensors in the ankles, with zeros that nobody knows."""
    return tt.Laboratory(robot, sensors="foot-ideal").run(tt.plans.random, seed=3, engine="statics")


@pytest.fixture(scope="module")
def found(run, robot):
    return identify(run.measurements, robot)


def test_five_combinations_pass_for_zeros_and_the_others_are_exact(run, found):
    """Zeros of the moments: parameters 5, 13 (right) and 9, 16 (left); that of the left vertical force: one
    combination of the lengths that lead to the left foot, along the legs and across the hips."""
    free = found.confounded
    assert len(free) == 5
    for number in (5, 13, 9, 16):
        own = np.eye(25)[number - 1]
        left = own - free.T @ np.linalg.lstsq(free.T, own, rcond=None)[0]
        assert np.linalg.norm(left) < 1e-6, number
    along = np.linalg.qr(free.T)[0]
    others = set(np.flatnonzero(np.abs(along).max(axis=1) > 0.02) + 1) - {5, 13, 9, 16}
    assert others == {10, 12, 15, 19, 20, 21, 23, 24, 25}
    error = found.full.value - run.laboratory.true_base_parameters(run.plan)
    assert np.abs(error - along @ (along.T @ error)).max() < 1e-3  # m
    assert np.abs(error).max() > 5e-4  # what the zeros hide
    assert "left_ankle.x (9) is not determined" in str(found)


def test_another_estimator_cannot_tell_zeros(run, robot):
    with pytest.raises(InputError, match=r"no foot in the air shows well.*self-calibrating"):
        identify(run.measurements, robot, estimator="least-squares")


def test_the_slopes_of_the_residuals_are_their_differences(run, robot):
    """As of the plates: with sensors in the feet, and with rows in the frame of the left foot."""
    m = run.measurements
    support = np.resize(["left", "right", "double"], len(m))
    mixed = dataclasses.replace(m, support=support)
    rng = np.random.default_rng(2)
    for one, kind in ((m, "double"), (mixed, "mixed")):
        nominal = nominal_robot(robot, kind)
        observed = observe(one, nominal)
        observed = observed.changed(plate_poses=0.01 * rng.standard_normal(observed.plate_poses.shape))
        slope, start = sensitivity(observed, nominal.value), packed(observed)
        used = np.ones((len(m), 11), bool)
        used[:, 5:] = (one.support == "double")[:, None]
        for k in range(start.shape[1]):
            step = np.zeros(start.shape[1])
            step[k] = 1e-5
            sides = [residuals(unpacked(observed, start + sign * step), nominal.value) for sign in (1, -1)]
            difference = (sides[0] - sides[1]) / 2e-5
            scale = 1e-6 + np.abs(difference).max()
            assert np.abs((slope[..., k] - difference) * used).max() < 2e-2 * scale, k


def test_a_wrench_by_hand():
    """A sensor 50 mm above the sole, turned by 90 deg: 10 N forward and 100 N up at 20 mm to the front."""
    force, place = np.array([10.0, 0, 100.0]), np.array([0.02, 0.01, 0.0])
    arm = place - [0.03, 0, 0.05]
    moment = np.cross(arm, force)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    reading = np.concatenate([turn.T @ force, turn.T @ moment])
    contacts = Contacts(
        mount="foot",
        channels=WRENCH,
        pose=np.tile([0.03, 0, -0.01, 0, 0, np.pi / 2], (2, 1)),
        covariance=np.diag([1.0, 1, 4, 0.01, 0.01, 0.01]),
        zero_sd=np.zeros((2, 6)),
        below=np.zeros((2, 4)),
        below_sd=np.zeros((2, 4)),
    )
    soles = np.tile([0.0, 0, -0.06], (2, 1))
    m = dataclasses.make_dataclass("M", ["contacts", "wrenches", "gravity", "support"])(
        contacts, np.tile(reading, (1, 2, 1)), 9.81, np.array(["double"])
    )
    found = of_wrenches(m, soles, np.tile([0.0, 0, 1], (1, 2, 1)), 200.0)
    values = found.values.reshape(2, 6)
    assert (values * found.bears).sum(axis=1) == pytest.approx([100, 100])
    np.testing.assert_allclose((values[..., None] * found.levers).sum(axis=1), [[2.0, 1.0]] * 2, atol=1e-12)


@pytest.mark.parametrize(("text", "value"), [("wrench-zero:right.my", 0.3), ("wrench-gain:left", 0.02)])
def test_an_effect_on_wrenches_is_undone(text, value, run, robot):
    name, _, target = text.partition(":")
    effect, m = catalogue()[name], run.measurements
    nominal = nominal_robot(robot)
    assert isinstance(effect.mechanism, Misreading)
    wrong = effect.mechanism.apply(m, robot, target, (value,))
    assert wrong.wrenches is not None
    assert m.wrenches is not None
    side = ("right", "left").index(target.partition(".")[0])
    by_hand = m.wrenches.copy()
    if name == "wrench-gain":
        by_hand[:, side] *= 1.02
    else:
        by_hand[:, side, 4] += 0.3
    np.testing.assert_allclose(wrong.wrenches, by_hand, atol=1e-12)
    again = effect.remove(observe(wrong, nominal), target, (value,))
    expected = residuals(observe(m, nominal), nominal.value)
    np.testing.assert_allclose(residuals(again, nominal.value), expected, atol=1e-9)


def test_what_lifts_the_robot_is_taken_off_the_feet_but_not_off_zeros(run, robot):
    """A force of 20 N is removed from the measurements: the sum of the forces changes by just that."""
    nominal = nominal_robot(robot)
    observed = observe(run.measurements, nominal)
    lifted = observed.changed(lift=np.full(len(observed), 20.0))
    again = observe(corrected(lifted), nominal)
    change = residuals(again, nominal.value)[:, 2] - residuals(observed, nominal.value)[:, 2]
    np.testing.assert_allclose(change, -20.0, atol=1e-9)


def test_wrong_signs_end_in_a_marked_table(robot):
    """Of unknown zeros the contract asks no weight: the estimate itself has to be looked at."""
    few = tt.plans.mixed.take(np.isin(tt.plans.mixed.placement, np.unique(tt.plans.mixed.placement)[::2]))
    measured: Any = tt.Laboratory(robot, sensors="foot-ft").run(few, seed=3, engine="statics").measurements
    upside_down = dataclasses.replace(measured, wrenches=-measured.wrenches)
    assert not identify(dataclasses.replace(upside_down, weighed_mass=None), robot).at_rest
    found = identify(upside_down, robot)
    assert not found.at_rest
    assert "did not come to rest" in str(found)
    assert not any(yes in (True, "yes") for yes in found.table().frame()["well identified"])


def test_an_estimate_longer_than_the_robot_is_refused(robot, run, found):
    estimate = dataclasses.replace(found.full, value=np.append(found.full.value[:-1], -1e16))
    with pytest.raises(InputError, match=r"found left_ankle.z = -1e19 mm, expected at most 2704 mm"):
        check_physical(estimate, found.mass, robot, "data")
    check_physical(found.full, found.mass, robot, "data")


def test_tables_speak_of_the_sensors_that_there_are(run, found, robot):
    """Of zeros each channel has its own unit, and there are no cells and no plates."""
    effect = catalogue()["wrench-zero"]
    assert [effect.parameters_on(f"left.{channel}")[0].text(2.0) for channel in ("fz", "mx")] == [
        "2 N",
        "2 Nm",
    ]
    instance = tt.Laboratory(robot, sensors="foot-ideal").with_effects("wrench-zero:left.my=0.5").hidden[0]
    assert "reads 0.5 Nm too much" in instance.finding
    text = str(found)
    assert "contact sensors, encoders: their noise; internal forces" in text
    assert "cells" not in text
    assert "right, left plate: errors" not in text
