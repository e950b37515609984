"""The laboratory against statics: it may not know the answer, but it must not contradict it."""

import dataclasses

import mujoco
import numpy as np
import pytest

from identification.center_of_pressure import center_of_pressure
from identification.kinematics import link_rotations
from sim.hold import Stand
from sim.laboratory import run_experiment, run_placement
from sim.measurements import lay_boards
from sim.model import sole_corners
from sim.path import closed_path
from sim.plates import tare
from sim.rig import preset_rig
from sim.scene import load_scene
from sim.sensors import PRESETS, averaged_sd, sample
from tests.conftest import part_of


def test_centre_of_pressure_is_the_com_within_0_05_mm(ideal):
    truth = np.array([held.com for held in ideal.experiment.held])
    error = center_of_pressure(ideal.experiment.measurements) - truth
    assert 1e3 * np.sqrt((error**2).mean()) < 0.05


def test_with_the_plates_as_they_lie_it_is_the_com_within_2_um(ideal):
    """What is left above is feet that moved a little since the plates were measured."""
    lying = np.array([attempt.true_plates for attempt in ideal.experiment.measured])
    placed = dataclasses.replace(ideal.experiment.measurements, plate_poses=lying)
    truth = np.array([held.com for held in ideal.experiment.held])
    assert 1e6 * np.sqrt(((center_of_pressure(placed) - truth) ** 2).mean()) < 2


def test_forces_balance_within_0_01_n(ideal):
    total = ideal.experiment.measurements.cell_forces.sum(axis=1)
    assert np.abs(total - 23.0 * 9.81).max() < 0.01


def test_stance_foot_stays_flat_and_the_chain_closed(ideal, parameters, plan):
    """Closure of the legs from the true angles: the swing sole stays level with the stance sole."""
    angles = np.array([held.joint_angles for held in ideal.experiment.held])
    tree = parameters.tree
    swing = link_rotations(tree, parameters.base, angles)[:, tree.frame("left_foot")]
    assert np.abs(swing[:, 2, :2]).max() < 1e-3


def test_gravity_sag_is_there_and_follows_the_torque(ideal):
    held = ideal.experiment.held
    sag = np.array([h.commanded - h.joint_angles for h in held])
    torque = np.array([h.torques for h in held])
    assert 1e-3 < np.median(np.abs(sag)) < 2e-2
    limit = np.array(
        [25.4 if j in (2, 3) else 17.0 if j == 4 else 15.1 if j == 1 else 10.1 for j in range(6)] * 2
    )
    assert torque == pytest.approx(sag * limit / 0.02, abs=0.05)


def test_results_do_not_depend_on_workers(robot, plan):
    part = part_of(plan, plan.placement <= 2)
    rig = preset_rig("wii", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=2))
    first, second = (run_experiment(rig, part, 3, workers) for workers in (1, 2))
    for name in ("joint_angles", "cell_forces", "plate_poses", "motor", "time"):
        assert getattr(first.measurements, name).tobytes() == getattr(second.measurements, name).tobytes()
    other = run_experiment(rig, part, 4, 1)
    assert not np.array_equal(first.measurements.cell_forces, other.measurements.cell_forces)
    # Two postures were measured twice, with another reading and another time.
    assert sum(attempt.repeat for attempt in first.attempts) == 2


def test_gated_hold_reads_what_the_full_minute_reads(robot, plan):
    """Friction rows creep by up to 0.5 mrad a minute; forces and angles creep together."""
    part = part_of(plan, np.arange(2))
    rig = preset_rig("ideal", robot)
    protocol = dataclasses.replace(rig.protocol, repeats=0)
    full = dataclasses.replace(protocol, gated=False)
    gated, minute = (run_experiment(dataclasses.replace(rig, protocol=p), part, 1) for p in (protocol, full))
    assert gated.measurements.joint_angles == pytest.approx(minute.measurements.joint_angles, abs=5e-4)
    for experiment in (gated, minute):
        truth = np.array([held.com for held in experiment.held])
        assert 1e3 * np.abs(center_of_pressure(experiment.measurements) - truth).max() < 0.1
        assert experiment.measurements.window.tolist() == [30.0, 30.0]


