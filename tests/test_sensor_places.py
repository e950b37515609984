"""Wrench sensors on the ground and in the soles: readings against cells, contact forces and statics."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_equilibrium import compare, laboratories
from tulip_testbed.effects.instance import removed
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements import read_measurements, write_measurements
from tulip_testbed.measurements.contacts import VERTICAL, WRENCH
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

NAMES = ("plate-ft", "plate-cop", "sole-ft", "sole-3axis")
GRAVITY = 9.81


def exact_rig(robot: Robot, name: str) -> Rig:
    """Return a preset's laboratory with exact encoders and records, and sensors that err by zeros alone."""
    wrench: Any = PRESETS[name].wrench
    sensors = dataclasses.replace(PRESETS["ideal"], wrench=wrench.exact)
    return dataclasses.replace(preset_rig(name, robot), sensors=sensors)


def exact(robot: Robot, name: str) -> tt.Laboratory:
    """Return the laboratory of `exact_rig`."""
    return tt.Laboratory(robot, name, nominal=exact_rig(robot, name))


@pytest.fixture(scope="module")
def mixed_few() -> Any:
    """Both feet and each foot alone, 28 postures."""
    plan = tt.plans.mixed
    return plan.take(np.isin(plan.placement, np.unique(plan.placement)[::4]))


@pytest.fixture(scope="module")
def static(robot, mixed_few) -> dict[str, Any]:
    """The same equilibria by four ideal cells and by every exact sensor."""
    runs: dict[str, Any] = {name: exact(robot, name).run(mixed_few, 3, "statics") for name in NAMES}
    return runs | {"ideal": tt.Laboratory(robot, "ideal").run(mixed_few, 3, "statics")}


