"""The laboratory as a dm_env environment: the interface's rules, its options, its example."""

import dataclasses
import os
import re
import runpy
import subprocess
import sys
import unittest
from pathlib import Path

import numpy as np
import pytest
from dm_env import test_utils

from tests.test_composer import cells
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.rig import preset_rig

ROOT = Path(__file__).parent.parent


def test_an_episode_keeps_its_repeatability_and_a_seed_its_readings(rig, stand):
    """With repeatability as the only error, the error stays through an episode and changes with it."""
    rig = dataclasses.replace(rig, sensors=dataclasses.replace(rig.sensors, cell_repeatability=1.0))
    options = {"true_cells": {"enabled": True, "update_interval": 10}}

    def errors(seed: int) -> list[np.ndarray]:
        environment = laboratory_environment(rig, stand, seed=seed, observable_options=options)
        found = []
        for _ in range(2):
            step = environment.reset()
            for _ in range(3):
                found.append(step.observation["left_plate/cells"] - step.observation["left_plate/true_cells"])
                step = environment.step(stand)
        return found

    first, again, other = errors(112), errors(112), errors(113)
    assert first[0] == pytest.approx(first[2])
    assert first[3] == pytest.approx(first[5])
    assert np.abs(first[0] - first[3]).min() > 1e-3
    assert np.array_equal(first, again)
    assert np.abs(first[0] - other[0]).min() > 1e-3


def test_sensors_read_at_their_sample_rate(rig, stand):
    """100 Hz: every tenth millisecond a new reading, in between the last one."""
    environment = laboratory_environment(rig, stand, control_timestep=0.001)
    environment.reset()
    readings = np.array([cells(environment.step(stand)) for _ in range(40)])
    changed = (np.diff(readings, axis=0) != 0).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [8, 18, 28, 38]


@pytest.mark.parametrize("actuation", ["angles", "torques"])
def test_an_episode_ends_when_the_robot_tips(rig, stand, actuation):
    environment = laboratory_environment(rig, stand, actuation=actuation, reward=lambda physics: 2.5)
    environment.reset()
    limp = np.zeros(12) if actuation == "torques" else np.where(np.arange(12) % 6 == 4, 0.3, stand)
    while not (step := environment.step(limp)).last():
        assert environment.physics.time() < 5
    assert (step.reward, step.discount) == (2.5, 1.0)


def test_no_display_no_warning():
    """Without a display and without MUJOCO_GL, as on a server."""
    environment = {
        k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "import sim.composer"],
        cwd=ROOT,
        env=environment | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_example_balances_the_load(capsys):
    runpy.run_path(str(ROOT / "examples" / "drive_laboratory.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    shares = [float(line.split()[3]) for line in lines[1:-1]]
    assert shares[0] < 0.45
    assert abs(shares[-1] - 0.5) < 0.01
    assert lines[-1].startswith("both plates carry half of the load")


def test_the_documentations_code_runs():
    text = (ROOT / "docs" / "how-to" / "composer.md").read_text(encoding="utf-8")
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)
    names["environment"].reset()
    assert names["step"].observation["robot/centre_of_mass"].shape == (3,)


class Conformance(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own rules, in torques, with every observable there is, averaged and late."""

    def make_object_under_test(self, **unused_kwargs):
        options = {
            "cells": {"buffer_size": 5, "aggregator": "mean", "delay": 7},
            "true_cells": {"enabled": True, "buffer_size": 3},
            "centre_of_mass": {"enabled": True},
            "sole_forces": {"enabled": True},
        }
        standing = np.array([0, 0, -0.16075, 0.34907, -0.18832, 0] * 2)
        how = {"actuation": "torques", "time_limit": 0.2, "seed": 114, "observable_options": options}
        return laboratory_environment(preset_rig("wii"), standing, **how)
