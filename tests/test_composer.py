"""The laboratory as a dm_env environment: it reads what the fast path reads."""

import dataclasses

import mujoco
import numpy as np
import pytest

from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.drives import Drives
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.sensors import Sensors

POSES = np.array([[0.0301, -0.1552, 0.0113], [0.0322, 0.1553, -0.0207]])
PERIOD = 20  # physics steps from action to action


def heavier(spec: mujoco.MjSpec) -> None:
    """Another robot, with a strap between its knees."""
    rng = np.random.default_rng(110)
    for body in spec.bodies:
        if body.mass > 0:
            body.mass *= rng.uniform(0.9, 1.1)
            body.ipos = body.ipos + rng.uniform(-0.01, 0.01, 3)
    for joint in spec.joints:
        joint.damping = joint.damping * rng.uniform(0.9, 1.1)
        joint.frictionloss *= rng.uniform(0.9, 1.1)
    for pair in spec.pairs:
        pair.friction[:2] = rng.uniform(0.8, 1.2)
    for actuator in spec.actuators:
        actuator.biasprm[2] *= rng.uniform(0.9, 1.1)
    strap = spec.add_tendon(name="strap", stiffness=rng.uniform(1, 2), springlength=[0, 0])
    strap.wrap_joint("right_knee", 1.0)
    strap.wrap_joint("left_knee", -rng.uniform(0.9, 1.1))


def cells(step, name: str = "cells") -> np.ndarray:
    """The eight readings of a time step."""
    return np.concatenate([step.observation[f"{side}_plate/{name}"] for side in ("right", "left")])


def start(stand: Stand, command: np.ndarray) -> None:
    """On the fast path: what a reset does."""
    model, data = stand.model, stand.data
    stand.reset(command, stand.chain.base_pose(command))
    # dm_control computes a reset state without the actuators; the solver starts from that.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
    mujoco.mj_forward(model, data)
    model.opt.disableflags ^= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value


def assert_same(step, stand: Stand) -> None:
    """To the last bit."""
    qpos = stand.data.qpos
    assert step.observation["robot/joint_encoders"].tobytes() == qpos[stand.qpos].tobytes()
    assert step.observation["robot/motor_encoders"].tobytes() == qpos[stand.motors].tobytes()
    assert cells(step).tobytes() == stand.cell_forces().tobytes()


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"edit": heavier}, marks=pytest.mark.slow),
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
    start(fast, posture)
    for k in range(150):
        command = posture + 0.02 * np.sin(0.1 * k) * np.arange(12) / 12
        step = environment.step(command)
        fast.command = command
        mujoco.mj_step(fast.model, fast.data, PERIOD)
        assert not step.last()
        assert_same(step, fast)
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
    assert sorted(plain) == [
        "left_plate/cells",
        "right_plate/cells",
        "robot/joint_encoders",
        "robot/motor_encoders",
    ]


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
