"""Force-torque sensors in the feet: their readings as forces and levers, and what their zeros hide."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.effect_changes import agreement, changes, statically
from tulip_testbed.calibration.families import families_of, tolerances_of
from tulip_testbed.calibration.prediction import center_errors
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.catalogue import catalogue, targets_in
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.removal import corrected
from tulip_testbed.experiments.identify import check_physical, identify
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import ROWS, packed, residuals, sensitivity, unpacked
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig


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


FORCE, MOMENT = [10.0, 20.0, 100.0], [3.0, 4.0, 5.0]  # N, Nm
QUARTER = np.pi / 2
BY_HAND = {
    # the reading of the left sensor at 0, 1/2 and 1 of the time for the wrench above
    "wrench-gain:left=0.1": [[11, 22, 110, 3.3, 4.4, 5.5]] * 3,
    "wrench-zero:left.my=0.5": [[10, 20, 100, 3, 4.5, 5]] * 3,
    # my = 4 Nm + 0.01 m of 100 N; fx = 10 N + 2 / m of 3 Nm; fx = 10 N + 0.1 of 20 N
    "wrench-crosstalk:left.my.fz=0.01": [[10, 20, 100, 3, 5, 5]] * 3,
    "wrench-crosstalk:left.fx.mx=2": [[16, 20, 100, 3, 4, 5]] * 3,
    "wrench-crosstalk:left.fx.fy=0.1": [[12, 20, 100, 3, 4, 5]] * 3,
    # its x points along the stated y, its y along the stated -x
    f"wrench-rotation:left=0,0,{QUARTER}": [[20, -10, 100, 4, -3, 5]] * 3,
    # its y points along the stated z, its z along the stated -y
    f"wrench-rotation:left={QUARTER},0,0": [[10, 100, -20, 3, 5, -4]] * 3,
    # its z points along the stated x, its x along the stated -z
    f"wrench-rotation:left=0,{QUARTER},0": [[-100, 20, 10, -5, 4, 3]] * 3,
    # r x f = (0.02 * 100 - 0.03 * 20, 0.03 * 10 - 0.01 * 100, 0.01 * 20 - 0.02 * 10) = (1.4, -0.7, 0) Nm
    "wrench-origin:left=0.01,0.02,0.03": [[10, 20, 100, 1.6, 4.7, 5]] * 3,
    "wrench-drift:left.fz=4": [[10, 20, 100 + more, 3, 4, 5] for more in (0, 2, 4)],
    # 100 N at (-40, 30) mm of a plate, so (-0.2, 0.15) of 200 mm: 10 mm xx forward and 20 mm xy left are
    # 0.4 mm and -0.6 mm
    "plate-map:left=0.01,0,0,0,0.02,0": [[10, 20, 100, 2.94, 3.96, 5]] * 3,
}


def test_every_effect_on_wrenches_has_a_reading_worked_out_by_hand():
    names = {text.partition(":")[0] for text in BY_HAND} - {"plate-map"}  # which cells have too
    assert names == {name for name, one in catalogue().items() if one.misreads and name.startswith("wrench")}


@pytest.mark.parametrize("text", BY_HAND)
def test_a_sensor_misreads_by_definition_and_is_corrected(text, run, robot):
    found = tt.EffectInstance.parse(text.replace(str(QUARTER), "0.1"), robot)
    values = tuple(float(value) for value in text.partition("=")[2].split(","))
    if text.startswith("plate"):
        run = tt.Laboratory(robot, "plate-ft").run(run.plan, 3, "statics")
    rows, mechanism = run.measurements.take(np.arange(3)), found.effect.mechanism
    true = np.tile([*FORCE, *MOMENT], (3, 2, 1))
    m = dataclasses.replace(rows, wrenches=true, time=np.array([100.0, 200.0, 300.0]))
    assert isinstance(mechanism, Misreading)
    wrong: Any = mechanism.apply(m, robot, found.target, values)
    np.testing.assert_allclose(wrong.wrenches[:, 1], BY_HAND[text], atol=1e-12)
    np.testing.assert_array_equal(wrong.wrenches[:, 0], true[:, 0])
    nominal = nominal_robot(robot)
    again = found.effect.remove(observe(wrong, nominal), found.target, values)
    np.testing.assert_allclose(again.cell_forces, observe(m, nominal).cell_forces, atol=1e-9)


@pytest.mark.parametrize("text", ["wrench-drift:left.my=0.3", "wrench-drift:right.fz=10"])
def test_a_zero_taken_while_it_drifts_is_corrected(text, robot):
    """The foot in the air shows the mean drift there."""
    laboratory = tt.Laboratory(robot, sensors="foot-ideal")
    exact, drifting = (
        one.run(tt.plans.mixed, seed=3, engine="statics").measurements
        for one in (laboratory, laboratory.with_effects(text))
    )
    assert exact.contacts is not None
    assert np.isinf(exact.contacts.zero_sd).all()
    nominal, (found,) = nominal_robot(robot), laboratory.with_effects(text).hidden
    wrong, true = observe(drifting, nominal), observe(exact, nominal)
    assert np.abs(wrong.cell_forces - true.cell_forces).max() > 0.1 * found.values[0]
    again = found.effect.remove(wrong, found.target, found.values)
    carried = np.repeat(feet_in_contact(exact.support), 6, axis=1)
    np.testing.assert_allclose(again.cell_forces[carried], true.cell_forces[carried], atol=1e-6)


@pytest.mark.parametrize(("sensors", "count"), [("foot-ft", 60), ("sole-3axis", 18), ("plate-ft", 0)])
def test_cross_talk_is_sought_between_the_channels_that_there_are(sensors, count, robot):
    contacts = header_of(preset_rig(sensors, robot)).contacts
    targets = targets_in(catalogue()["wrench-crosstalk"], robot, contacts, ())
    assert len(targets) == count
    families = {f.name: f for f in families_of(robot, tolerances_of(tt.SensorSheet()), contacts=contacts)}
    assert "plate-map" not in families
    if targets:
        sizes = dict(zip(targets, families["wrench-crosstalk"].sizes.tolist(), strict=True))
        assert sizes["left.my.fz"] == pytest.approx(0.0003)  # m: 1 % of 0.03 m
        assert sizes["left.fz.mx"] == pytest.approx(1 / 3)  # 1/m
        assert sizes["left.mx.my"] == 0.01


@pytest.mark.parametrize("about_x", [0.0, 0.0005])
def test_a_foot_that_rocks_is_seen_by_the_sensor_in_it(about_x, robot):
    """Standing on the right foot alone, whose sole yields more in pitch than in roll or in pitch alone."""
    plan = tt.plans.mixed.take(tt.plans.mixed.support == "right")
    effect, values = catalogue()["foot-compliance"], (about_x, 0.001)
    rig = preset_rig("foot-ideal", robot)
    assert rig.sensors.wrench is not None
    tared = dataclasses.replace(
        rig.sensors, wrench=dataclasses.replace(rig.sensors.wrench, zero_sd=(0.0,) * 6)
    )
    rig = dataclasses.replace(rig, sensors=tared)
    base, rocks = statically(rig, plan), statically(effect.inject(rig, "right", values), plan)
    nominal = nominal_robot(robot, "right")
    simulated, predicted = changes(nominal, base, rocks, effect, "right", values, absorbed=False)
    assert np.abs(simulated[:, ROWS["A"]]).max() > 2.0  # mm
    cosine, slope = agreement(simulated[:, ROWS["A"]], predicted[:, ROWS["A"]])
    assert cosine > 0.9999
    assert slope == pytest.approx(1.0, abs=0.01)


def test_what_lifts_the_robot_is_taken_off_the_feet_but_not_off_zeros(run, robot):
    """A force of 20 N is removed from the measurements: the sum of the forces changes by just that."""
    nominal = nominal_robot(robot)
    observed = observe(run.measurements, nominal)
    lifted = observed.changed(lift=np.full(len(observed), 20.0))
    again = observe(corrected(lifted), nominal)
    change = residuals(again, nominal.value)[:, 2] - residuals(observed, nominal.value)[:, 2]
    np.testing.assert_allclose(change, -20.0, atol=1e-9)


@pytest.mark.slow
def test_wrong_signs_end_in_a_refusal_or_a_marked_table(robot):
    """Of unknown zeros the contract asks no weight: the estimate itself has to be looked at."""
    few = tt.plans.mixed.take(np.isin(tt.plans.mixed.placement, np.unique(tt.plans.mixed.placement)[::2]))
    measured: Any = tt.Laboratory(robot, sensors="foot-ft").run(few, seed=3, engine="statics").measurements
    upside_down = dataclasses.replace(measured, wrenches=-measured.wrenches)
    for weighed in (None, measured.weighed_mass):
        try:
            found: Any = identify(dataclasses.replace(upside_down, weighed_mass=weighed), robot)
        except tt.InputError as refusal:
            found = str(refusal)
        if isinstance(found, str):
            assert "found a total mass of -" in found
        else:
            assert not found.at_rest
            assert "did not come to rest" in str(found)
            assert not any(yes in (True, "yes") for yes in found.table().frame()["well identified"])


def test_an_estimate_longer_than_the_robot_is_refused(robot, run, found):
    estimate = dataclasses.replace(found.full, value=np.append(found.full.value[:-1], -1e16))
    with pytest.raises(tt.InputError, match=r"found left_ankle.z = -1e19 mm, expected at most 2704 mm"):
        check_physical(estimate, found.mass, robot, "data")
    check_physical(found.full, found.mass, robot, "data")


def on_right_foot():
    plan = tt.plans.mixed
    return plan.take(plan.support == "right")


def test_the_force_shows_a_foot_that_pitches(robot):
    """By hand: on a right foot that pitches by e (front down) the ground's force leans to the rear by e."""
    measured: Any = tt.Laboratory(robot, sensors="foot-ft").run(on_right_foot(), seed=3, engine="statics")
    m = measured.measurements
    tilt, wrenches = 0.01, m.wrenches.copy()
    wrenches[:, 0, 0] -= tilt * wrenches[:, 0, 2]  # fx
    nominal = nominal_robot(robot, "right")
    observed, leaning = (observe(dataclasses.replace(m, wrenches=w), nominal) for w in (m.wrenches, wrenches))
    change = residuals(leaning, nominal.value) - residuals(observed, nominal.value)
    np.testing.assert_allclose(change[:, 3], -tilt, rtol=0.03)  # fz has the sensor's gain and noise
    pitched = leaning.changed(stance_tilt=np.tile([0.0, tilt], (len(m), 1)))
    np.testing.assert_allclose(
        residuals(pitched, nominal.value)[:, 3:5],
        residuals(observed, nominal.value)[:, 3:5],
        atol=0.03 * tilt,
    )