def test_a_posture_beyond_the_feet_tips_and_one_pushed_slips(robot, plan):
    def ice(spec: mujoco.MjSpec) -> None:
        for pair in spec.pairs:
            pair.friction[:2] = 0.1

    rig = preset_rig("ideal", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    leaning = part_of(plan, np.arange(3))
    angles = leaning.joint_angles.copy()
    angles[1:, [4, 10]] += 0.3  # both ankles pitch the robot forward
    leaning = dataclasses.replace(leaning, joint_angles=angles)
    attempts = run_placement(rig, leaning, 1, frozenset(), np.random.SeedSequence(1))
    assert [attempt.reason for attempt in attempts[1:]] == ["tipped", "tipped"]
    slippery = dataclasses.replace(rig, edit=ice)
    attempts = run_placement(slippery, plan, 1, frozenset(), np.random.SeedSequence(1))
    assert any(attempt.reason.startswith("slipped") for attempt in attempts)


def test_tare_is_the_boards_weight(robot, model, plan):
    soles = np.array([sole_corners(model, foot)[:, :2] for foot in robot.feet])
    soles[1] += [0.0, 0.2]
    stand = Stand(preset_rig("ideal", robot), lay_boards(soles, np.array([0.5, 0.3]), 0.01))
    assert stand.tare == pytest.approx(np.full(8, 3.5 * 9.81 / 4), abs=1e-6)
    assert stand.tare == pytest.approx(tare(stand.model))


def test_known_weight_at_a_known_place_is_read_by_the_four_cells(robot):
    """A lever rule on one plate: 10 kg at 40 mm forward, 30 mm left of its centre."""
    spec = load_scene(robot)
    spec.delete(spec.body("torso"))
    for key in list(spec.keys):
        spec.delete(key)
    load = spec.body("right_plate").add_body(name="load", pos=[0.04, 0.03, 0.05])
    load.mass, load.ipos, load.inertia, load.explicitinertial = 10.0, [0, 0, 0], [1e-3] * 3, True
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    forces = np.array(
        [
            data.sensor(f"right_plate_{c}").data[0]
            for c in ("front_left", "front_right", "rear_right", "rear_left")
        ]
    )
    forces -= 3.5 * 9.81 / 4
    x, y = 0.2165, 0.119
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    expected = 98.1 / 4 * (1 + signs[:, 0] * 0.04 / x + signs[:, 1] * 0.03 / y)
    assert forces == pytest.approx(expected, abs=1e-3)


def test_paths_keep_the_feet(robot, model, parameters, plan):
    path = closed_path(model, robot, plan.joint_angles[0], plan.joint_angles[1], 50)
    tree = parameters.tree
    swing = link_rotations(tree, parameters.base, path)[:, tree.frame("left_foot")]
    assert swing == pytest.approx(np.tile(swing[-1], (50, 1, 1)), abs=1e-6)
    assert path[-1] == pytest.approx(plan.joint_angles[1])
    assert np.abs(np.diff(path, axis=0)).max() < 0.2


def test_sampled_readings_have_the_stated_spread():
    """4000 postures: the s.d. of an s.d. is 1.1 %; 4 s.d. is 4.5 %."""
    rng = np.random.default_rng(8)
    truth = rng.uniform(0, 1, 4000)
    mean, sd = sample(truth, 0.3, 2.0, 0.0, 400, rng)
    assert (mean - truth).std() == pytest.approx(averaged_sd(0.3, 2.0, 0.0, 400), rel=0.045)
    assert sd.mean() == pytest.approx(2.0, rel=0.01)
    still, none = sample(truth, 0.0, 0.0, 0.01, 10, rng)
    assert (still - truth).std() == pytest.approx(averaged_sd(0.0, 0.0, 0.01, 10), rel=0.045)
    assert none.max() < 1e-12


def test_presets_hold_no_systematic_effect():
    assert all(sensors.cell_gain == {} for sensors in PRESETS.values())
    assert averaged_sd(0.0, 0.0, 0.0, 3000) == 0.0
