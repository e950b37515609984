"""Force-torque sensors in the feet against contact forces and weights, and statics against dynamics."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.stats import ks_2samp

from studies.study_equilibrium import compare, excess_wrenches, laboratories
from tulip_testbed.base.errors import InputError
from tulip_testbed.cli.main import main
from tulip_testbed.effects.injection import edited, from_then_on
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.truth_record import SimulatedTruth
from tulip_testbed.measurements import PosturePlan, read_measurements
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.dynamics.dynamic_run import read_again, run_dynamics
from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import PRESETS, WrenchSensors, averaged_sd, draw_zeros
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics
from tulip_testbed.sim.wrench_sensors import add_foot_sensors, foot_addresses, in_sensor_frame

GRAVITY = 9.81
SHEET: Any = PRESETS["foot-ft"].wrench
TILTED = (0.01, -0.02, 0.03, 0.2, -0.3, 0.4)  # m, rad, a mounting
# On the right foot, in rad; the left foot hangs turned by up to half a radian about each axis.
ON_RIGHT = np.array(
    [
        [0.13, -0.31, -0.36, 0.35, -0.16, -0.05, -0.10, 0.00, -0.63, 0.99, -0.57, 0.11],
        [-0.24, -0.13, -0.23, 0.44, -0.31, -0.09, 0.08, 0.11, -0.47, 1.13, -0.41, -0.07],
        [0.04, -0.38, -0.57, 0.74, -0.39, -0.06, -0.15, 0.17, -0.38, 0.97, -0.35, 0.02],
    ]
)


def foot_rig(robot: Robot, preset: str = "foot-ideal", **changes) -> Rig:
    """Return a laboratory with changed foot sensors, in which nothing is measured twice."""
    rig = preset_rig(preset, robot)
    feet = dataclasses.replace(rig.sensors.wrench or WrenchSensors(), **changes)
    protocol = dataclasses.replace(rig.protocol, repeats=0)
    return dataclasses.replace(rig, sensors=dataclasses.replace(rig.sensors, wrench=feet), protocol=protocol)


def statics(rig: Rig, plan: PosturePlan, runs: int = 1) -> list[Any]:
    """Run an experiment by statics, as often as asked."""
    return list(run_statics(solve_plan(rig, plan), np.random.SeedSequence(7).spawn(runs)))


def heavy_foot(spec: mujoco.MjSpec) -> None:
    """Make the left foot 0.3 kg heavier and move its centre of mass."""
    foot = spec.body("left_foot")
    foot.mass, foot.ipos = foot.mass + 0.3, [0.05, 0.01, -0.04]


@pytest.fixture(scope="module")
def mixed(plan) -> PosturePlan:
    """Fifteen postures on both feet, and three on each, on placements of their own."""
    parts = [plan.take(plan.placement <= 3)]
    on_left = (ON_RIGHT * np.tile([-1, -1, 1, 1, 1, -1], 2))[:, [*range(6, 12), *range(6)]]
    for placement, (support, angles) in enumerate((("right", ON_RIGHT), ("left", on_left)), 4):
        one = plan.take(np.arange(3))
        if support == "left":
            one = dataclasses.replace(one, swing_pose=one.swing_pose * [1, -1, -1])
        part = {"joint_angles": angles, "support": np.full(3, support), "placement": np.full(3, placement)}
        parts.append(dataclasses.replace(one, posture=one.posture + 1000 * placement, **part))
    names = ("joint_angles", "posture", "placement", "support", "swing_pose")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return dataclasses.replace(plan, **joined)


@pytest.fixture(scope="module")
def dynamic(robot, mixed):
    return run_dynamics(foot_rig(robot), mixed, 7)


@pytest.fixture(scope="module")
def static(robot, mixed):
    return statics(foot_rig(robot), mixed)[0]


@pytest.fixture(scope="module", params=["dynamic", "static"])
def run(request):
    return request.getfixturevalue(request.param)


def grounded(robot: Robot, measured: Any, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn readings into wrenches of the ground about the base frame's origin, (m, 2, 3) twice [N, Nm].

    Poses are MuJoCo's kinematics at the measured angles with the foot that carries flat on the ground.
    """
    data, chain = mujoco.MjData(robot.model), ClosedChain(robot.model, robot)
    forces, moments = np.zeros((2, len(measured), 2, 3))
    for row, angles in enumerate(measured.joint_angles):
        data.qpos[:7] = chain.base_pose(angles, int(measured.support[row] == "left"))
        data.qpos[7:] = angles
        mujoco.mj_kinematics(robot.model, data)
        for side, foot in enumerate(robot.feet):
            body = data.body(foot)
            turn = body.xmat.reshape(3, 3)
            reading = measured.wrenches[row, side] - zeros[side]
            mass, *center = measured.contacts.below[side]
            weight = np.array([0.0, 0.0, -mass * GRAVITY])
            force = turn @ reading[:3] - weight
            forces[row, side] = force
            moments[row, side] = turn @ reading[3:] + np.cross(body.xpos, turn @ reading[:3])
            moments[row, side] -= np.cross(body.xpos + turn @ center, weight)
    return forces, moments


