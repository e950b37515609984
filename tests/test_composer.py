"""The laboratory as a dm_env environment: it reads what the fast path reads, by the interface's rules."""

import dataclasses
import os
import runpy
import subprocess
import sys
import unittest
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_env import test_utils

from tests.statics_against_dynamics import heavier, pulled, without_friction
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.drives import Drives
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.sensors import Sensors

POSES = np.array([[0.0301, -0.1552, 0.0113], [0.0322, 0.1553, -0.0207]])
PERIOD = 20  # physics steps from action to action


def cells(step, name: str = "cells") -> np.ndarray:
    """The eight readings of a time step."""
    return np.concatenate([step.observation[f"{side}_plate/{name}"] for side in ("right", "left")])


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"edit": without_friction(heavier, pulled)}, marks=pytest.mark.slow),
        {"drives": Drives(0.013, 0.0021), "compliance": Compliance(1.3e-6, 1.7e-4, 3.3e-7)},
    ],
    ids=["shipped", "edited", "springs"],
)
def test_both_paths_go_the_same_way_bit_for_bit(rig, plan, changes):
    """The same steps of the same model: no tolerance, over three seconds with a moving command."""
    rig = dataclasses.replace(rig, **changes)
    posture = plan.joint_angles[7]
    environment, fast = laboratory_environment(rig, posture, POSES), Stand(rig, POSES)
    environment.reset()
    fast.reset(posture, fast.chain.base_pose(posture))
    # dm_control computes a reset state without the actuators; the solver starts from that.
    fast.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
    mujoco.mj_forward(fast.model, fast.data)
    fast.model.opt.disableflags ^= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
    for k in range(150):
        command = posture + 0.02 * np.sin(0.1 * k) * np.arange(12) / 12
        step = environment.step(command)
        fast.command = command
        mujoco.mj_step(fast.model, fast.data, PERIOD)
        assert not step.last()
        qpos = fast.data.qpos
        assert step.observation["robot/joint_encoders"].tobytes() == qpos[fast.qpos].tobytes()
        assert step.observation["robot/motor_encoders"].tobytes() == qpos[fast.motors].tobytes()
        assert cells(step).tobytes() == fast.cell_forces().tobytes()
    assert environment.physics.data.qvel.tobytes() == fast.data.qvel.tobytes()


def test_torques_by_the_servos_law_do_what_the_servos_do(rig, plan):
    """With its own controller at every physics step, the torque environment repeats the other."""
    posture = plan.joint_angles[7]
    angles = laboratory_environment(rig, posture, control_timestep=0.001)
    torques = laboratory_environment(rig, posture, control_timestep=0.001, actuation="torques")
    limit = torques.action_spec().maximum
    assert limit[3] == 25.4
    kp = limit / rig.controller.error_at_full_torque
    angles.reset()
    torques.reset()
    for _ in range(1000):
        data = torques.physics.data
        speed = rig.controller.derivative_time * data.qvel[6:18]
        torques.step(np.clip(kp * (posture - data.qpos[7:19] - speed), -limit, limit))
        angles.step(posture)
    assert torques.physics.data.qpos == pytest.approx(angles.physics.data.qpos, abs=1e-9)


def test_truth_is_there_when_asked_for_and_balances(rig, stand):
    options = {name: {"enabled": True} for name in ("centre_of_mass", "sole_forces", "true_cells")}
    environment = laboratory_environment(rig, stand, observable_options=options)
    environment.reset()
    for _ in range(150):
        step = environment.step(stand)
    forces = step.observation["robot/sole_forces"].reshape(2, 3)
    assert forces.sum(axis=0) == pytest.approx([0, 0, 23 * 9.81], abs=1e-2)
    assert forces[:, 2] == pytest.approx(cells(step).reshape(2, 4).sum(axis=1), abs=1e-2)
    # The robot is symmetric: it stands in the middle between its feet.
    assert step.observation["robot/centre_of_mass"][1] == pytest.approx(0.0624, abs=1e-4)
    plain = laboratory_environment(rig, stand).observation_spec()
    encoders = ["robot/joint_encoders", "robot/motor_encoders"]
    assert sorted(plain) == ["left_plate/cells", "right_plate/cells", *encoders]


def test_every_sample_is_rounded_and_cells_have_their_gain(rig, stand):
    sensors = Sensors(encoder_resolution=1e-3, motor_resolution=3e-4, cell_gain={"left.rear_right": 2.0})
    options = {"true_cells": {"enabled": True}}
    environment = laboratory_environment(
        dataclasses.replace(rig, sensors=sensors), stand, observable_options=options
    )
    environment.reset()
    for _ in range(10):
        observed = environment.step(stand).observation
    for name, resolution in (("robot/joint_encoders", 1e-3), ("robot/motor_encoders", 3e-4)):
        counts = observed[name] / resolution
        assert counts == pytest.approx(counts.round(), abs=1e-6)
        assert np.abs(counts).max() > 100
    assert observed["right_plate/cells"] == pytest.approx(observed["right_plate/true_cells"])
    assert observed["left_plate/cells"] == pytest.approx(observed["left_plate/true_cells"] * [1, 1, 2, 1])


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