def frames(robot: Robot, measured: Any, side: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rotation and origin of a sensor's frame in the base frame by row.

    On the ground by the recorded pose of the plate, its top at height zero; in the foot by MuJoCo.
    """
    found, data = [], mujoco.MjData(robot.model)
    chain = ClosedChain(robot.model, robot)
    for row, angles in enumerate(measured.joint_angles):
        if measured.contacts.mount == "ground":
            x, y, yaw = measured.plate_poses[row, side]
            turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
            found.append((turn, np.array([x, y, 0.0])))
            continue
        data.qpos[:7] = chain.base_pose(angles, int(measured.support[row] == "left"))
        data.qpos[7:] = angles
        mujoco.mj_kinematics(robot.model, data)
        body = data.body(robot.feet[side])
        turn = body.xmat.reshape(3, 3).copy()
        found.append((turn, body.xpos + turn @ measured.contacts.pose[side, :3]))
    return found


def by_hand(robot: Robot, measured: Any, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weight and centre of pressure from the wrenches, (m,) [N] and (m, 2) [m].

    For sensors of three channels the horizontal forces are zero, as all that is known of them.
    """
    force, moment = np.zeros((2, len(measured), 3))
    kept = [WRENCH.index(channel) for channel in measured.contacts.channels]
    for side in (0, 1):
        for row, (turn, origin) in enumerate(frames(robot, measured, side)):
            wrench = np.zeros(6)
            wrench[kept] = measured.wrenches[row, side] - zeros[side]
            if np.isnan(wrench).any():
                continue  # in the air
            push = turn @ wrench[:3]
            force[row] += push
            moment[row] += turn @ wrench[3:] + np.cross(origin, push)
    return force[:, 2], np.column_stack([-moment[:, 1], moment[:, 0]]) / force[:, 2:]


def by_cells(measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the same from the cells of both plates at their recorded places."""
    moment = np.zeros((len(measured), 2))
    for side in (0, 1):
        forces = measured.cell_forces[:, 4 * side : 4 * side + 4]
        x, y, yaw = measured.plate_poses[:, side].T
        for k, (a, b) in enumerate(measured.cells[side]):
            place = np.array([x + a * np.cos(yaw) - b * np.sin(yaw), y + a * np.sin(yaw) + b * np.cos(yaw)])
            moment += (forces[:, k] * place).T
    total = measured.cell_forces.sum(axis=1)
    return total, moment / total[:, None]


@pytest.mark.parametrize("name", NAMES)
def test_every_sensor_says_what_four_ideal_cells_say(static, robot, name):
    cells, run = static["ideal"].measurements, static[name]
    assert np.array_equal(run.measurements.joint_angles, cells.joint_angles)
    assert set(cells.support) == {"double", "right", "left"}
    weight, pressure = by_hand(robot, run.measurements, run.truth.zeros)
    total, center = by_cells(cells)
    # A sole is tilted by microradians, so that a little of the unread horizontal force is missing.
    np.testing.assert_allclose(weight, total, rtol=0, atol=1e-4 if name == "sole-3axis" else 1e-6)
    np.testing.assert_allclose(pressure, center, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["plate-ft", "sole-ft"])
def test_horizontal_forces_of_both_feet_cancel_and_each_foot_has_some(static, robot, name):
    measured, zeros = static[name].measurements, static[name].truth.zeros
    forces = np.zeros((len(measured), 2, 2))
    for side in (0, 1):
        for row, (turn, _) in enumerate(frames(robot, measured, side)):
            forces[row, side] = (turn @ (measured.wrenches[row, side, :3] - zeros[side, :3]))[:2]
    tilted = 1e-6 if name == "plate-ft" else 5e-3  # N: microradians of the vertical force
    np.testing.assert_allclose(forces.sum(axis=1), 0.0, atol=tilted)
    both = measured.support == "double"
    assert np.abs(forces[both]).max() > 1.0
    np.testing.assert_allclose(forces[~both], 0.0, atol=tilted)


@pytest.mark.parametrize("name", ["plate-ft", "sole-ft"])
def test_a_foot_in_the_air_reads_its_zero(static, name):
    """A plate is tared, and a sole has nothing below it."""
    m, zeros = static[name].measurements, static[name].truth.zeros
    for side, support in enumerate(("left", "right")):
        air = m.wrenches[m.support == support, side]
        assert len(air) >= 5
        np.testing.assert_allclose(air, np.broadcast_to(zeros[side], air.shape), atol=1e-9)
    assert zeros.any() == (name == "sole-ft")


@pytest.mark.parametrize("place", ["plate-ft", "sole-ft"])
@pytest.mark.parametrize("sticks", [False, True])
def test_the_dynamics_sum_up_mujocos_contacts(robot, plan, place, sticks):
    """Each contact's force by `mj_contactForce` and what dry friction holds, in frames built by hand."""
    rig = exact_rig(robot, place)
    mounting = (0.0,) * 6 if place == "plate-ft" else (0.01, -0.02, 0.03, 0.0, 0.0, 0.4)
    sensors: Any = rig.sensors
    wrench = dataclasses.replace(sensors.wrench, mounting=mounting)
    rig = dataclasses.replace(rig, sensors=dataclasses.replace(sensors, wrench=wrench))
    stand = Stand(rig, boards_under(rig, plan.foot_poses[:1])[0] + [0.004, -0.006, 0.02])
    put_down(stand, plan.joint_angles[0])
    held, reason = hold(stand, plan.joint_angles[0])
    assert held is not None, reason
    model, data = stand.model, stand.data
    if not sticks:
        stand.stiction.release(data)
        stand.run(1.0)
    assert data.xfrc_applied.any() == sticks
    mujoco.mj_forward(model, data)
    for side, (foot, plate) in enumerate(zip(robot.feet, ("right_plate", "left_plate"), strict=True)):
        body = data.body(plate if place == "plate-ft" else foot)
        turn = body.xmat.reshape(3, 3)
        arm = [0.0, 0.0, 0.05] if place == "plate-ft" else [0.01, -0.02, 0.03 + sole_height(robot, foot)]
        origin = body.xpos + turn @ arm
        if place == "sole-ft":
            c, s = np.cos(0.4), np.sin(0.4)
            turn = turn @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        force, moment = np.zeros(3), np.zeros(3)
        foot_body = model.body(foot).id
        for k, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]].tolist()
            if foot_body not in bodies:
                continue
            local = np.zeros(6)
            mujoco.mj_contactForce(model, data, k, local)
            push = contact.frame.reshape(3, 3).T @ local[:3] * (1 if bodies[1] == foot_body else -1)
            force += push
            moment += np.cross(contact.pos - origin, push)
        held_by = data.xfrc_applied[foot_body]
        force += held_by[:3]
        moment += held_by[3:] + np.cross(data.xipos[foot_body] - origin, held_by[:3])
        assert force[2] > 50  # N, up: of the ground on the foot
        expected = np.concatenate([turn.T @ force, turn.T @ moment])
        np.testing.assert_allclose(stand.wrenches()[side], expected, atol=1e-6)


