"""The laboratory as a dm_env environment: the fast path's readings, and the interface's rules."""

import dataclasses
import os
import re
import runpy
import subprocess
import sys
import unittest
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_env import test_utils

from sim.composer import laboratory_environment
from sim.errors import InputError
from sim.hold import Stand
from sim.measurements import lay_boards
from sim.model import sole_corners
from sim.path import base_pose
from sim.rig import preset_rig
from sim.sensors import PRESETS, Sensors, averaged_sd

ROOT = Path(__file__).parent.parent
POSES = np.array([[0.0301, -0.1552, 0.0113], [0.0322, 0.1553, -0.0207]])
PERIOD = 20  # physics steps from action to action


@pytest.fixture(scope="module")
def rig(robot):
    return preset_rig("ideal", robot)


@pytest.fixture(scope="module")
def stand(model):
    """The asset's standing posture, (n,)."""
    return model.key("stand").qpos[7:]


def heavier(spec: mujoco.MjSpec) -> None:
    """Another robot, with numbers that six digits do not hold, and a strap between its knees."""
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


def cells(step) -> np.ndarray:
    """The eight readings of a time step."""
    return np.concatenate([step.observation[f"{side}_plate/cells"] for side in ("right", "left")])


def put_down(stand_: Stand, command: np.ndarray) -> None:
    """On the fast path: what a reset does."""
    model, data = stand_.model, stand_.data
    mujoco.mj_resetData(model, data)
    data.qpos[stand_.qpos] = command
    data.qpos[stand_.free_qpos] = base_pose(stand_.nominal, stand_.robot, command)
    # dm_control computes a reset state without the actuators; the solver starts from that.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
    mujoco.mj_forward(model, data)
    model.opt.disableflags ^= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value


@pytest.mark.parametrize("edit", [None, heavier])
def test_both_paths_go_the_same_way_bit_for_bit(rig, plan, edit):
    """The same steps of the same model: no tolerance, over three seconds with a moving command."""
    rig = dataclasses.replace(rig, edit=edit)
    posture = plan.joint_angles[7]
    environment, fast = laboratory_environment(rig, posture, POSES), Stand(rig, POSES)
    environment.reset()
    put_down(fast, posture)
    for k in range(150):
        command = posture + 0.02 * np.sin(0.1 * k) * np.arange(12) / 12
        step = environment.step(command)
        fast.data.ctrl[fast.servos] = command
        mujoco.mj_step(fast.model, fast.data, PERIOD)
        assert not step.last()
        assert step.observation["robot/joint_encoders"].tobytes() == fast.data.qpos[fast.qpos].tobytes()
        assert cells(step).tobytes() == (fast.data.sensordata[fast.cells] - fast.tare).tobytes()
    assert environment.physics.data.qvel.tobytes() == fast.data.qvel.tobytes()


def test_a_held_posture_reads_the_same(rig, plan):
    """From where the fast path's protocol came to rest both go on alike, bit for bit.

    What was held is an average over the calm time, in which no cell may change by more than 1 mN
    per 20 ms; in the second after it the readings stay as near as that.
    """
    posture = plan.joint_angles[7]
    fast = Stand(rig, POSES)
    fast.put_down(posture)
    held, reason = fast.hold(posture)
    assert held, reason
    model, data = fast.model, fast.data

    def at_rest(physics, random_state):
        for name in ("qpos", "qvel", "qacc_warmstart"):
            getattr(physics.data, name)[:] = getattr(data, name)

    environment = laboratory_environment(rig, posture, POSES)
    environment.add_extra_hook("initialize_episode", at_rest)
    environment.reset()
    for _ in range(50):
        step = environment.step(posture)
        mujoco.mj_step(model, data, PERIOD)
        assert step.observation["robot/joint_encoders"].tobytes() == data.qpos[fast.qpos].tobytes()
        assert cells(step).tobytes() == (data.sensordata[fast.cells] - fast.tare).tobytes()
    assert cells(step) == pytest.approx(held.cell_forces, abs=50 * rig.protocol.force_gate)
    assert step.observation["robot/joint_encoders"] == pytest.approx(
        held.joint_angles, abs=rig.protocol.speed_gate
    )


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


# Once with errors that averaging leaves, once with those that it removes.
SENSORS = {
    "wii": PRESETS["wii"],
    "noise": Sensors(
        encoder_noise=1e-3,
        encoder_resolution=1e-4,
        motor_noise=2e-3,
        motor_resolution=1e-4,
        cell_noise=1.5,
        cell_resolution=0.1,
    ),
}