def test_the_feet_bear_the_weight_and_push_against_each_other(run, robot):
    forces, _ = grounded(robot, run.measurements, run.truth.zeros)
    np.testing.assert_allclose(forces[..., 2].sum(axis=1), GRAVITY * run.truth.mass, atol=2e-3)
    assert np.abs(forces[..., :2].sum(axis=1)).max() < 5e-3
    both = run.measurements.support == "double"
    assert np.abs(forces[both][..., :2]).max() > 1.0  # else nothing would have to cancel


def test_their_center_of_pressure_is_below_mujocos_center_of_mass(run, robot):
    forces, moments = (part.sum(axis=1) for part in grounded(robot, run.measurements, run.truth.zeros))
    pressure = np.column_stack([-moments[:, 1], moments[:, 0]]) / forces[:, 2:]
    data, chain = mujoco.MjData(robot.model), ClosedChain(robot.model, robot)
    rows = zip(pressure, run.measurements.joint_angles, run.measurements.support, strict=True)
    for found, angles, support in rows:
        data.qpos[:7] = chain.base_pose(angles, int(support == "left"))
        data.qpos[7:] = angles
        mujoco.mj_kinematics(robot.model, data)
        mujoco.mj_comPos(robot.model, data)
        np.testing.assert_allclose(found, data.subtree_com[1, :2], rtol=0, atol=2e-5)
    if run.truth.held:
        np.testing.assert_allclose(pressure, [held.com for held in run.truth.held], rtol=0, atol=2e-5)


@pytest.mark.parametrize("support", ["right", "left"])
def test_a_foot_in_the_air_reads_its_zero_minus_its_weight(run, robot, support):
    measured, side = run.measurements, int(support == "right")
    hanging = np.flatnonzero(measured.support == support)
    assert len(hanging) == 3
    data, chain = mujoco.MjData(robot.model), ClosedChain(robot.model, robot)
    foot = robot.model.body(robot.feet[side])
    for row in hanging:
        data.qpos[:7] = chain.base_pose(measured.joint_angles[row], 1 - side)
        data.qpos[7:] = measured.joint_angles[row]
        mujoco.mj_kinematics(robot.model, data)
        weight = data.body(foot.id).xmat.reshape(3, 3).T @ [0.0, 0.0, -foot.mass[0] * GRAVITY]
        assert abs(weight[0]) > 0.1  # N, tilted
        expected = np.concatenate([weight, np.cross(foot.ipos, weight)])
        np.testing.assert_allclose(measured.wrenches[row, side] - run.truth.zeros[side], expected, atol=2e-3)


@pytest.mark.parametrize("sticks", [False, True])
def test_mujocos_sensors_are_the_contacts_and_the_weight(robot, plan, sticks):
    """Summed up from `mj_contactForce`, the constant forces of dry friction and the weight."""
    rig = edited(foot_rig(robot, mounting=TILTED), heavy_foot)
    stand = Stand(rig, boards_under(rig, plan.foot_poses[:1])[0])
    put_down(stand, plan.joint_angles[0])
    held, reason = hold(stand, plan.joint_angles[0])
    assert held is not None, reason
    model, data = stand.model, stand.data
    if not sticks:
        stand.stiction.release(data)
        stand.run(1.0)
    assert data.xfrc_applied.any() == sticks
    mujoco.mj_forward(model, data)
    assert np.linalg.norm(held.wrenches[0, :2]) > 1.0
    for side, foot in enumerate(robot.feet):
        body = model.body(foot).id
        turn = data.xmat[body].reshape(3, 3)
        rolled, pitched, yawed = (np.array([np.cos(a), np.sin(a)]) for a in TILTED[3:])
        (cr, sr), (cp, sp), (cy, sy) = rolled, pitched, yawed
        about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        axes = turn @ about_z @ about_y @ about_x
        origin = data.xpos[body] + turn @ TILTED[:3]
        force, moment, touching = np.zeros(3), np.zeros(3), 0
        for k, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]].tolist()
            if body not in bodies:
                continue
            local = np.zeros(6)
            mujoco.mj_contactForce(model, data, k, local)
            # The force is that of the first geom on the second one, along the frame's rows.
            push = contact.frame.reshape(3, 3).T @ local[:3] * (1 if bodies[1] == body else -1)
            force += push
            moment += np.cross(contact.pos - origin, push)
            touching += 1
        assert touching >= 3
        for at, push in (
            (data.xipos[body], data.xfrc_applied[body, :3]),
            (data.xipos[body], np.array([0.0, 0.0, -model.body_mass[body] * GRAVITY])),
        ):
            force += push
            moment += np.cross(at - origin, push)
        moment += data.xfrc_applied[body, 3:]
        expected = np.concatenate([axes.T @ force, axes.T @ moment])
        np.testing.assert_allclose(stand.wrenches()[side], expected, atol=2e-3)


