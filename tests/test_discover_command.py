"""`tulip discover` on folders: as others write them, and such as it refuses."""

from __future__ import annotations

import csv
import dataclasses
import json

import pytest

from tests.effect_changes import measured
from tulip_testbed.cli.main import main
from tulip_testbed.measurements import read_measurements, write_measurements


@pytest.mark.slow
def test_the_command_reads_a_foreign_folder_and_its_rig_is_the_new_nominal(robot, plan, tmp_path, capsys):
    """A folder as another program may write it: CSV, no commands, no motors, unknown noise of the cells."""
    hidden = ("encoder-offset", "right_knee", (0.01,))
    m = measured(robot, plan, "wii", hidden)
    bare = dataclasses.replace(
        m, command=None, motor=None, sensors=dataclasses.replace(m.sensors, cell_sd=None)
    )
    write_measurements(tmp_path / "parquet", bare)
    folder = as_csv(tmp_path / "parquet", tmp_path / "csv")
    run = tmp_path / "found"
    assert main(["discover", str(folder), "--out", str(run), "--no-check", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "named"
    (effect,) = document["adopted"]
    assert (effect["name"], effect["target"]) == hidden[:2]
    assert set(document["heldout"]["before"]) == {"A", "F", "T", "C", "AFTC"}
    assert document == json.loads((run / "result.json").read_text())
    assert main(["identify", str(folder), "--corrections", document["rig"], "--json"]) == 0
    freed = json.loads(capsys.readouterr().out)
    plain = tmp_path / "plain"
    write_measurements(plain, dataclasses.replace(measured(robot, plan, "wii"), command=None, motor=None))
    assert main(["identify", str(plain), "--json"]) == 0
    truth = json.loads(capsys.readouterr().out)
    columns = freed["full"]["value"], truth["full"]["value"], truth["full"]["standard_error"]
    for estimate, true, error in zip(*columns, strict=True):
        assert abs(estimate - true) < error


def as_csv(source, folder):
    """The same folder with its table as CSV, hash left out."""
    measured = read_measurements(source)
    assert measured
    import pyarrow.parquet as pq

    folder.mkdir()
    table = pq.read_table(source / "postures.parquet").to_pylist()
    with (folder / "postures.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    manifest = json.loads((source / "manifest.json").read_text())
    manifest["tables"] = None
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder
