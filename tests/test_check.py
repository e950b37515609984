"""tulip check: silent on healthy folders, loud on planted faults, and right about its own figures."""

import dataclasses
import json
import re
import warnings
from functools import partial

import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import changed, plus
from tests.folder_faults import FAULTS, HEALTHY, planted
from tests.test_cli import told
from tests.test_refusals import check_words, refuse, rows
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.check_folder import check_folder, warn_of_faults
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.preflight.finding import STATISTICAL_CHECKS
from tulip_testbed.measurements import write_measurements


def found(measurements, nominal):
    return {finding.name: finding for finding in preflight(measurements, nominal)}


def results(measurements, nominal):
    return {name: finding.result for name, finding in found(measurements, nominal).items()}


@pytest.mark.parametrize("variant", HEALTHY)
def test_healthy_folders_pass(wii, precise, nominal, variant):
    for measured in (wii.measurements, precise):
        seen = results(HEALTHY[variant](measured), nominal)
        assert set(seen.values()) <= {"pass", "not evaluated"}, seen


def test_noise_free_data_are_told_so_and_nothing_fails(ideal, nominal):
    seen = results(ideal.measurements, nominal)
    assert {name for name, result in seen.items() if result in ("warn", "fail")} == {"stated noise"}


def test_every_statistical_check_has_its_share_of_the_level(wii, nominal):
    """Weight balance and constant weight exclude each other; settling wants a series."""
    with_p = [f for f in preflight(wii.measurements, nominal) if f.p_value is not None]
    assert len(with_p) + 1 == STATISTICAL_CHECKS


def test_a_check_without_power_does_not_pass(wii, nominal):
    """Four placements for 25 parameters: a plate 100 mm off would not be detected."""
    measured = wii.measurements
    few = measured.take(measured.placement <= 4)
    finding = found(few, nominal)["single placements"]
    assert finding.result == "not evaluated"
    assert "no power" in finding.seen
    assert "would be detected" in found(measured, nominal)["single placements"].seen


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_caught_by_its_check(precise, nominal, fault):
    finding = found(planted(fault, precise, 111), nominal)[FAULTS[fault][1]]
    assert finding.result == "fail"
    assert finding.seen


def test_words_say_what_where_and_what_to_do(precise, nominal):
    """The joint with a wrong zero, the placement with a shifted plate, the posture with a wrong figure."""
    finding = found(changed(precise, joint_angles=plus(0.02, ..., 3)), nominal)["legs close"]
    assert "offset of +20." in finding.advice or "offset of +19." in finding.advice
    assert "right_knee" in finding.advice
    moved = changed(precise, plate_poses=plus(0.03, precise.placement == 7, 1, 0))
    finding = found(moved, nominal)["single placements"]
    assert finding.where == "placement 7, left plate"
    finding = found(changed(precise, cell_forces=plus([18, -18], 40, [2, 3])), nominal)["single postures"]
    assert f"posture {precise.posture[40]} (row 41" in finding.where


@rows("units")
def test_units_are_guessed(precise, nominal, changes, words):
    other = eval(f"dict({changes[0]})", {"m": precise, "np": np})
    finding = found(dataclasses.replace(precise, **other), nominal)["units"]
    assert finding.result == "fail"
    check_words(words, finding.seen)


def test_another_robot_is_found_out(precise, nominal):
    other = dataclasses.replace(precise, robot=precise.robot | {"sha256": "0" * 64})
    assert results(other, nominal)["robot"] == "fail"
    unsaid = dataclasses.replace(precise, robot=precise.robot | {"sha256": None})
    assert results(unsaid, nominal)["robot"] == "pass"
    turned = dataclasses.replace(precise, joints=precise.joints[::-1])
    assert results(turned, nominal)["robot"] == "fail"


def test_command_line_passes_fails_and_cannot_read(precise, tmp_path, capsys):
    write_measurements(tmp_path / "good", precise)
    assert main(["check", str(tmp_path / "good")]) == 0
    assert "Verdict: pass" in capsys.readouterr().out
    write_measurements(tmp_path / "bad", planted("forces in kilograms", precise))
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
    wrong = planted("one encoder's sign wrong", precise)
    failed = [check.name for check in tt.check(wrong, robot).checks if check.result == "fail"]
    refuse("found gross faults ... 'legs close'", tt.discover, wrong, robot)
    for call in (partial(tt.discover, anyway=True), tt.predict, warn_of_faults):
        with pytest.warns(tt.InputWarning, match=f"found faults in .*{failed[-1]}.*no result holds"):
            call(wrong, robot)


def test_a_fault_is_one_line_that_points_to_the_preflight(precise, robot, tmp_path, capsys):
    wrong, data = planted("one cell drifts by 5 N", precise), tmp_path / "data"
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
