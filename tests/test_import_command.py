"""`tulip import`: a laboratory's own table becomes a measurement folder, and no sign or unit is guessed."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tulip_testbed as tt
from tests.contact_folders import EXAMPLE
from tests.test_cli import told
from tests.test_refusals import check_words, refuse, rows
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.table_import.column_names import propose
from tulip_testbed.experiments.table_import.import_map import ImportMap, read_map, with_unknowns
from tulip_testbed.experiments.table_import.table_import import MappedColumn
from tulip_testbed.measurements import read_measurements
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.contacts import VERTICAL

ROOT = Path(__file__).parent.parent
PLATES = "".join(
    f"""
[plates.{side}]
top_height = 0.05
cells = {{front_left = [0.2, 0.1], front_right = [0.2, -0.1], rear_right = [-0.2, -0.1], \
rear_left = [-0.2, 0.1]}}
"""
    for side in ("right", "left")
)
WRENCHES = "".join(
    f"""
[[contacts]]
name = "{side}"
kind = "wrench"
mount = "ground"
channels = ["fz", "mx", "my"]
top_height = 0.05
zero = "tared"
"""
    for side in ("right", "left")
)


@pytest.fixture(scope="module")
def measured():
    return read_measurements(EXAMPLE)


@pytest.fixture
def table(measured, tmp_path):
    """Write a table of a laboratory with names, units and signs of its own."""

    def written(turned=(), change=lambda columns: None):
        columns = {"posture": measured.posture, "placement": measured.placement, "time": measured.time}
        for k, joint in enumerate(measured.joints):
            sign = -1 if joint in turned else 1
            side, *rest = joint.split("_")
            camel = side[0].upper() + "".join(map(str.capitalize, rest))
            columns[f"{camel} [deg]"] = sign * np.rad2deg(measured.joint_angles[:, k])
        for name, values in measured.columns().items():
            if name.startswith("plate."):
                columns[name.replace(".", "_") + ("_rad" if name.endswith("yaw") else "_m")] = values
        for p, side in enumerate(("R", "L")):
            forces, cells = measured.cell_forces[:, 4 * p : 4 * p + 4], measured.cells[p]
            columns[f"{side} fz (N)"] = forces.sum(axis=1)
            columns[f"{side} mx (N m)"] = forces @ cells[:, 1]
            columns[f"{side} my (N m)"] = -forces @ cells[:, 0]
        change(columns)
        path = tmp_path / "own.csv"
        pd.DataFrame(columns).to_csv(path, index=False)
        return path

    return written


@pytest.fixture
def stated(tmp_path):
    def written(text):
        path = tmp_path / "map.toml"
        path.write_text(text)
        return str(path)

    return written


def test_a_table_of_its_own_names_is_imported(table, stated, measured, tmp_path):
    path = table()
    found = tt.import_table(path, out=tmp_path / "data", map=[stated(WRENCHES)])
    assert found.folder == str(tmp_path / "data")
    assert (tmp_path / "data" / "postures.csv").read_bytes() == path.read_bytes()
    m = read_measurements(tmp_path / "data")
    assert m.contacts is not None
    assert m.contacts.channels == VERTICAL
    assert m.joint_angles == pytest.approx(measured.joint_angles, abs=1e-12)
    assert m.plate_poses == pytest.approx(measured.plate_poses)
    knee = found.mapped["q.right_knee"]
    assert knee == MappedColumn(
        column="RKnee [deg]", unit="deg", sign=1, by="words of the name", checked="range of the joint"
    )
    assert "closed legs" in {one.checked for one in found.mapped.values()}
    assert found.mapped["wrench.left.fz"].checked == "weight"
    assert found.problems == ()
    assert any(text.startswith("signs +1, which nothing here has checked: ") for text in found.assumed)
    assert "RKnee [deg]" in repr(found)


def test_a_turned_sign_is_noticed_and_can_be_stated(table, stated, measured, tmp_path):
    path = table(turned=("left_knee",))
    told = "[sensors]\nencoder_sd = 0.0008\n" + WRENCHES
    found = tt.import_table(path, out=tmp_path / "wrong", map=[stated(told)])
    named = [text for text in found.problems if text.startswith("q.left_knee: ")]
    assert len(named) >= 1
    assert "q.left_knee: the soles would be level within" in " ".join(named)
    assert not any(text.startswith("q.right_knee") for text in found.problems)
    assert found.exit_code == 1
    closed = next(one for one in tt.check(tmp_path / "wrong").checks if one.name == "legs close")
    assert closed.advice.startswith("The sign of left_knee: with it turned the soles would be level within")
    entry = "q.left_knee=LKnee [deg]:deg:-1"
    found = tt.import_table(path, out=tmp_path / "data", map=[stated(WRENCHES), entry])
    assert (found.problems, found.exit_code) == ((), 0)
    assert found.mapped["q.left_knee"].sign == -1
    assert found.mapped["q.left_knee"].by == "statement"
    assert read_measurements(tmp_path / "data").joint_angles == pytest.approx(measured.joint_angles)


@rows("imports")
def test_a_doubtful_table_is_told(table, stated, tmp_path, changes, words):
    text, edit, *entries = changes
    path = table(change=lambda columns: eval(edit, {"columns": columns}))
    maps = [stated(text.replace("WRENCHES", WRENCHES)), *entries]
    found = tt.import_table(path, out=tmp_path / "data", map=maps)
    told = "imported" if found.folder else "not imported"
    told = f"{told}: {'; '.join(found.problems)}; assumed: {'; '.join(found.assumed)}"
    assert told.startswith(words.partition(":")[0])
    check_words(words, told)
    assert (tmp_path / "data").exists() == bool(found.folder)


def test_a_joint_may_be_constant_and_a_placement_be_found(table, stated, measured, tmp_path):
    def drop(columns):
        del columns["LAnkleRoll [deg]"], columns["placement"]

    text = WRENCHES + "[constant_joints]\nleft_ankle_roll = {value = 0.1, sd = 0.05}\n"
    found = tt.import_table(table(change=drop), out=tmp_path / "data", map=[stated(text)])
    m = read_measurements(tmp_path / "data")
    assert m.constant_joints == {"left_ankle_roll": 0.05}
    assert m.placement.tolist() == measured.placement.tolist()
    assert found.mapped["placement"].by == "added"


def test_columns_that_could_be_the_same_are_not_chosen_from():
    proposal = propose(["a knee [deg]", "AKnee angle [deg]"], ["q.a_knee"], ["q.a_knee"], {})
    assert proposal.undecided == [
        "q.a_knee: columns 'a knee [deg]', 'AKnee angle [deg]' could be it; state one"
    ]


def test_a_name_is_known_however_it_is_spelt():
    cells = [f"cell.{cell}" for cell in CELLS]
    names = [*cells, "cop.right.x", "plate.right.x", "q.right_knee", "q_command.right_knee", "time"]
    written = [f"{cell.replace('.', ' ')} [N]" for cell in CELLS]
    written += ["right cop x [m]", "R plate x (mm)", "RKnee_deg", "cmd_r_knee_rad", "Timestamp [s]"]
    found = propose(written, names, names, {})
    assert {name: entry.column for name, entry in found.mapping.items()} == dict(
        zip(names, written, strict=True)
    )
    assert [found.mapping[name].unit for name in names[-4:]] == ["mm", "deg", "rad", "s"]


@rows("maps")
def test_wrong_statements_are_named(table, stated, tmp_path, changes, words):
    text, *entries = changes
    text = text.replace("WRENCHES", WRENCHES).replace("PLATES", PLATES)
    refuse(words, tt.import_table, table(), out=tmp_path / "data", map=[stated(text), *entries])


def test_the_documented_statements_can_be_read(tmp_path):
    guide = (EXAMPLE.parent / "your-data.md").read_text()
    *texts, log = re.findall(r"```toml\n(.*?)```", guide, flags=re.DOTALL)
    statement, plates = map(tomllib.loads, texts)
    (foot,) = statement.pop("contacts")
    assert ImportMap.model_validate(statement | plates).plates is not None
    contacts = [with_unknowns(foot | {"name": name}) for name in ("right", "left")]
    found = ImportMap.model_validate(statement | {"contacts": contacts})
    assert found.columns["q.right_knee"].sign == -1
    (tmp_path / "log.toml").write_text(log)
    of_log = read_map(tmp_path / "log.toml")
    assert of_log.series is not None
    assert of_log.columns["wrench.left.mz"].column == "left_foot_ft.6"
    whole = read_map([str(ROOT / "examples" / "icub_stand.toml")])
    assert whole.contacts is not None
    assert len(whole.constant_joints) == 6


def test_the_command_prints_one_document(table, stated, tmp_path, capsys):
    document = told(capsys, "import", table(), "--out", tmp_path / "data", "--map", stated(WRENCHES))
    assert list(document) == ["mapped", "assumed", "problems", "unused", "folder", "conventions"]
    assert document["folder"] == str(tmp_path / "data")
    assert document["mapped"]["q.left_hip_yaw"]["column"] == "LHipYaw [deg]"
    assert main(["import", str(table()), "--out", str(tmp_path / "other")]) == 1
    out = capsys.readouterr()
    assert "contacts: not stated" in out.out
    assert "No folder was written" in out.err + out.out