def sole_height(robot: Robot, foot: str) -> float:
    """Return the height of the sole's lowest points in the foot's frame, by its contact spheres [m]."""
    geom = robot.model.geom(f"{foot}_front_left")
    return float(geom.pos[2] - geom.size[0])


@pytest.mark.parametrize("kind", ["as it is", "soft soles"])
@pytest.mark.parametrize("name", ["plate-ft", "sole-ft"])
def test_statics_reads_what_the_dynamics_read(robot, plan, name, kind):
    """Every channel, without the joints' dry friction."""
    few, rig = plan.take(np.arange(5, 7)), laboratories(exact_rig(robot, name))[kind]
    found = compare(solve_plan(rig, few), list(run_dynamics(rig, few, 1).truth.attempts))
    assert len(found.held) >= 2
    assert np.abs(found.wrenches[..., :3]).max() < 0.02  # N
    assert np.abs(found.wrenches[..., 3:]).max() < 0.004  # Nm


@pytest.mark.parametrize("name", ["plate-ft", "plate-cop"])
def test_exact_plates_recover_every_parameter_of_the_shipped_plan(robot, name):
    laboratory = exact(robot, name)
    run = laboratory.run(tt.plans.random, 5, "statics")
    found = identify(run.measurements, robot)
    error = found.full.value - laboratory.true_base_parameters(run.plan)
    assert np.abs(error).max() < 1e-4  # m


@pytest.mark.parametrize("name", ["sole-ft", pytest.param("sole-3axis", marks=pytest.mark.slow)])
def test_exact_soles_recover_all_that_their_zeros_leave(robot, name):
    """On both feet alone the same five directions are hidden as in the ankles; on the mixed plan none."""
    laboratory = exact(robot, name)
    run = laboratory.run(tt.plans.random, 5, "statics")
    found = identify(run.measurements, robot)
    assert len(found.confounded) == 5
    along = np.linalg.qr(found.confounded.T)[0]
    error = found.full.value - laboratory.true_base_parameters(run.plan)
    assert np.abs(error - along @ (along.T @ error)).max() < 1e-3
    run = laboratory.run(tt.plans.mixed, 5, "statics")
    found = identify(run.measurements, robot)
    assert not len(found.confounded)
    error = found.full.value - laboratory.true_base_parameters(run.plan)
    assert np.abs(error).max() < 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_readings_scatter_as_the_data_sheet_says(robot, mixed_few, name):
    solved_plan = solve_plan(preset_rig(name, robot), mixed_few.take(np.arange(8)))
    runs: list[Any] = list(run_statics(solved_plan, np.random.SeedSequence(7).spawn(30)))
    contacts = runs[0].measurements.contacts
    assert contacts.mount == ("ground" if name.startswith("plate") else "foot")
    kept = [WRENCH.index(channel) for channel in contacts.channels]
    read = np.concatenate([run.measurements.wrenches for run in runs])
    true = np.concatenate([run.truth.wrenches[..., kept] for run in runs])
    if name == "plate-cop":
        read, true = (
            np.stack([-w[..., 2] / w[..., 0], w[..., 1] / w[..., 0], w[..., 0]], axis=-1)
            for w in (read, np.where(np.isnan(read), np.nan, true))
        )
        stated = contacts.cop_sd[0]
    else:
        true = true + np.repeat(
            [run.truth.zeros for run in runs], [len(run.measurements) for run in runs], axis=0
        )
        stated = np.sqrt(np.diag(contacts.covariance))
    found, count = np.sqrt(np.nanmean((read - true) ** 2, axis=(0, 1))), np.isfinite(read[..., 0]).sum()
    np.testing.assert_allclose(found / stated, 1, atol=5 / np.sqrt(2 * count))
    assert not contacts.below.any()
    if contacts.mount == "ground":
        assert not contacts.zero_sd.any()
        assert runs[0].measurements.sensors.placement_sd == PRESETS[name].placement_sd