@pytest.mark.parametrize("sensors", SENSORS.values(), ids=SENSORS)
def test_readings_have_the_spread_that_averaged_sd_predicts(rig, stand, sensors):
    """40 episodes at rest, each channel the mean of 30 samples, against the same without errors.

    Per kind of sensor the errors' mean, and the sum of their squares over the predicted variance:
    chi-square with 40 x (12 or 8) degrees of freedom. Both within 4 s.d.; the two sets of sensors
    together raise a false alarm on one seed in 900.
    """
    episodes, samples = 40, 30
    kinds = {"joint_encoders": "encoder", "motor_encoders": "motor", "cells": "cell"}
    options = {name: {"buffer_size": samples, "aggregator": "mean"} for name in kinds}

    def readings(sensors: Sensors, count: int) -> dict[str, np.ndarray]:
        environment = laboratory_environment(
            dataclasses.replace(rig, sensors=sensors),
            stand,
            control_timestep=0.3,
            seed=111,
            observable_options=options,
        )
        environment.add_extra_hook("initialize_episode", at_rest)
        rows: dict[str, list[np.ndarray]] = {name: [] for name in kinds}
        for _ in range(count):
            environment.reset()
            step = environment.step(stand)
            rows["joint_encoders"].append(step.observation["robot/joint_encoders"])
            rows["motor_encoders"].append(step.observation["robot/motor_encoders"])
            rows["cells"].append(cells(step))
        return {name: np.array(values) for name, values in rows.items()}

    settled = laboratory_environment(rig, stand)
    settled.reset()
    for _ in range(100):
        settled.step(stand)
    rest = settled.physics.data.qpos.copy()

    def at_rest(physics, random_state):
        physics.data.qpos[:] = rest

    truth, read = readings(Sensors(), 1), readings(sensors, episodes)
    for name, kind in kinds.items():
        repeatability, noise, resolution = (
            getattr(sensors, f"{kind}_{figure}") for figure in ("repeatability", "noise", "resolution")
        )
        z = (read[name] - truth[name]) / averaged_sd(repeatability, noise, resolution, samples)
        assert abs(z.mean()) < 4 / np.sqrt(z.size)
        assert abs((z**2).sum() - z.size) < 4 * np.sqrt(2 * z.size)


def test_every_sample_is_rounded_and_cells_have_their_gain(rig, stand):
    sensors = Sensors(encoder_resolution=1e-3, motor_resolution=3e-4, cell_gain={"left.rear_right": 2.0})
    options = {"true_cells": {"enabled": True}}
    environment = laboratory_environment(
        dataclasses.replace(rig, sensors=sensors), stand, observable_options=options
    )
    environment.reset()
    for _ in range(10):
        seen = environment.step(stand).observation
    for name, resolution in (("robot/joint_encoders", 1e-3), ("robot/motor_encoders", 3e-4)):
        counts = seen[name] / resolution
        assert counts == pytest.approx(counts.round(), abs=1e-6)
        assert np.abs(counts).max() > 100
    assert seen["right_plate/cells"] == pytest.approx(seen["right_plate/true_cells"])
    assert seen["left_plate/cells"] == pytest.approx(seen["left_plate/true_cells"] * [1, 1, 2, 1])


def test_an_episode_keeps_its_repeatability_and_a_seed_its_readings(robot, stand):
    """With repeatability as the only error, the error stays through an episode and changes with it."""
    rig = preset_rig("ideal", robot)
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


def test_delay_and_buffer_are_dm_controls(rig, stand):
    options = {
        "joint_encoders": {"delay": 2 * PERIOD},
        "motor_encoders": {"buffer_size": 4, "update_interval": PERIOD},
    }
    environment = laboratory_environment(rig, stand, observable_options=options)
    plain = laboratory_environment(rig, stand)
    late, prompt = [environment.reset()], [plain.reset()]
    for k in range(6):
        command = stand + 0.01 * k
        late.append(environment.step(command))
        prompt.append(plain.step(command))
    assert np.array_equal(late[0].observation["robot/motor_encoders"], np.tile(stand, (4, 1)))
    angles = [step.observation["robot/joint_encoders"] for step in prompt]
    assert np.array_equal(late[6].observation["robot/joint_encoders"], angles[4])
    assert np.array_equal(late[6].observation["robot/motor_encoders"], angles[3:7])


def test_sensors_read_at_their_sample_rate(rig, stand):
    """100 Hz: every tenth millisecond a new reading, in between the last one."""
    environment = laboratory_environment(rig, stand, control_timestep=0.001)
    environment.reset()
    readings = np.array([cells(environment.step(stand)) for _ in range(40)])
    changed = (np.diff(readings, axis=0) != 0).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [8, 18, 28, 38]


def test_boards_lie_under_the_soles(rig, model, plan):
    """Where the laboratory lays them for the plan's own pose of the swing foot."""
    x, y, yaw = plan.swing_pose[7]
    right, left = (sole_corners(model, foot)[:, :2] for foot in rig.robot.feet)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    boards = lay_boards(np.array([right, left @ turn.T + [x, y]]), np.array([0.5, 0.3]), 0.01)
    environment = laboratory_environment(rig, plan.joint_angles[7])
    for plate, board in zip(environment.task.plates, boards, strict=True):
        position = np.asarray(environment.physics.bind(plate.root_body).xpos)
        assert position[:2] == pytest.approx(board[:2], abs=1e-6)


