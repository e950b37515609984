"""Measurements in a folder, by hand or by a program, and in memory: exact round trips, one contract."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import tulip_testbed as tt
from tests.contact_folders import EXAMPLE
from tests.documented import blocks
from tests.edited_rows import changed, put
from tests.test_refusals import change_document, refuse, rows
from tulip_testbed.base.files import sha256
from tulip_testbed.base.spreadsheet import plain_csv
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.check_folder import check_folder
from tulip_testbed.measurements import Measurements, SensorSheet, read_measurements, write_measurements
from tulip_testbed.measurements.contract import check_contract
from tulip_testbed.sim.outcome import Outcome


@pytest.fixture
def folder(wii, tmp_path):
    write_measurements(tmp_path / "data", wii.measurements)
    return tmp_path / "data"


def test_an_edited_twin_is_not_passed_over(folder):
    """Whoever edits the CSV must not get the Parquet's results, even if both hashes are right."""
    path = folder / "postures.csv"
    table = pyarrow.csv.read_csv(path)
    at, knee = table.column_names.index("q.right_knee"), table["q.right_knee"].to_numpy() + 0.1
    table = table.set_column(at, "q.right_knee", pa.array(knee))
    pyarrow.csv.write_csv(table, path)
    refuse("postures.csv: hash mismatch", read_measurements, folder)
    hashes = {one.name: sha256(one) for one in folder.glob("postures.*")}
    change_document(folder / "manifest.json", f"tables = {json.dumps(hashes)}")
    words = "postures.csv: next to postures.parquet: column 'q.right_knee', row 1: found"
    refuse(words, read_measurements, folder)


def test_measurements_print_as_a_line_and_have_a_frame_with_the_folders_columns(wii, folder):
    measured = wii.measurements
    for shown in (measured, wii.simulation, Outcome(measured, wii.simulation), wii.plan):
        assert len(repr(shown).splitlines()) == 1, repr(shown)
        assert len(repr(shown)) < 250
    assert repr(measured).startswith(f"Measurements: {len(measured)} rows, ")
    frame, knee = measured.to_frame(), measured.joints.index("right_knee")
    assert list(frame) == pyarrow.parquet.read_table(folder / "postures.parquet").column_names
    assert frame["q.right_knee"].tolist() == measured.joint_angles[:, knee].tolist()


@pytest.fixture(scope="module")
def measured(run):
    return run.measurements


@rows("contract")
def test_measurements_in_memory_are_held_against_the_contract(measured, changes, words):
    names = {"m": measured, "replace": dataclasses.replace, "changed": changed, "put": put}
    names |= {"np": np, "SensorSheet": SensorSheet}
    refuse(f"measurements: ... {words}", check_contract, eval(changes[0], names))


def test_what_identify_refuses_the_preflight_reads(measured, robot, tmp_path):
    wrong = changed(measured, posture=lambda v: np.arange(len(v)) % 5)
    write_measurements(tmp_path / "data", wrong, likely=False)
    for shown in (wrong, tmp_path / "data"):
        assert "repeats" in [c.name for c in tt.check(shown, robot).checks if c.result == "fail"]
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


def test_the_shipped_plan_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        tt.plans.random.joint_angles[0, 0] += 0.05


def test_the_preflight_lists_all_tolerances_that_are_wrong(folder, robot):
    unknown = 'tolerances = {"encoder-ofset": 0.001, "tilt": 50.0, "magic": 1.0}'
    change_document(folder / "manifest.json", unknown)
    told = " ".join(check_folder(folder, robot).to_json()["complaints"]["manifest"])
    for part in ("unknown family 'encoder-ofset'", "unknown family 'magic'", "tilt: found 50.0, expected"):
        assert part in told


PAGE = "docs/how-to/your-data.md"


@pytest.fixture
def mine(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "mine")
    return tmp_path / "mine"


def test_the_guide_shows_the_example_folder():
    assert blocks(PAGE, "json") == [(EXAMPLE / "manifest.json").read_text()]
    assert (EXAMPLE / "postures.csv").read_text().startswith(blocks(PAGE, "csv")[0])


def test_the_guide_lists_the_columns_that_may_be_left_out(mine):
    """The example lacks all of them but the time; without it, it still reads."""
    measured = read_measurements(mine)
    assert set(measured.support) == {"double"}
    assert np.isnan(measured.window).all()
    assert np.isnan(measured.cell_forces_sd).all()
    assert measured.motor is None
    assert measured.robot["sha256"] is None
    header, *rows = (mine / "postures.csv").read_text().splitlines()[2:]
    at = header.split(",").index("time")
    lines = [",".join(np.delete(line.split(","), at)) for line in (header, *rows)]
    (mine / "postures.csv").write_text("\n".join(lines))
    assert np.isnan(read_measurements(mine).time).all()
    assert main(["check", str(mine)]) == 0


def test_two_tables_without_hashes_are_refused(mine, tmp_path):
    write_measurements(tmp_path / "whole", read_measurements(mine))
    change_document(tmp_path / "whole" / "manifest.json", "tables -")
    refuse("found together with postures.csv and without a sha256", read_measurements, tmp_path / "whole")


PATH = Path("postures.csv")
NAMES = ["posture", "q.left_knee", "support"]
ROWS = [["1", "0.25", "double"], ["2", "-1.5e-3", "double"], ["3", "7", ""]]
PLAIN = "".join(",".join(row) + "\n" for row in (NAMES, *ROWS)).encode()


@given(
    separator=st.sampled_from([",", ";", "\t"]),
    comma=st.booleans(),
    spaces=st.integers(0, 3),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    mark=st.booleans(),
    quoted=st.booleans(),
    columns=st.integers(0, 2),
    between=st.lists(
        st.tuples(st.integers(0, 4), st.sampled_from(["", "   ", "# note; 1,5", '"# quoted, note",,'])),
        max_size=5,
    ),
    last=st.booleans(),
    top=st.sampled_from(["", "sep=", "SEP="]),
)
@settings(max_examples=200, deadline=None)
def test_every_spelling_means_the_same(
    separator, comma, spaces, end, mark, quoted, columns, between, last, top
):
    def value(text):
        text = text.replace(".", ",") if comma and separator != "," and text not in NAMES else text
        return " " * spaces + (f'"{text}"' if quoted else text) + " " * spaces

    lines = [separator.join([*map(value, row), *[""] * columns]) for row in (NAMES, *ROWS)]
    for at, extra in between:
        lines.insert(at, extra if extra.strip() else separator * (columns + 2))
    if top:
        lines.insert(0, top + separator)
    text = end.join(lines) + (end if last else "")
    assert plain_csv(PATH, (b"\xef\xbb\xbf" if mark else b"") + text.encode()) == PLAIN


def test_names_may_be_a_comment_as_numpy_writes_them():
    assert plain_csv(PATH, b"# recorded in May\n# " + PLAIN) == PLAIN


@rows("csv")
def test_what_could_mean_two_things_is_refused(changes, words):
    refuse(words, plain_csv, PATH, eval(changes[0], {"PLAIN": PLAIN}))


@example(b"\x00\r\x0b")  # a line of one vertical tab is empty
@example(b'";",a\n1,2\n')  # a name that separates
@example(b"\t#")  # so is a comment behind a tab
@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_bytes_are_read_or_refused(content):
    try:
        again = plain_csv(PATH, content)
    except tt.InputError:
        return
    assert plain_csv(PATH, again) == again