def test_a_sensor_carries_all_that_hangs_on_its_foot():
    """A foot of two links in the air, against moments by hand; the sensor stands on its head."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -10]
    leg = spec.worldbody.add_body(name="leg")
    leg.add_geom(size=[0.1], mass=5)
    foot = leg.add_body(name="foot", pos=[0, 0, -1])
    foot.add_geom(size=[0.1], mass=2, pos=[0.1, 0, 0])
    toe = foot.add_body(name="toe", pos=[0.3, 0, 0])
    toe.add_geom(size=[0.1], mass=1, pos=[0.1, 0, 0])
    add_foot_sensors(spec, ["foot"], (0.0, 0.0, 0.2, np.pi, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    reading = -data.sensordata[foot_addresses(model, ["foot"])][0]
    # 30 N down are up for the sensor; 0.1 m x 20 N + 0.4 m x 10 N pitch the foot, against its own y.
    np.testing.assert_allclose(reading, [0, 0, 30, 0, -6, 0], atol=1e-9)
    whole = np.array([0.0, 0, -30, 0, 6, 0])
    np.testing.assert_allclose(in_sensor_frame((0.0, 0.0, 0.2, np.pi, 0.0, 0.0), whole), reading, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    [
        "pulled by ropes",
        "heavy foot",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("as it is", "soft soles", "flexible drives")
        ),
    ],
)
def test_statics_reads_what_the_dynamics_read(robot, plan, name):
    """Every channel, for sensors that are mounted askew, without the joints' dry friction."""
    rigs = laboratories(foot_rig(robot, mounting=TILTED))
    rig = rigs[name] if name in rigs else edited(rigs["as it is"], heavy_foot)
    few = plan.take(np.arange(5, 8))
    found = compare(solve_plan(rig, few), list(run_dynamics(rig, few, 1).truth.attempts))
    assert len(found.held) == 3
    assert np.abs(found.wrenches[..., :3]).max() < 0.02  # N
    assert np.abs(found.wrenches[..., 3:]).max() < 0.004  # Nm


def test_with_dry_friction_forces_between_the_legs_scatter_alike(robot, mixed, dynamic):
    """Horizontal forces cannot be predicted, only their scatter (docs/studies/equilibrium.md)."""
    held = [a for a in dynamic.truth.attempts if a.held is not None and a.placement < 4]
    solved_plan = solve_plan(foot_rig(robot), mixed)
    actual, drawn = excess_wrenches(solved_plan, held, np.random.default_rng(301))
    assert np.abs(actual[..., :2]).max() > 0.3  # N
    ratio = drawn.std(axis=0) / actual.std(axis=0)
    assert (ratio > 0.3).all()
    assert (ratio < 3).all()
    for side in (0, 1):
        for k in range(6):
            assert ks_2samp(actual[:, side, k], drawn[:, side, k]).pvalue > 0.01 / 12


def test_readings_scatter_by_the_stated_covariance_about_constant_zeros(robot, plan):
    few = plan.take(plan.placement <= 4)
    runs = statics(foot_rig(robot, "foot-ft"), few, 60)
    errors = [run.measurements.wrenches - run.truth.wrenches - run.truth.zeros for run in runs]
    sd = np.sqrt(np.diag(runs[0].measurements.contacts.covariance))
    count = sum(len(error) for error in errors) * 2
    found = np.sqrt(sum((error**2).sum(axis=(0, 1)) for error in errors) / count)
    np.testing.assert_allclose(found / sd, 1, atol=5 / np.sqrt(2 * count))
    means = np.array([error.mean(axis=0) for error in errors]) * np.sqrt(len(few))
    assert (np.abs(means).max(axis=0) < 5 * sd).all()  # nothing else is constant in a run
    zeros = np.array([run.truth.zeros for run in runs])
    stated = np.array(SHEET.zero_sd)
    np.testing.assert_allclose(np.sqrt((zeros**2).mean(axis=(0, 1))) / stated, 1, atol=5 / np.sqrt(240))


