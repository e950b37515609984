"""identify and discover point to the preflight where that fails."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_check import FAULTS, HEALTHY
from tulip_testbed.base.errors import InputError, InputWarning
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.check_folder import warn_of_faults

FAULT = "one cell drifts by 5 N"


@pytest.mark.parametrize("variant", HEALTHY)
def test_healthy_measurements_are_identified_without_a_word(wii, precise, robot, variant):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for measured in (wii.measurements, precise):
            warn_of_faults(HEALTHY[variant](measured), robot)


@pytest.mark.parametrize("name", ["forces of two postures interchanged", "one encoder's sign wrong"])
def test_whatever_fails_the_preflight_is_said(precise, robot, name):
    wrong = FAULTS[name](precise, np.random.default_rng(0))
    failed = [c["name"] for c in tt.check(wrong, robot).to_json()["checks"] if c["result"] == "fail"]
    assert failed
    with pytest.warns(InputWarning, match=repr(failed[-1])):
        warn_of_faults(wrong, robot)


def test_discover_says_it_too(precise, robot, monkeypatch):
    monkeypatch.setattr("tulip_testbed.api.measured.discover_effects", lambda *a, **k: None)
    with pytest.warns(InputWarning, match="found faults in 'weight balance'"):
        tt.discover(FAULTS[FAULT](precise, np.random.default_rng(0)), robot)


def test_a_fault_is_one_line_that_points_to_the_preflight(precise, robot, tmp_path, capsys):
    wrong = FAULTS[FAULT](precise, np.random.default_rng(0))
    with pytest.warns(
        InputWarning,
        match=r"found faults in 'weight balance', 'drift'.*; `tt.check\(measurements\)` says more",
    ):
        tt.identify(wrong, robot)
    tt.write_measurements(tmp_path / "data", wrong)
    with pytest.warns(
        InputWarning, match=rf"{tmp_path}/data: found faults in .*`tt.check\('{tmp_path}/data'\)`"
    ):
        tt.identify(tmp_path / "data", robot)
    capsys.readouterr()
    assert main(["identify", str(tmp_path / "data")]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"tulip: warning: {tmp_path}/data: found faults in ")
    assert said.endswith(f"; `tulip check {tmp_path}/data` says more\n")
    assert main(["check", str(tmp_path / "data")]) == 1


def test_a_fault_that_is_corrected_for_is_none(robot):
    lab = tt.Laboratory(robot, sensors="force-plate").with_effects("cell-gain:right.front_left=0.1")
    measured = lab.run(tt.plans.random, engine="statics").measurements
    with pytest.warns(InputWarning, match="'weight balance'"):
        tt.identify(measured, robot)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tt.identify(measured, robot, corrections="cell-gain:right.front_left=0.1")


def test_a_plan_whose_swing_foot_is_elsewhere_is_refused(robot, tmp_path):
    pose = tt.plans.random.swing_pose.copy()
    pose[:5, 0] += 5.0
    wrong = dataclasses.replace(tt.plans.random, swing_pose=pose)
    message = (
        r"columns 'swing\.\*', row 1: found 4\.\d+, .*, expected .*, where the joint angles put the foot"
    )
    with pytest.raises(InputError, match=f"plan: {message}"):
        tt.Laboratory(robot).run(wrong, engine="statics")
    tt.plans.write(tmp_path / "plan", wrong)
    with pytest.raises(InputError, match=message):
        tt.plans.read(tmp_path / "plan", robot)
