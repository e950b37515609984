"""The laboratory against statics: it may not know the answer, but it must not contradict it."""

import dataclasses

import mujoco
import numpy as np
import pytest

from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.sim.dynamics import dynamic_run as laboratory
from tulip_testbed.sim.dynamics.balance import balance_of
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics, run_placement
from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.outcome import dropped_postures
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.sensors import PRESETS, averaged_sd


def test_the_centre_of_pressure_is_the_com(ideal):
    lying = np.array([attempt.true_plates for attempt in ideal.simulation.measured])
    placed = dataclasses.replace(ideal.measurements, plate_poses=lying)
    truth = np.array([held.com for held in ideal.simulation.held])
    for measured, most in ((placed, 2e-6), (ideal.measurements, 5e-5)):
        assert np.sqrt(((center_of_pressure(measured) - truth) ** 2).mean()) < most


def test_results_do_not_depend_on_workers(robot, plan):
    part = plan.take(np.flatnonzero(plan.placement <= 2)[[0, 1, 5, 6]])
    rig = preset_rig("wii", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=2))
    first, second = (run_dynamics(rig, part, 3, workers) for workers in (1, 2))
    for name in ("joint_angles", "cell_forces", "plate_poses", "motor", "time"):
        assert getattr(first.measurements, name).tobytes() == getattr(second.measurements, name).tobytes()
    other = run_dynamics(rig, part.take([0]), 4, 1)
    assert not np.array_equal(first.measurements.cell_forces[0], other.measurements.cell_forces[0])
    # Two postures were measured twice, with another reading and another time.
    assert sum(attempt.repeat for attempt in first.truth.attempts) == 2


@pytest.mark.slow
def test_gated_hold_reads_what_the_full_minute_reads(rig, plan, monkeypatch):
    """20 postures from the same state: means differ by less than 1e-3 of a reading's s.d. (preset wii)."""
    sensors = PRESETS["wii"]
    samples = round(30 * sensors.sample_rate)
    angle_sd = averaged_sd(
        sensors.encoder_repeatability, sensors.encoder_noise, sensors.encoder_resolution, samples
    )
    force_sd = averaged_sd(sensors.cell_repeatability, sensors.cell_noise, sensors.cell_resolution, samples)
    pairs = []

    def hold_twice(stand, planned):
        model, before = stand.model, mujoco.MjData(stand.model)
        mujoco.mj_copyData(before, model, stand.data)
        minute = dataclasses.replace(stand.protocol, gated=False)
        gated = hold(stand, planned)
        mujoco.mj_copyData(stand.data, model, before)
        stand.stiction.forget()
        stand.protocol, protocol = minute, stand.protocol
        full = hold(stand, planned)
        stand.protocol = protocol
        assert stand.data.time - before.time > 60.0
        pairs.append((gated[0], full[0]))
        return full

    monkeypatch.setattr(laboratory, "hold", hold_twice)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    run_dynamics(rig, plan.take(plan.placement <= 4), 131)
    held = [(gated, full) for gated, full in pairs if gated is not None and full is not None]
    assert len(held) == 20
    for gated, full in held:
        assert np.abs(gated.joint_angles - full.joint_angles).max() < 1e-3 * angle_sd
        assert np.abs(gated.cell_forces - full.cell_forces).max() < 1e-3 * force_sd


def test_the_books_are_closed_in_every_run(ideal, moved_wii):
    for result in (ideal, moved_wii):
        books = [held.balance for held in result.simulation.held]
        assert max(abs(b.weight) for b in books) < 1e-3
        assert max(b.moments for b in books) < 1e-4
        assert max(b.torques for b in books) < 1e-6
        assert max(b.centre for b in books) < 1e-7
        assert min(b.dissipated for b in books) > 0
        assert max(b.kinetic for b in books) < 1e-12


def test_the_books_show_a_cell_that_stands_elsewhere_and_a_foreign_force(rig, plan):
    """10 mm under one cell, and 1 N that nobody accounts for."""

    def shift(spec: mujoco.MjSpec) -> None:
        spec.site("right_plate_front_left").pos[0] += 0.01

    plates = run_placement(rig, plan, 1, frozenset(), np.random.SeedSequence(1))[0].true_plates
    stand = Stand(dataclasses.replace(rig, edit=shift), plates)
    put_down(stand, plan.joint_angles[0])
    held, _ = hold(stand, plan.joint_angles[0])
    assert held is not None
    assert held.balance.moments == pytest.approx(0.01 * held.cell_forces[0], rel=1e-4)
    assert held.balance.torques < 1e-6
    stand.data.xfrc_applied[stand.torso, 2] += 1.0
    stand.run(0.5)
    assert balance_of(stand, 0.0).weight == pytest.approx(-1.0, abs=0.01)
    assert balance_of(stand, 0.0).torques > 0.5
    stand.data.xfrc_applied[stand.torso, :3] = [1.0, 0.0, 0.0]
    stand.run(0.5)
    assert balance_of(stand, 0.0).torques > 0.5
    assert balance_of(stand, 0.0).centre > 1e-3


def test_a_posture_beyond_the_feet_tips_and_one_pushed_slips(rig, plan):
    def ice(spec: mujoco.MjSpec) -> None:
        for pair in spec.pairs:
            pair.friction[:2] = 0.05

    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    leaning = plan.take(np.arange(3))
    angles = leaning.joint_angles.copy()
    angles[1:, [4, 10]] += 0.3  # both ankles pitch the robot forward
    leaning = dataclasses.replace(leaning, joint_angles=angles)
    attempts = run_placement(rig, leaning, 1, frozenset(), np.random.SeedSequence(1))
    assert [attempt.reason for attempt in attempts[1:]] == ["tipped", "tipped"]
    slippery = dataclasses.replace(rig, edit=ice)
    attempts = run_placement(slippery, plan, 1, frozenset(), np.random.SeedSequence(1))
    assert any(attempt.reason.startswith("slipped") for attempt in attempts)


def test_a_posture_whose_repeat_could_be_used_is_not_dropped(ideal):
    """As the preflight counts: a posture is there if any of its rows is."""
    truth = ideal.simulation
    repeated = next(a.posture for a in truth.attempts if a.repeat and a.held)
    attempts = tuple(
        dataclasses.replace(a, held=None, reason="tipped") if a.posture == repeated and not a.repeat else a
        for a in truth.attempts
    )
    dropped = dropped_postures(attempts)
    assert repeated not in [posture for posture, _ in dropped]
    assert dropped == truth.dropped
