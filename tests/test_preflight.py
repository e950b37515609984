"""The figures behind the preflight and the raw series, against MuJoCo, drawing and textbook algebra."""

import dataclasses
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tulip_testbed as tt
from tests.edited_rows import changed, plus, within
from tests.test_refusals import refuse
from tulip_testbed.base.files import sha256
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.estimators import least_squares
from tulip_testbed.identification.noise_structure import Groups, groups
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.preflight.agreement import fit, shifts
from tulip_testbed.identification.preflight.excitation import predicted_standard_errors
from tulip_testbed.identification.preflight.readings import longest_run
from tulip_testbed.identification.preflight.settling import series_agrees, settling
from tulip_testbed.identification.reading_noise import ReadingNoise, reading_noise
from tulip_testbed.identification.regressor import regression, stacked_regressor
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import SensorSheet, Series, read_measurements, read_series, write_measurements
from tulip_testbed.measurements.cells import CELLS


def test_stated_noise_is_what_drawing_it_gives(wii, nominal):
    """Covariance of CoP minus CoM of one posture, cells and encoders drawn 4000 times."""
    measured = wii.measurements
    rng, count = np.random.default_rng(112), 4000
    one = measured.take(np.full(count, 50))
    drawn = dataclasses.replace(
        one,
        cell_forces=one.cell_forces + measured.sensors.cell_sd * rng.standard_normal((count, 8)),
        joint_angles=one.joint_angles + measured.sensors.encoder_sd * rng.standard_normal((count, 12)),
    )
    error = center_of_pressure(drawn) - nominal.center_of_mass(drawn.joint_angles)
    stated = reading_noise(measured.take(np.array([50])), nominal).own[0]
    assert np.cov(error.T) == pytest.approx(stated, rel=0.1, abs=0.05 * stated.max())


def dense_covariance(noise: ReadingNoise) -> np.ndarray:
    """Of all residuals, posture by posture, element by element."""
    m = len(noise.own)
    full = np.zeros((m, 2, m, 2))
    for i in range(m):
        full[i, :, i] += noise.own[i]
        for j in range(m):
            if noise.placement[i] == noise.placement[j]:
                full[i, :, j] += noise.shared[i] @ noise.shared[j].T
    return full.reshape(2 * m, 2 * m)


def test_a_shift_is_the_added_column_of_generalised_least_squares(wii, nominal):
    """Against the textbook: theta and shift together by the normal equations."""
    measured = wii.measurements
    noise = reading_noise(measured, nominal)
    data = regression(nominal.parameters, measured, nominal.robot)
    best: Any = fit(measured, data, noise)
    weight = np.linalg.inv(dense_covariance(noise))
    # One posture alone; all of a placement, in directions that differ from posture to posture.
    inside = np.flatnonzero(measured.placement == measured.placement[40])
    one, several = np.zeros((2, len(measured), 2, 2))
    one[40] = np.eye(2)
    several[inside] = (1 + np.arange(len(inside)))[:, None, None] * np.eye(2)
    directions = np.tile(np.eye(2), (len(measured), 1, 1))
    singly = shifts(best, directions, Groups(np.arange(len(measured))))
    together = shifts(best, several, groups(measured.placement))
    number = groups(measured.placement).number[40]
    for direction, (p_value, size, error), at in ((one, singly, 40), (several, together, number)):
        both = np.hstack([data.matrix, direction.reshape(-1, 2)])
        normal = both.T @ weight @ both
        solved = np.linalg.solve(normal, both.T @ weight @ data.output)
        assert size[at] == pytest.approx(solved[-2:], rel=1e-6)
        scale = error[at] / np.sqrt(np.diag(np.linalg.inv(normal))[-2:])
        assert scale == pytest.approx([max(1.0, scale[0])] * 2)
        assert 0 < p_value[at] < 1
    chi_square = best.square
    residual = data.output - data.matrix @ np.linalg.solve(
        data.matrix.T @ weight @ data.matrix, data.matrix.T @ weight @ data.output
    )
    assert chi_square == pytest.approx(residual @ weight @ residual, rel=1e-6)
    assert noise.variance.ravel() == pytest.approx(np.diag(dense_covariance(noise)))


def test_predicted_standard_errors_are_those_of_the_estimate(wii, precise, nominal):
    """Within what an estimate from 30 placements scatters by; at wii the right plate is taken as no better
    than the left, which errs towards too much."""
    for measured in (wii.measurements, precise):
        data = regression(nominal.parameters, measured, nominal.robot)
        matrix = stacked_regressor(nominal.parameters, measured.joint_angles)
        predicted = predicted_standard_errors(matrix, reading_noise(measured, nominal))
        ratio = predicted / standard_errors(least_squares(data).clustered_covariance)
        assert 0.8 < np.median(ratio) < 1.3
        assert (ratio > 0.6).all()
        assert (ratio < 1.8).all()


def test_a_run_is_as_improbable_as_it_says():
    """Over shuffled orders, a chance below p comes in at most a share p."""
    rng = np.random.default_rng(114)
    values = rng.integers(4, size=40).astype(float)
    chances = []
    for _ in range(2000):
        rng.shuffle(values)
        chances.append(longest_run(values, np.ones(39, dtype=bool))[1])
    for level in (0.01, 0.05, 0.2):
        assert np.mean(np.array(chances) <= level) <= 1.2 * level + 0.002