@pytest.mark.parametrize("actuation", ["angles", "torques"])
def test_an_episode_ends_when_the_robot_tips(rig, stand, actuation):
    environment = laboratory_environment(rig, stand, actuation=actuation, reward=lambda physics: 2.5)
    environment.reset()
    limp = np.zeros(12) if actuation == "torques" else np.where(np.arange(12) % 6 == 4, 0.3, stand)
    while not (step := environment.step(limp)).last():
        assert environment.physics.time() < 5
    assert (step.reward, step.discount) == (2.5, 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"joint_angles": np.zeros(11)}, r"joint_angles: found shape \(11,\), expected \(12,\)"),
        ({"joint_angles": np.full(12, np.nan)}, "joint_angles: found a number that is not finite"),
        ({"joint_angles": 0.1 * (np.arange(12) == 3)}, "heights .* expected both soles flat"),
        ({"plate_poses": np.zeros(3)}, r"plate_poses: found shape \(3,\), expected \(2, 3\)"),
        ({"actuation": "speeds"}, "unknown actuation 'speeds'; valid: angles, torques"),
        ({"control_timestep": 0.0123}, "control_timestep: .*multiple"),
        ({"observable_options": {"cell": {}}}, "unknown observable 'cell'; valid: .*cells"),
        ({"observable_options": {"cells": {"lag": 1}}}, "'cells': unknown option 'lag'; valid: .*delay"),
    ],
)
def test_what_does_not_fit_is_refused(rig, stand, arguments, message):
    with pytest.raises(InputError, match=message):
        laboratory_environment(rig, **({"joint_angles": stand} | arguments))


def test_parts_lose_nothing_of_the_scene(rig, stand):
    """Elements across parts, and of the arena's own, are all there, with their names."""

    def furnished(spec: mujoco.MjSpec) -> None:
        heavier(spec)
        weld = {"type": mujoco.mjtEq.mjEQ_WELD, "objtype": mujoco.mjtObj.mjOBJ_BODY, "active": False}
        spec.add_equality(name="moored", name1="world", name2="right_foot", **weld)
        spec.add_equality(name="stuck", name1="left_plate", name2="left_foot", **weld)
        spec.add_exclude(bodyname1="torso", bodyname2="left_plate")
        table = spec.worldbody.add_body(name="table", pos=[2, 0, 0])
        table.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
        table.add_site(name="table")
        spec.add_sensor(
            name="table",
            type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="table",
        )

    rig = dataclasses.replace(rig, edit=furnished)
    environment = laboratory_environment(rig, stand, POSES)
    whole, parts = Stand(rig, POSES).model, environment.physics.model.ptr
    for count in ("nq", "nv", "nu", "ngeom", "nsite", "npair", "nexclude", "ntendon", "nwrap", "nsensor"):
        assert getattr(parts, count) == getattr(whole, count), count
    assert parts.neq == whole.neq - 2  # the fast path's clamps
    assert parts.joint("robot/right_knee").range == pytest.approx(whole.joint("right_knee").range)
    assert parts.body("robot/torso").mass == whole.body("torso").mass
    assert parts.tendon("robot/strap").name == "robot/strap"
    assert parts.tendon_stiffness.tolist() == whole.tendon_stiffness.tolist()
    assert parts.geom("table").bodyid == parts.body("table").id
    assert [parts.pair(i).name for i in range(8)] == [whole.pair(i).name for i in range(8)]
    assert parts.equality("moored").id != parts.equality("stuck").id


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
    text = (ROOT / "docs" / "composer.md").read_text(encoding="utf-8")
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)
    names["environment"].reset()
    assert names["step"].observation["robot/centre_of_mass"].shape == (3,)


class Conformance(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own rules, with episodes that end by time, in angles."""

    def make_object_under_test(self, **unused_kwargs):
        return self.environment_of()

    @staticmethod
    def environment_of(**arguments):
        standing = np.array([0, 0, -0.16075, 0.34907, -0.18832, 0] * 2)
        return laboratory_environment(preset_rig("wii"), standing, time_limit=0.2, seed=114, **arguments)


class ConformanceInTorques(Conformance):
    """The same in torques, every observable there is, averaged and late."""

    def make_object_under_test(self, **unused_kwargs):
        options = {
            "cells": {"buffer_size": 5, "aggregator": "mean", "delay": 7},
            "true_cells": {"enabled": True, "buffer_size": 3},
            "centre_of_mass": {"enabled": True},
            "sole_forces": {"enabled": True},
        }
        return self.environment_of(actuation="torques", observable_options=options)
