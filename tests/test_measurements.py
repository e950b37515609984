"""The measurement folder: exact round trips, tables in two formats, and what a reader is told."""

import dataclasses
import json
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from tests.contact_folders import assert_same
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import sha256
from tulip_testbed.measurements import read_measurements, write_measurements
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.plan_folder import read_plan, write_plan


@pytest.fixture
def folder(wii, tmp_path):
    write_measurements(tmp_path / "data", wii.measurements)
    return tmp_path / "data"


def edit_manifest(folder, change):
    path = next(p for p in (folder / "manifest.json", folder / "plan.json") if p.exists())
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def keep_alone(folder, name):
    """Leave one table and list its hash."""
    for path in folder.glob("postures.*"):
        if path.name != name:
            path.unlink()
    edit_manifest(folder, lambda m: m.update(tables={name: sha256(folder / name)}))


def rewrite(folder, change):
    """Change the Parquet table and keep the manifest's hash honest; the CSV goes."""
    path = folder / "postures.parquet"
    pyarrow.parquet.write_table(change(pyarrow.parquet.read_table(path)), path)
    keep_alone(folder, path.name)


def replace_column(table, name, values):
    return table.set_column(table.column_names.index(name), name, pa.array(values))


def refusal(folder):
    with pytest.raises(InputError) as error:
        read_measurements(folder)
    return str(error.value).replace(str(folder), "DATA")


def test_round_trip_is_exact(wii, folder):
    assert_same(wii.measurements, read_measurements(folder))


def test_rates_and_accelerations_of_a_moving_robot_are_read_back(wii, tmp_path):
    angles = wii.measurements.joint_angles
    moving = dataclasses.replace(wii.measurements, joint_rates=0.1 * angles, joint_accelerations=-angles)
    write_measurements(tmp_path / "moving", moving)
    assert_same(read_measurements(tmp_path / "moving"), moving)


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n"])
def test_csv_alone_says_the_same_with_any_line_end(wii, folder, end):
    path = folder / "postures.csv"
    path.write_bytes(path.read_bytes().replace(b"\n", end.encode()))
    keep_alone(folder, path.name)
    assert_same(wii.measurements, read_measurements(folder))


def test_an_edited_twin_is_not_passed_over(folder):
    """Whoever edits the CSV must not get the Parquet's results, even if both hashes are right."""
    path = folder / "postures.csv"
    table = pyarrow.csv.read_csv(path)
    table = replace_column(table, "q.right_knee", table["q.right_knee"].to_numpy() + 0.1)
    pyarrow.csv.write_csv(table, path)
    assert "postures.csv: hash mismatch" in refusal(folder)
    edit_manifest(folder, lambda m: m["tables"].update({path.name: sha256(path)}))
    assert "postures.csv: next to postures.parquet: column 'q.right_knee', row 1: found" in refusal(folder)


def test_plan_round_trip_and_limits(plan, robot, tmp_path):
    write_plan(tmp_path / "plan", plan)
    assert read_plan(tmp_path / "plan", robot).joint_angles.tobytes() == plan.joint_angles.tobytes()
    rewrite(tmp_path / "plan", lambda t: replace_column(t, "q.left_knee", [-0.2] * len(t)))
    message = r"column 'q.left_knee', row 1: found -0.2 rad, expected within \[0.0000"
    with pytest.raises(InputError, match=message):
        read_plan(tmp_path / "plan", robot)


def test_an_incomplete_folder_names_its_tables_and_what_lists_the_rest(folder):
    edit_manifest(folder, lambda m: m.update(tables=None))
    (folder / "postures.parquet").unlink()
    path = folder / "postures.csv"
    text = path.read_text().replace("q.right_knee", "q.rightknee", 1).replace('"posture"', '"no"', 1)
    path.write_text(text)
    assert "columns 'posture', 'q.right_knee' are missing (found 'q.rightknee'); `" in refusal(folder)
    path.rename(folder / "wednesday.csv")
    advice = "lists all that is missing or wrong"
    said = refusal(folder)
    assert "nor postures.csv, expected one of them; found wednesday.csv; `" in said
    assert said.endswith(advice)
    (folder / "manifest.json").unlink()
    said = refusal(folder)
    assert said.startswith("DATA/manifest.json: missing; found wednesday.csv; `")
    assert said.endswith(advice)
    assert "and the table as postures.csv; `" in refusal(folder / "wednesday.csv")


def test_measurements_print_as_a_line_and_have_a_frame_with_the_folders_columns(wii, folder):
    measured = wii.measurements
    for shown in (measured, wii.simulation, Outcome(measured, wii.simulation), wii.plan):
        assert len(repr(shown).splitlines()) == 1, repr(shown)
        assert len(repr(shown)) < 250
    assert repr(measured).startswith(f"Measurements: {len(measured)} rows, ")
    frame, knee = measured.to_frame(), measured.joints.index("right_knee")
    assert list(frame) == pyarrow.parquet.read_table(folder / "postures.parquet").column_names
    assert frame["q.right_knee"].tolist() == measured.joint_angles[:, knee].tolist()


@pytest.mark.parametrize(
    ("key", "values"),
    [("gains", {"right_knee": 5000.0}), ("tolerances", {"encoder-offset": 0.001, "link-length": 0.0})],
)
def test_gains_and_tolerances_are_read_and_written_back(folder, tmp_path, key, values):
    assert "tolerances" not in json.loads((folder / "manifest.json").read_text())
    edit_manifest(folder, lambda m: m.update({key: values}))
    measured = read_measurements(folder)
    assert getattr(measured, key) == values
    write_measurements(tmp_path / "again", measured)
    assert_same(measured, read_measurements(tmp_path / "again"))
    edit_manifest(folder, lambda m: m.update({key: None}))
    assert getattr(read_measurements(folder), key) == {}
    wrong: Any = {key: {next(iter(values)): float("nan")}}
    broken = dataclasses.replace(measured, **wrong)
    with pytest.raises(InputError, match=rf"measurements: key '{key}\..*': found nan"):
        write_measurements(tmp_path / "broken", broken)