@given(
    count=st.integers(1, 30),
    scale=st.sampled_from([0.01, 1.0]),  # small enough to pass the check of units, or anything
    angle=st.floats(-3, 3),
    force=st.floats(-300, 300),
    pose=st.floats(-1, 1),
    sd=st.sampled_from([None, 0.0, 1e-4, 1.0]),
    flat=st.booleans(),
    alike=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_no_folder_that_can_be_read_breaks_the_preflight(
    precise, nominal, count, scale, angle, force, pose, sd, flat, alike
):
    part = precise.take(np.zeros(count, dtype=int) if alike else np.arange(count))
    rest = 1e-9 if flat else 1.0
    odd = dataclasses.replace(
        part,
        joint_angles=rest * part.joint_angles + scale * angle,
        cell_forces=part.cell_forces * [rest, 1, 1, 1, 1, 1, 1, 1] + scale * force,
        plate_poses=part.plate_poses + scale * pose,
        sensors=SensorSheet(sd, sd, sd, sd, None if sd is None else (sd, sd, sd)),
    )
    assert len(preflight(odd, nominal)) == 23


SAMPLES = 600  # of a window of 30 s


def raw_series(measured, rng, correlation=0.0):
    """White or first-order correlated noise about the table's averages."""
    m, size = measured, len(measured.joints) + len(CELLS)
    scale = np.concatenate([np.full(len(m.joints), 2e-4), np.full(len(CELLS), 1.5)])
    readings, t = [], []
    for row in range(len(m)):
        noise = rng.standard_normal((SAMPLES, size))
        for k in range(1, SAMPLES):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1 - correlation**2) * noise[k]
        noise -= noise.mean(axis=0)
        readings.append(np.concatenate([m.joint_angles[row], m.cell_forces[row]]) + scale * noise)
        t.append(m.time[row] + np.linspace(0, m.window[row], SAMPLES))
    return Series(np.repeat(m.posture, SAMPLES), np.concatenate(t), np.vstack(readings))


@pytest.fixture(scope="module")
def part(wii):
    """Two placements with repeats among them."""
    return wii.measurements.take(wii.measurements.placement <= 3)


def test_series_is_read_whole_and_its_hash_is_checked(part, tmp_path):
    folder = tmp_path / "data"
    write_measurements(folder, part)
    assert read_series(folder) is None
    series = raw_series(part, np.random.default_rng(120))
    columns = {"posture": series.posture, "t": series.t}
    names = [*(f"q.{joint}" for joint in part.joints), *(f"cell.{cell}" for cell in CELLS)]
    columns |= dict(zip(names, series.readings.T, strict=True))
    pyarrow.parquet.write_table(pa.table(columns), folder / "series.parquet")
    again: Any = read_series(folder)
    assert np.array_equal(again.readings, series.readings)
    measured = read_measurements(folder)
    assert series_agrees(measured, again).result == "pass"
    manifest = json.loads((folder / "manifest.json").read_text())
    for listed, fails in ((sha256(folder / "series.parquet"), False), ("0" * 64, True)):
        manifest["tables"]["series.parquet"] = listed
        (folder / "manifest.json").write_text(json.dumps(manifest))
        if fails:
            refuse("series.parquet: hash mismatch", read_series, folder)
        else:
            read_series(folder)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_steady_noise_is_no_settling(part, correlation):
    """Neither white nor correlated over half a second."""
    series = raw_series(part, np.random.default_rng(123), correlation)
    finding = settling(part, series)
    assert finding.result == "pass"
    assert series_agrees(part, series).result == "pass"


def test_settling_is_a_test_at_its_level_even_with_nothing_stated(part):
    """With nothing stated no change is harmless; few of many noise-only windows fall below 5 %."""
    unknown = within("sensors", part, encoder_sd=None, cell_sd=None)
    p_values = [
        settling(unknown.take(np.array([row])), raw_series(unknown.take(np.array([row])), rng)).p_value
        for rng in np.random.default_rng(124).spawn(4)
        for row in range(len(part))
    ]
    assert np.mean(np.array(p_values) < 0.05) < 0.12


def test_a_window_that_still_moves_is_found(part):
    series = raw_series(part, np.random.default_rng(125))
    row, channel = 5, len(part.joints) + 2
    drift = plus(np.linspace(-8, 8, SAMPLES), slice(row * SAMPLES, (row + 1) * SAMPLES), channel)
    finding = settling(part, changed(series, readings=drift))
    assert finding.result == "fail"
    assert f"posture {part.posture[row]} (row {row + 1}" in finding.where
    assert "cell.right.rear_right by +8" in finding.seen


def test_a_series_of_something_else_is_found(part):
    series = raw_series(part, np.random.default_rng(126))
    wrong = changed(series, readings=plus(0.01, slice(SAMPLES), 3))
    finding = series_agrees(part, wrong)
    assert finding.result == "fail"
    assert "q.right_knee" in finding.where
    lost = Series(series.posture[SAMPLES:], series.t[SAMPLES:], series.readings[SAMPLES:])
    assert series_agrees(part, lost).result == "warn"
    assert settling(part, dataclasses.replace(wrong, posture=series.posture + 1000)).result == "not evaluated"


@pytest.mark.parametrize("sensors", ["wii", "force-plate"])
@pytest.mark.parametrize("effect", [None, "cell-crosstalk=0.1", "sole-compliance=0.004", "tilt=0.08,0.08"])
def test_no_other_fault_is_taken_for_a_wrong_wiring(sensors, effect, robot):
    laboratory = tt.Laboratory(robot, sensors=sensors).with_effects(*[effect] if effect else [])
    m = laboratory.run(tt.plans.random, seed=4, engine="statics").measurements
    (found,) = [one for one in preflight(m, nominal_robot(robot)) if one.name == "wiring of cells"]
    assert found.result == "pass"