def test_the_dynamics_read_through_the_same_sensors(robot, mixed, dynamic):
    """The held postures read again: s.d. as stated, zeros those of the experiment."""
    rig = foot_rig(robot, "foot-ft")
    again: list[Any] = [read_again(rig, mixed, dynamic, np.random.default_rng(seed)) for seed in range(10)]
    errors = np.array([m.wrenches - dynamic.truth.wrenches - dynamic.truth.zeros for m in again])
    sd = np.sqrt(np.diag(again[0].contacts.covariance))
    count = errors[..., 0].size
    np.testing.assert_allclose(np.sqrt((errors**2).mean(axis=(0, 1, 2))) / sd, 1, atol=5 / np.sqrt(2 * count))
    spread = again[0].wrenches_sd.mean(axis=(0, 1))
    expected = np.hypot(SHEET.noise, np.array(SHEET.resolution) / np.sqrt(12))
    np.testing.assert_allclose(spread, expected, rtol=0.02)


def test_the_covariance_is_that_of_the_data_sheet(robot, plan):
    (run,) = statics(foot_rig(robot, "foot-ft"), plan.take(np.arange(1)))
    contacts, samples = run.measurements.contacts, int(run.measurements.samples[0])
    assert samples == 3000
    for k, name in enumerate(WRENCH):
        sd = averaged_sd(SHEET.repeatability[k], SHEET.noise[k], SHEET.resolution[k], samples)
        assert contacts.covariance[k, k] == pytest.approx(sd**2), name
    assert np.count_nonzero(contacts.covariance) == 6


def test_measurements_say_what_a_user_knows_and_no_more(dynamic, static, robot):
    for run in (dynamic, static):
        m, zeros = run.measurements, run.truth.zeros
        assert zeros.shape == (2, 6)
        assert np.abs(zeros).min() > 0
        assert m.contacts.mount == "foot"
        assert m.contacts.channels == WRENCH
        assert np.isposinf(m.contacts.zero_sd).all()
        assert not m.contacts.pose.any()
        np.testing.assert_allclose(m.contacts.below, [[0.6, 0.03, 0, -0.035]] * 2, atol=1e-12)
        assert m.wrenches.shape == m.wrenches_sd.shape == (len(m), 2, 6)
        assert m.cell_forces.shape == m.cell_forces_sd.shape == (len(m), 0)
        assert m.cells.shape == (2, 0, 2)
        assert not m.plate_poses.any()
        assert m.plate_poses.shape == (len(m), 2, 3)
        assert not m.top_height.any()
        assert m.sensors.cell_sd is m.sensors.cell_resolution is m.sensors.placement_sd is None
        parts = [*vars(m).values(), *vars(m.contacts).values()]
        arrays = [part for part in parts if isinstance(part, np.ndarray) and part.dtype.kind == "f"]
        assert not any(np.isin(np.abs(part), np.abs(zeros)).any() for part in arrays)


def test_what_is_below_is_stated_of_the_nominal_foot(robot, mixed):
    """A heavier foot hangs heavier on its sensor; the stated one stays the drawing's."""
    plain = foot_rig(robot, "foot-ft")
    (run,) = statics(edited(plain, heavy_foot), mixed)
    hanging = run.measurements.support == "right"
    force = np.linalg.norm(run.truth.wrenches[hanging, 1, :3], axis=1)
    np.testing.assert_allclose(force, 0.9 * GRAVITY, atol=1e-9)
    contacts = run.measurements.contacts
    np.testing.assert_allclose(contacts.below[:, 0], 0.6)
    np.testing.assert_allclose(contacts.below_sd, [[0.012, 0.002, 0.002, 0.002]] * 2)


def test_a_robot_it_is_told_of_hangs_on_the_sensors(robot, mixed):
    """Twice the masses, twice the readings: links that statics is given by run."""
    solved_plan = solve_plan(foot_rig(robot), mixed)
    m = solved_plan.mechanism
    standard = np.column_stack([m.mass, m.mass[:, None] * m.center])[solved_plan.links]
    foot = [m.bodies[k].name for k in solved_plan.links].index("left_foot")
    heavier = standard.copy()
    heavier[foot] *= 2
    run: Any = run_statics(solved_plan, [np.random.SeedSequence(6)], heavier[None])[0]
    hanging = run.measurements.support == "right"
    force = np.linalg.norm(run.truth.wrenches[hanging, 1, :3], axis=1)
    np.testing.assert_allclose(force, 1.2 * GRAVITY, atol=1e-9)


