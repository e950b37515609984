"""Ordinary imperfections and sizes of effects, by dense algebra and against their priors."""

import dataclasses
import tracemalloc
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm

from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.calibration.usual_changes import usual_changes
from tulip_testbed.effects.instance import instances_of
from tulip_testbed.experiments.check_folder import check_measurements
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.imperfections import ordinary_members
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.preflight.usual import beyond
from tulip_testbed.sim.rig import preset_rig

WINDOW = 0.5  # s, of a row of a robot that moves


def results(measured, robot):
    return {one.name: one.result for one in check_measurements(measured, robot).checks}


@pytest.mark.parametrize(("preset", "seed"), [("wii", 903), ("force-plate", 901)])
def test_an_ordinary_laboratory_passes(robot, plan, preset, seed):
    rig = preset_rig(preset, robot)
    hidden = ordinary_members(rig, np.random.default_rng(seed))
    plain = Laboratory(robot, preset, hidden=hidden).run(plan, seed, "statics", workers=1)
    found = results(plain.measurements, robot)
    assert found["legs close"] == found["weight balance"] == "pass"

    errors = f"encoder-offset:right_knee={np.radians(1.0)}", "cell-gain:left.rear_left=0.3"
    gross_too = Laboratory(robot, preset, hidden=hidden).with_effects(*errors)
    worse = gross_too.run(plan, seed, "statics", workers=1)
    found = results(worse.measurements, robot)
    assert found["legs close"] == found["weight balance"] == "fail"


def test_a_moving_record_of_one_placement_takes_memory_by_its_rows(robot, plan, nominal):
    held = Laboratory(robot, "wii").run(plan, 907, "statics", workers=1).measurements
    peaks = []
    for count in (150, 300):
        row = np.resize(np.arange(len(held)), count)
        still = np.zeros((count, len(held.joints)))
        once = dataclasses.replace(
            held.take(row),
            joint_rates=still,
            joint_accelerations=still,
            window=np.full(count, WINDOW),
            time=WINDOW * np.arange(count),
            placement=np.ones(count, int),
        )
        tracemalloc.start()
        usual_changes(once, nominal)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 2.5 * peaks[0]


def test_an_imperfection_of_almost_four_tolerances_is_a_warning_that_names_it(robot, plan):
    hidden = Laboratory(robot, "force-plate").with_effects("encoder-offset:right_ankle_roll=0.01")
    run = hidden.run(plan, 3, "statics", workers=1)
    (legs,) = [
        one
        for one in check_measurements(run.measurements, robot).to_json()["checks"]
        if one["name"] == "legs close"
    ]
    assert legs["result"] == "warn"
    assert "encoder-offset:right_ankle_roll, 3.9 s.d. of what is usual" in legs["seen"]


def test_a_tolerance_of_zero_allows_nothing(robot, plan, nominal):
    """Offsets of usual size fail where the manifest says that the encoders are exact."""
    hidden = (f"encoder-offset:{joint}=0.003" for joint in ("right_knee", "left_ankle_roll"))
    run = Laboratory(robot, "force-plate").with_effects(*hidden).run(plan, 5, "statics", workers=1)
    tolerances = dict.fromkeys(("encoder-offset", "encoder-gain", "link-length", "joint-compliance"), 0.0)
    assert results(run.measurements, robot)["legs close"] == "pass"
    exact = dataclasses.replace(run.measurements, tolerances=tolerances)
    assert results(exact, robot)["legs close"] == "fail"
    count = usual_changes(run.measurements, nominal).closure.shape[2]
    assert usual_changes(exact, nominal).closure.shape[2] < count


