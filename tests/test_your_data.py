"""Hand-written folders and spreadsheets: the guide does what it says, CSV of any spelling is read."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.documented import blocks
from tests.test_measurements import edit_manifest
from tests.test_refusals import refuse, rows
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.spreadsheet import plain_csv
from tulip_testbed.cli.main import main
from tulip_testbed.measurements import read_measurements, write_measurements

ROOT = Path(__file__).parent.parent
PAGE = "docs/how-to/your-data.md"
EXAMPLE = ROOT / "docs" / "how-to" / "your-data"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "mine")
    return tmp_path / "mine"


def test_the_guide_shows_the_example_folder():
    assert blocks(PAGE, "json") == [(EXAMPLE / "manifest.json").read_text()]
    assert (EXAMPLE / "postures.csv").read_text().startswith(blocks(PAGE, "csv")[0])


def test_the_guide_lists_the_columns_that_may_be_left_out(folder):
    """The example lacks all of them but the time; without it, it still reads."""
    measured = read_measurements(folder)
    assert set(measured.support) == {"double"}
    assert np.isnan(measured.window).all()
    assert np.isnan(measured.cell_forces_sd).all()
    assert measured.motor is None
    assert measured.robot["sha256"] is None
    header, *rows = (folder / "postures.csv").read_text().splitlines()[2:]
    at = header.split(",").index("time")
    lines = [",".join(np.delete(line.split(","), at)) for line in (header, *rows)]
    (folder / "postures.csv").write_text("\n".join(lines))
    assert np.isnan(read_measurements(folder).time).all()
    assert main(["check", str(folder)]) == 0


def test_two_tables_without_hashes_are_refused(folder, tmp_path):
    write_measurements(tmp_path / "whole", read_measurements(folder))
    edit_manifest(tmp_path / "whole", lambda m: m.pop("tables"))
    refuse("found together with postures.csv and without a sha256", read_measurements, tmp_path / "whole")


PATH = Path("postures.csv")
NAMES = ["posture", "q.left_knee", "support"]
ROWS = [["1", "0.25", "double"], ["2", "-1.5e-3", "double"], ["3", "7", ""]]
PLAIN = "".join(",".join(row) + "\n" for row in (NAMES, *ROWS)).encode()


@given(
    separator=st.sampled_from([",", ";"]),
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
        text = text.replace(".", ",") if comma and separator == ";" and text not in NAMES else text
        return " " * spaces + (f'"{text}"' if quoted else text) + " " * spaces

    lines = [separator.join([*map(value, row), *[""] * columns]) for row in (NAMES, *ROWS)]
    for at, extra in between:
        lines.insert(at, extra if extra.strip() else separator * (columns + 2))
    if top:
        lines.insert(0, top + separator)
    text = end.join(lines) + (end if last else "")
    assert plain_csv(PATH, (b"\xef\xbb\xbf" if mark else b"") + text.encode()) == PLAIN


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
    except InputError:
        return
    assert plain_csv(PATH, again) == again
