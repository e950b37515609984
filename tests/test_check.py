"""tulip check: silent on healthy folders, loud on planted faults, and right about its own figures."""

import dataclasses
import json
import re
import warnings
from functools import partial
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests import edited_rows
from tests.edited_rows import changed, plus, put, within
from tests.test_cli import told
from tests.test_refusals import check_words, refuse, rows
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.check_folder import (
    check_folder,
    check_measurements,
    counts_line,
    warn_of_faults,
)
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.preflight.finding import STATISTICAL_CHECKS
from tulip_testbed.measurements import write_measurements


def found(measurements, nominal):
    return {finding.name: finding for finding in preflight(measurements, nominal)}


def results(measurements, nominal):
    return {name: finding.result for name, finding in found(measurements, nominal).items()}


@pytest.mark.parametrize(
    "variant",
    [
        lambda m: m,
        lambda m: m.take(m.placement <= 15),
        lambda m: dataclasses.replace(m, weighed_mass=None),
        lambda m: dataclasses.replace(m, sensors=tt.SensorSheet()),
    ],
)
def test_healthy_folders_pass(wii, precise, nominal, variant):
    for measured in (wii.measurements, precise):
        seen = results(variant(measured), nominal)
        assert set(seen.values()) <= {"pass", "not evaluated"}, seen


def test_noise_free_data_are_told_so_and_nothing_fails(ideal, nominal):
    seen = results(ideal.measurements, nominal)
    assert {name for name, result in seen.items() if result in ("warn", "fail")} == {"stated noise"}


def test_every_statistical_check_has_its_share_of_the_level(wii, nominal):
    """Weight balance and constant weight exclude each other; settling wants a series."""
    with_p = [f for f in preflight(wii.measurements, nominal) if f.p_value is not None]
    assert len(with_p) + 1 == STATISTICAL_CHECKS


@pytest.fixture(scope="module")
def feet(robot, plan):
    """Readings of sensors in the feet, at the ankle, whose zeros are taken off."""
    run: Any = tt.Laboratory(robot, "foot-ideal").run(plan.take(plan.placement <= 4), 1, "statics")
    noise = np.diag([1.0, 1.0, 1.0, 0.05, 0.05, 0.05]) ** 2
    known = within("contacts", run.measurements, covariance=noise, zero_sd=np.zeros((2, 6)))
    return dataclasses.replace(known, wrenches=known.wrenches - run.truth.zeros)


@rows("checks")
def test_a_check_says_what_is_wrong_and_where(precise, wii, feet, nominal, changes, words):
    """Those of sensors in the feet weigh 30 N of 225 N at the ankle, 60 mm over the sole: 8 mm."""
    names = {"m": precise, "wii": wii.measurements, "feet": feet, "unknown": np.full((2, 6), np.inf)}
    names["few"] = wii.measurements.take(wii.measurements.placement <= 3)
    names |= {"np": np, "replace": dataclasses.replace} | vars(edited_rows)
    one = found(eval(changes[0], names), nominal)[words.partition(":")[0]]
    told = f"{one.name}: {'gross ' * bool(one.gross)}{one.result}; {one.where}; {one.seen}; {one.expected}; "
    check_words(words, told + one.advice)
    assert one.seen


def test_a_pass_says_what_was_not_evaluated_and_why(feet, robot):
    found = check_measurements(feet, robot)
    counts = found.counts
    evaluated = sum(counts.values()) - counts["not evaluated"]
    assert counts["not evaluated"] > 5
    assert counts_line(counts).startswith(f"{evaluated} of {sum(counts.values())} checks evaluated: ")
    lines = [part for part in found.tables() if isinstance(part, str) and part.startswith("Not evaluated: ")]
    assert lines[0].endswith("(needs the readings of vertical cells; there are wrench sensors).")
    skipped = [name for line in lines for name in line.partition(": ")[2].partition(" (")[0].split(", ")]
    assert set(skipped) == {one.name for one in found.checks if one.result == "not evaluated"}


def test_command_line_fails_and_cannot_read(precise, tmp_path, capsys):
    write_measurements(tmp_path / "bad", changed(precise, cell_forces=lambda v: v / precise.gravity))
    document = told(capsys, "check", tmp_path / "bad", code=1)
    assert document["verdict"] == "fail"
    assert document["counts"]["fail"] == 1
    assert set(document["checks"][0]) == {"name", "result", "seen", "expected", "where", "advice", "p_value"}
    (tmp_path / "empty").mkdir()
    assert told(capsys, "check", tmp_path / "empty", code=2)["verdict"] == "could not read"