@pytest.mark.parametrize("crosstalk", [(), ("wrench-crosstalk:right.fy.mx=8",)], ids=["own", "read by fy"])
def test_no_prediction_sees_the_moments_that_it_predicts(robot, crosstalk):
    """With a soft sole, an error of a centre of pressure is an error of the prediction.

    So it is where a force reads a part of the moment, which may tell of the moment, but must not be corrected
    by it.
    """
    effects = ("foot-compliance:right=0.0012,0.0012", *crosstalk)
    soft = tt.Laboratory(robot, sensors="foot-ft").with_effects(*effects)
    m: Any = soft.run(on_right_foot(), seed=4, engine="statics").measurements
    nominal = nominal_robot(robot, "right")
    found = self_calibrate(observe(m, nominal))
    shift = np.array([0.004, -0.003])
    wrenches = m.wrenches.copy()
    weight = nominal.mass * m.gravity
    wrenches[:, 0, 3] += shift[1] * weight  # mx = y W, my = -x W
    wrenches[:, 0, 4] -= shift[0] * weight
    before, after = (
        center_errors(found, observe(dataclasses.replace(m, wrenches=w), nominal))
        for w in (m.wrenches, wrenches)
    )
    np.testing.assert_allclose(after - before, np.tile(shift, (len(m), 1)), rtol=0.05)


def test_no_prediction_on_plates_sees_the_moments_that_it_predicts(robot):
    """The noise of a row is that at the predicted centre."""
    m: Any = tt.Laboratory(robot, sensors="wii").run(on_right_foot(), seed=4, engine="statics").measurements
    nominal = nominal_robot(robot, "right")
    found = self_calibrate(observe(m, nominal))
    corners, shift = m.cells.reshape(2, -1, 2)[0], np.array([0.004, -0.003])
    moved = m.cell_forces.copy().reshape(len(m), 2, 4)
    rows = np.vstack([corners.T, np.ones(4)])
    moved[:, 0] += np.linalg.lstsq(rows, np.append(shift, 0.0))[0] * moved[:, 0].sum(axis=1, keepdims=True)
    other = dataclasses.replace(m, cell_forces=moved.reshape(m.cell_forces.shape))
    before, after = (center_errors(found, observe(one, nominal)) for one in (m, other))
    size = np.linalg.norm(after - before, axis=1)  # plates are turned
    np.testing.assert_allclose(size, np.linalg.norm(shift), rtol=0.005)