def test_what_changes_during_the_experiment_changes_the_wrenches(robot, plan):
    def heavier(spec: mujoco.MjSpec) -> None:
        spec.body("torso").mass += 1.0

    few = plan.take(plan.placement <= 4)
    rig = from_then_on(foot_rig(robot), 0.5, lambda one: edited(one, heavier))
    (run,) = statics(rig, few)
    down = run.truth.wrenches[..., 2].sum(axis=1)
    np.testing.assert_allclose(down[-1] - down[0], GRAVITY, atol=1e-4)  # soles tilt by microradians


def test_runs_are_the_same_bits_however_they_are_grouped(robot, plan):
    solved_plan = solve_plan(foot_rig(robot, "foot-ft"), plan.take(plan.placement <= 2))
    streams = np.random.SeedSequence(5).spawn(3)
    together: list[Any] = list(run_statics(solved_plan, streams))
    for run, stream in zip(together, streams, strict=True):
        alone: Any = run_statics(solved_plan, [stream])[0]
        assert np.array_equal(alone.measurements.wrenches, run.measurements.wrenches)
        assert np.array_equal(alone.truth.zeros, run.truth.zeros)
    assert not np.array_equal(together[0].truth.zeros, together[1].truth.zeros)


def test_a_tared_sensor_has_no_zeros(robot, plan):
    rig = foot_rig(robot, zero_sd=(0.0,) * 6)
    (run,) = statics(rig, plan.take(np.arange(2)))
    assert not run.measurements.contacts.zero_sd.any()
    np.testing.assert_allclose(run.measurements.wrenches, run.truth.wrenches, atol=1e-9)
    assert not draw_zeros(WrenchSensors(), np.random.default_rng(1)).any()


def test_the_sensors_do_not_change_how_the_robot_stands(robot, plan):
    one = plan.take(np.arange(1))
    plates, feet = (run_dynamics(preset_rig(name, robot), one, 5).truth for name in ("ideal", "foot-ideal"))
    assert plates.wrenches is plates.zeros is None
    assert np.array_equal(plates.held[0].cell_forces, feet.held[0].cell_forces)
    assert np.array_equal(plates.held[0].joint_angles, feet.held[0].joint_angles)
    for name in ("wii", "force-plate", "ideal"):
        assert PRESETS[name].wrench is None


@pytest.mark.parametrize("engine", ["statics", "dynamics"])
def test_a_laboratory_takes_the_preset(robot, plan, engine):
    few = plan.take(np.arange(2))
    run: Any = Laboratory(robot, sensors="foot-ft").run(few, seed=2, engine=engine, workers=1)
    assert run.measurements.wrenches.shape == (len(run.measurements), 2, 6)
    assert run.measurements.sensors.encoder_sd == pytest.approx(1e-4, rel=0.05)


def test_the_truth_file_knows_zeros_and_wrenches(robot, plan):
    run: Any = Laboratory(robot, sensors="foot-ft").run(plan.take(np.arange(2)), engine="statics")
    document: Any = SimulatedTruth.of(run).to_json()
    assert np.array_equal(document["zeros"], run.truth.zeros)
    assert np.array_equal(document["wrenches"], run.truth.wrenches)
    assert document["configuration"]["sensors"]["wrench"]["zero_sd"] == list(SHEET.zero_sd)


def test_the_composer_refuses_them(robot, plan):
    with pytest.raises(InputError, match="rig: found wrench sensors, expected plates on cells"):
        laboratory_environment(preset_rig("foot-ft", robot), plan.joint_angles[0])


def test_a_folder_holds_what_they_read_and_not_the_truth(tmp_path, robot):
    folder, truth = tmp_path / "data", tmp_path / "truth.json"
    arguments = ["--engine", "statics", "--sensors", "foot-ft", "--seed", "4", "--out", str(folder)]
    assert main(["simulate", *arguments, "--truth", str(truth)]) == 0
    read: Any = read_measurements(folder, robot)
    known = json.loads(truth.read_text())
    error = read.wrenches - np.array(known["wrenches"]) - np.array(known["zeros"])
    sd = np.sqrt(np.diag(read.contacts.covariance))
    np.testing.assert_allclose(error.std(axis=(0, 1)) / sd, 1, atol=5 / np.sqrt(4 * len(read)))
    assert np.isposinf(read.contacts.zero_sd).all()
    np.testing.assert_allclose(read.contacts.below, [[0.6, 0.03, 0, -0.035]] * 2, atol=1e-12)
    text = (folder / "manifest.json").read_text()
    assert not any(f"{abs(zero):.6g}" in text for zero in np.ravel(known["zeros"]))
