"""identify points to the preflight where that fails, in milliseconds."""

from __future__ import annotations

import dataclasses
import time
import warnings

import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_check import FAULTS, HEALTHY
from tulip_testbed.cli.main import main
from tulip_testbed.identification.preflight import quick_faults
from tulip_testbed.sim.errors import InputError, InputWarning

FAULT = "one cell drifts by 5 N"


@pytest.mark.parametrize("variant", HEALTHY)
def test_healthy_measurements_are_identified_without_a_word(wii, precise, nominal, variant):
    for measured in (wii.run.measurements, precise):
        assert quick_faults(HEALTHY[variant](measured), nominal) == []


def test_a_fault_is_one_line_that_points_to_the_preflight(precise, robot, tmp_path, capsys):
    wrong = FAULTS[FAULT](precise, np.random.default_rng(0))
    with pytest.warns(
        InputWarning, match=r"found faults in 'weight balance', 'drift'; `tt.check\(measurements\)`"
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


def test_it_takes_milliseconds(precise, nominal):
    began = time.perf_counter()
    for _ in range(5):
        quick_faults(precise, nominal)
    assert time.perf_counter() - began < 0.5


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