def test_an_incomplete_folder_hears_everything_at_once(robot, tmp_path, capsys):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "manifest.json").write_text('{"format": "tulip-measurements", "version": 3, "gravity": 9.81}')
    (folder / "postures.csv").write_text(
        "posture,placement,q.right_knee,cell.right.front_left,cell.right.frontright\n1,1.5,bent,20.5,3\n"
    )
    found = check_folder(folder, robot).to_json()["complaints"]
    text = " ".join(found["manifest"] + found["table"])
    for part in (
        "keys missing: robot, joints, plates, weighed_mass, sensors",
        "key 'version': found 3",
        "columns missing: q.right_hip_yaw, q.right_hip_roll",
        "plate.left.yaw",
        "columns that the format does not know: cell.right.frontright",
        "column 'placement', row 1: found 1.5, expected a whole number",
        "column 'q.right_knee': found string, expected numbers (row 1: 'bent')",
    ):
        assert part in text
    assert main(["check", str(folder)]) == 2
    assert '"stance_foot": "right_foot"' in capsys.readouterr().out


def test_the_printed_example_can_be_read(robot, tmp_path):
    """Copied into an empty folder it is a measurement, of one posture that lies over its plates."""
    folder = tmp_path / "mine"
    folder.mkdir()
    document = check_folder(folder, robot).to_json()
    (folder / "manifest.json").write_text(json.dumps(document["example_manifest"]))
    row = document["example_row"]
    (folder / "postures.csv").write_text(",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n")
    checks = {check["name"]: check["result"] for check in check_folder(folder, robot).to_json()["checks"]}
    assert {name for name, result in checks.items() if result == "fail"} == {"identifiable"}
    assert checks["feet on plates"] == "pass"


def test_what_computes_with_measurements_warns_of_faults(precise, robot, monkeypatch):
    for work in ("discover_effects", "_predict"):
        monkeypatch.setattr(f"tulip_testbed.api.measured.{work}", lambda *a, **k: None)
    wrong = changed(precise, joint_angles=put(..., 10, value=-precise.joint_angles[:, 10]))
    failed = [check.name for check in tt.check(wrong, robot).checks if check.result == "fail"]
    refuse("found gross faults ... 'legs close'", tt.discover, wrong, robot)
    for call in (partial(tt.discover, anyway=True), tt.predict, warn_of_faults):
        with pytest.warns(tt.InputWarning, match=f"found faults in .*{failed[-1]}.*no result holds"):
            call(wrong, robot)


def test_a_fault_is_one_line_that_points_to_the_preflight(precise, robot, tmp_path, capsys):
    time, data = precise.time, tmp_path / "data"
    wrong = changed(precise, cell_forces=plus(5.0 * (time - time[0]) / np.ptp(time), ..., 6))
    tt.write_measurements(data, wrong)
    found = "found faults in 'weight balance', 'drift'.*check.* says more$"
    with pytest.warns(tt.InputWarning, match=f"^measurements: {found}"):
        tt.identify(wrong, robot)
    capsys.readouterr()
    for command in (["identify"], ["export", "--out", str(tmp_path / "out.xml")]):
        assert main([*command, str(data)]) == 0
        assert re.search(f"^tulip: warning: {data}: {found}", capsys.readouterr().err, re.MULTILINE)
    assert main(["check", str(data)]) == 1


def test_a_fault_that_is_corrected_for_is_none(robot):
    lab = tt.Laboratory(robot, sensors="force-plate").with_effects("cell-gain:right.front_left=0.1")
    few = tt.plans.random.take(tt.plans.random.placement <= 16)
    measured = lab.run(few, engine="statics").measurements
    with pytest.warns(tt.InputWarning, match="'weight balance'"):
        tt.identify(measured, robot)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tt.identify(measured, robot, corrections="cell-gain:right.front_left=0.1")
        corrected = tt.check(measured, robot, corrections="cell-gain:right.front_left=0.1")
    assert (tt.check(measured, robot).verdict, corrected.counts["fail"]) == ("fail", 0)
    wrong = "cell-gain:right.front_left=0.1", "encoder-offset:left_knee=0.003"
    told = (
        r"found the correction encoder-offset:left_knee=0\.003, but the measurements show offset \S+ ± \S+ "
    )
    with pytest.warns(tt.InputWarning, match=told) as warned:
        tt.identify(measured, robot, corrections=wrong)
    assert len(warned) == 1