def test_the_three_tests_by_dense_algebra():
    rng = np.random.default_rng(903)
    m, r, k = 12, 3, 4
    changes, white = rng.normal(size=(m, r, k)), 2.0 * rng.normal(size=(m, r))
    directions = rng.normal(size=(m, r, 2))
    flat, error = changes.reshape(m * r, k), white.ravel()
    inverse = np.linalg.inv(np.eye(m * r) + flat @ flat.T)
    outside = np.linalg.qr(flat, mode="complete")[0][:, k:]
    left = chi2.sf(((outside.T @ error) ** 2).sum(), m * r - k)
    rows = []
    for j in range(m):
        pick = np.zeros((m * r, r))
        pick[r * j : r * (j + 1)] = np.eye(r)
        information = pick.T @ inverse @ pick
        shift = np.linalg.solve(information, pick.T @ inverse @ error)
        rows.append(chi2.sf(shift @ information @ shift, r))

    def sizes(columns):
        return [abs(d @ inverse @ error) / np.sqrt(d @ inverse @ d) for d in columns.T]

    members, others = sizes(flat), sizes(directions.reshape(m * r, 2))
    each = [left, m * min(rows), 2 * 2 * norm.sf(max(others)), k * 2 * norm.sf(max(members))]
    found = beyond(white, np.full(m, r), changes, "abcd", directions)
    assert found.p_value == pytest.approx(min(1.0, 4 * min(each)), rel=1e-9)
    assert found.name == "abcd"[int(np.argmax(members))]
    assert found.sizes == pytest.approx(max(members), rel=1e-9)


def test_its_probability_is_one_of_noise_and_ordinary_imperfections():
    """Deviations as assumed: a small p is no more frequent than it says, nor much rarer."""
    rng = np.random.default_rng(904)
    changes = 3.0 * rng.normal(size=(20, 1, 5))
    drawn = [
        beyond(rng.normal(size=(20, 1)) + changes @ rng.normal(size=5), np.ones(20, int), changes, "abcde")
        for _ in range(2000)
    ]
    drawn = [one.p_value for one in drawn]
    share = np.mean(np.array(drawn) < 0.05)  # Bonferroni of three, hardly dependent: 0.049
    assert 0.035 < share < 0.06  # s.d. 0.005
    assert kstest(drawn, "uniform", alternative="greater").statistic < 0.05


TRUE = 130.0  # N/m, more than six times what is plausible
SPRING = f"tether-spring={TRUE}"


@pytest.fixture(scope="module")
def held_back(robot, plan):
    laboratory = Laboratory(robot, "wii").with_effects(SPRING)
    return laboratory.run(plan, 11, "statics")


@pytest.fixture(scope="module")
def joint(held_back, robot, nominal):
    """Base parameters, families and the spring in one estimate, from a spring of a plausible size on."""
    start = instances_of("tether-spring=20", robot)
    return self_calibrate(observe(held_back.measurements, nominal), None, start)


def test_a_size_far_beyond_what_is_plausible_is_not_drawn_to_zero(joint):
    (spring,), ((error,),) = joint.effects, joint.effect_errors
    assert error > 0.4 * 20  # so that a normal prior would draw it
    assert abs(spring.values[0] - TRUE) < 3 * error


@pytest.mark.slow
def test_the_uncertainty_of_a_correction_is_that_of_the_joint_estimate(held_back, joint, robot, plan):
    known: Any = identify(held_back.measurements, robot, adopted=joint.effects).calibration
    exact = [dataclasses.replace(one, intervals=()) for one in joint.effects]
    taken: Any = identify(held_back.measurements, robot, adopted=exact).calibration
    errors = [np.sqrt(np.diag(one.covariance)) for one in (joint, known, taken)]
    assert errors[1] == pytest.approx(errors[0], rel=0.15)
    assert (errors[2] < 0.5 * errors[0]).any()
    off = (known.theta - held_back.laboratory.true_base_parameters(plan)) / errors[1]
    assert np.sqrt((off**2).mean()) < 1.7
    assert known.sources[-1] == "corrections"
    assert known.shares.sum(axis=0) == pytest.approx(np.ones(len(known.theta)))