def test_a_centre_of_pressure_is_written_as_one(tmp_path, robot, mixed_few):
    run: Any = tt.Laboratory(robot, "plate-cop").run(mixed_few, 7, "statics")
    measured: Any = run.measurements
    write_measurements(tmp_path / "data", measured)
    manifest = json.loads((tmp_path / "data" / "manifest.json").read_text())
    assert [entry["kind"] for entry in manifest["contacts"]] == ["cop", "cop"]
    columns = measured.columns()
    x, y, load = (columns[f"cop.right.{axis}"] for axis in ("x", "y", "fz"))
    assert np.array_equal(np.isnan(x), measured.support == "left")
    # On the plate of 0.5 m by 0.3 m, against the true wrench about its top.
    truth = run.truth.wrenches[measured.support != "left", 0]
    assert np.abs(x[~np.isnan(x)] + truth[:, 4] / truth[:, 2]).max() < 5 * 0.0015
    assert np.abs(y[~np.isnan(y)] - truth[:, 3] / truth[:, 2]).max() < 5 * 0.0015
    assert np.abs(load[~np.isnan(load)] - truth[:, 2]).max() < 5 * 4.5
    read: Any = read_measurements(tmp_path / "data")
    assert read.contacts.channels == VERTICAL
    np.testing.assert_allclose(read.wrenches, measured.wrenches, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(read.contacts.covariance, measured.contacts.covariance, rtol=1e-9)
    assert np.array_equal(read.contacts.cop_sd, measured.contacts.cop_sd)


@pytest.mark.parametrize("engine", ["statics", "dynamics"])
@pytest.mark.parametrize("name", NAMES)
def test_both_engines_hand_over_what_the_contract_takes(tmp_path, robot, plan, name, engine):
    run: Any = tt.Laboratory(robot, sensors=name).run(plan.take(np.arange(1)), 2, engine, workers=1)
    write_measurements(tmp_path / "data", run.measurements)
    read: Any = read_measurements(tmp_path / "data")
    np.testing.assert_allclose(read.wrenches, run.measurements.wrenches, rtol=1e-12, atol=1e-12)
    weight = read.wrenches[..., read.contacts.channels.index("fz")].sum(axis=1)
    zeros = run.truth.zeros[:, 0 if name == "sole-3axis" else 2].sum()
    np.testing.assert_allclose(weight - zeros, run.truth.mass * GRAVITY, atol=5 * 4.5 * np.sqrt(2))


@pytest.mark.parametrize("name", ["plate-ft", "plate-cop", "sole-ft"])
@pytest.mark.parametrize("effect", ["tilt=0.02,0.03", "tether=5,2"])
def test_a_push_is_removed_at_the_height_of_the_readings(robot, mixed_few, name, effect):
    """A plate's wrench is stated at its top, 50 mm over the floor on which cells stand."""
    few = mixed_few.take(mixed_few.support == "double")
    laboratory = exact(robot, name).with_effects(effect)
    nominal = nominal_robot(robot)
    pushed = laboratory.run(few, 3, "statics").measurements
    plain = exact(robot, name).run(few, 3, "statics").measurements
    clean = removed(observe(pushed, nominal), list(laboratory.hidden))
    left = residuals(clean, nominal.value)[:, :2].mean(axis=0)
    usual = residuals(observe(plain, nominal), nominal.value)[:, :2].mean(axis=0)
    assert np.abs(left - usual).max() < 2e-4
