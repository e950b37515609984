"""docs/how-to/your-data.md does what it says; hand-written folders need no more than it asks for."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.test_measurements import edit_manifest
from tulip_testbed.base.errors import InputError
from tulip_testbed.cli.main import main
from tulip_testbed.measurements import read_measurements, write_measurements

ROOT = Path(__file__).parent.parent
GUIDE = (ROOT / "docs" / "how-to" / "your-data.md").read_text()
EXAMPLE = ROOT / "docs" / "how-to" / "your-data"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", GUIDE, flags=re.DOTALL)


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "mine")
    return tmp_path / "mine"


def test_the_guide_shows_the_example_folder():
    assert blocks("json") == [(EXAMPLE / "manifest.json").read_text()]
    assert (EXAMPLE / "postures.csv").read_text().startswith(blocks("csv")[0])


def test_as_many_parameters_come_out_well_identified_as_the_guide_says(monkeypatch, capsys):
    assert "three parameters come out well identified" in GUIDE
    monkeypatch.setenv("COLUMNS", "400")  # no text wraps
    assert main(["identify", str(EXAMPLE)]) == 0
    out = capsys.readouterr().out
    assert len(re.findall(r"\d  yes\s", out.partition("Simplified model")[0])) == 3


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
    with pytest.raises(InputError, match=r"found together with postures\.csv and without a sha256"):
        read_measurements(tmp_path / "whole")
