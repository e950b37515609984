"""The contract holds measurements in memory as it holds a folder."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tulip_testbed as tt
from tests.test_refusals import refuse, rows
from tulip_testbed.measurements import Measurements, SensorSheet, read_measurements, write_measurements
from tulip_testbed.measurements.contract import check_contract


@pytest.fixture(scope="module")
def measured(run):
    return run.measurements


def changed(m, **fields):
    """Replace fields by what functions make of them."""
    return dataclasses.replace(m, **{name: make(getattr(m, name).copy()) for name, make in fields.items()})


def put(*place, value):
    def make(values):
        values[place] = value
        return values

    return make


def taken(m, chosen):
    """Take rows, by indices."""
    fields = {field.name: getattr(m, field.name) for field in dataclasses.fields(m)}
    of_rows = {n: v for n, v in fields.items() if isinstance(v, np.ndarray) and len(v) == len(m)}
    return dataclasses.replace(m, **{name: value[chosen] for name, value in of_rows.items()})


@rows("contract")
def test_measurements_in_memory_are_held_against_the_contract(measured, changes, words):
    names = {"m": measured, "replace": dataclasses.replace, "changed": changed, "put": put, "taken": taken}
    names |= {"np": np, "SensorSheet": SensorSheet}
    refuse(f"measurements: ... {words}", check_contract, eval(changes[0], names))


def test_every_door_holds_measurements_against_the_contract(measured, robot, tmp_path):
    wrong = changed(measured, joint_angles=np.rad2deg)
    for call in (
        lambda: tt.identify(wrong, robot),
        lambda: tt.discover(wrong, robot),
        lambda: tt.write_measurements(tmp_path / "data", wrong),
        lambda: tt.optimize_plan(robot, after=wrong),
        lambda: tt.view(wrong, robot, save=tmp_path / "view.rrd"),
    ):
        with pytest.raises(tt.InputError, match=r"^measurements: column 'q\."):
            call()
    assert list(tmp_path.iterdir()) == []


def test_the_preflight_reads_on_to_say_which_unit_was_meant(measured, robot):
    degrees = changed(measured, joint_angles=np.rad2deg)
    (units,) = [c for c in tt.check(degrees, robot).to_json()["checks"] if c["name"] == "units"]
    assert units["result"] == "fail"
    assert "degrees?" in units["seen"]
    with pytest.raises(tt.InputError, match="found nan, expected a finite number"):
        tt.check(changed(measured, joint_angles=put(0, 0, value=np.nan)), robot)


@pytest.mark.parametrize(
    ("changes", "check"),
    [
        (lambda m: changed(m, posture=lambda v: np.arange(len(v)) % 5), "repeats"),
        (lambda m: dataclasses.replace(m, sensors=SensorSheet(cell_sd=1e5)), "units"),
    ],
)
def test_what_identify_refuses_the_preflight_explains(measured, robot, tmp_path, changes, check):
    wrong = changes(measured)
    write_measurements(tmp_path / "data", wrong, likely=False)
    for given in (wrong, tmp_path / "data"):
        failed = [c.name for c in tt.check(given, robot).checks if c.result == "fail"]
        assert check in failed
    with pytest.raises(tt.InputError):
        read_measurements(tmp_path / "data")


def test_measurements_are_made_from_arrays_in_memory(measured, robot):
    m = measured
    names = ("placement", "joint_angles", "cell_forces", "plate_poses")
    rows = {name: getattr(m, name).tolist() for name in names}
    made = Measurements.from_arrays(m.header, posture=m.posture, time=m.time, **rows)
    assert made.header.stated.keys() == m.header.stated.keys()
    assert np.array_equal(made.support, m.support)
    assert np.isnan(made.joint_angles_sd).all()
    assert made.command is None
    assert np.array_equal(tt.identify(made, robot).full.value, tt.identify(m, robot).full.value)
    for wrong, message in (
        ({"joint_angels": 0}, "unknown field 'joint_angels'; did you mean 'joint_angles'"),
        ({"cell_forces": None}, "found no cell_forces, expected values of every row"),
        ({"placement": [1, 2]}, r"placement: found int64 \(2,\), expected an array of whole num"),
        ({"plate_poses": [[1], [1, 2]]}, "found no array of numbers"),
    ):
        with pytest.raises(tt.InputError, match=f"^measurements: {message}"):
            Measurements.from_arrays(m.header, **(rows | wrong))


def test_the_shipped_plan_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        tt.plans.random.joint_angles[0, 0] += 0.05
