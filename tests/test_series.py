"""The raw series: read like the table, held against its averages, and looked at for settling."""

import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import sha256
from tulip_testbed.identification.preflight.settling import series_agrees, settling, steady_windows
from tulip_testbed.measurements import Series, read_measurements, read_series, write_measurements
from tulip_testbed.measurements.cells import CELLS

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


def write_series(folder, series, joints):
    names = [*(f"q.{joint}" for joint in joints), *(f"cell.{cell}" for cell in CELLS)]
    columns = {"posture": series.posture, "t": series.t}
    columns |= {name: series.readings[:, k] for k, name in enumerate(names)}
    pyarrow.parquet.write_table(pa.table(columns), folder / "series.parquet")


def test_series_is_read_whole_and_its_hash_is_checked(part, tmp_path):
    folder = tmp_path / "data"
    write_measurements(folder, part)
    assert read_series(folder) is None
    series = raw_series(part, np.random.default_rng(120))
    write_series(folder, series, part.joints)
    again = read_series(folder)
    assert again is not None
    assert np.array_equal(again.readings, series.readings)
    measured = read_measurements(folder)
    assert series_agrees(measured, again).result == "pass"
    manifest = json.loads((folder / "manifest.json").read_text())
    for listed, fails in ((sha256(folder / "series.parquet"), False), ("0" * 64, True)):
        manifest["tables"]["series.parquet"] = listed
        (folder / "manifest.json").write_text(json.dumps(manifest))
        if fails:
            with pytest.raises(InputError, match=r"series\.parquet: hash mismatch"):
                read_series(folder)
        else:
            read_series(folder)


def test_repeats_take_their_own_samples(part):
    series = raw_series(part, np.random.default_rng(122))
    again = np.flatnonzero(part.posture == part.posture[np.bincount(part.posture)[part.posture] > 1][0])
    means = [series.window(part, int(row)).mean(axis=0)[-8:] for row in again]
    assert means[0] == pytest.approx(part.cell_forces[again[0]], abs=1e-9)
    assert means[1] == pytest.approx(part.cell_forces[again[1]], abs=1e-9)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_steady_noise_is_no_settling(part, correlation):
    """Neither white nor correlated over half a second."""
    series = raw_series(part, np.random.default_rng(123), correlation)
    finding = settling(part, series)
    assert finding.result == "pass"
    assert series_agrees(part, series).result == "pass"


def test_settling_is_a_test_at_its_level_even_with_nothing_stated(part):
    """With nothing stated no change is harmless; few of many noise-only windows fall below 5 %."""
    unknown = dataclasses.replace(
        part, sensors=dataclasses.replace(part.sensors, encoder_sd=None, cell_sd=None)
    )
    p_values = [
        settling(unknown.take(np.array([row])), raw_series(unknown.take(np.array([row])), rng)).p_value
        for rng in np.random.default_rng(124).spawn(4)
        for row in range(len(part))
    ]
    assert np.mean(np.array(p_values) < 0.05) < 0.12


def test_a_window_that_still_moves_is_found(part):
    series = raw_series(part, np.random.default_rng(125))
    row, channel = 5, len(part.joints) + 2
    readings = series.readings.copy()
    readings[row * SAMPLES : (row + 1) * SAMPLES, channel] += np.linspace(-8, 8, SAMPLES)
    finding = settling(part, dataclasses.replace(series, readings=readings))
    assert finding.result == "fail"
    assert f"posture {part.posture[row]} (row {row + 1}" in finding.where
    assert "cell.right.rear_right by +8" in finding.seen


def test_a_series_of_something_else_is_found(part):
    series = raw_series(part, np.random.default_rng(126))
    readings = series.readings.copy()
    readings[:SAMPLES, 3] += 0.01
    finding = series_agrees(part, dataclasses.replace(series, readings=readings))
    assert finding.result == "fail"
    assert "q.right_knee" in finding.where
    lost = Series(series.posture[SAMPLES:], series.t[SAMPLES:], series.readings[SAMPLES:])
    assert series_agrees(part, lost).result == "warn"
    assert settling(part, Series(series.posture + 1000, series.t, readings)).result == "not evaluated"


def test_without_a_series_the_spread_within_windows_stands_in(part):
    assert steady_windows(part).result == "pass"
    spread = part.cell_forces_sd.copy()
    for most, result in ((2.5, "warn"), (6.0, "fail")):
        spread[4, 1] = most * part.cell_forces_sd[4, 1]
        finding = steady_windows(dataclasses.replace(part, cell_forces_sd=spread))
        assert finding.result == result
        assert "cell.right.front_right" in finding.seen
    spread[:, 1] = 0.0
    finding = steady_windows(dataclasses.replace(part, cell_forces_sd=spread))
    assert finding.result == "warn"
    assert "s.d. exactly 0: cell.right.front_right" in finding.seen
