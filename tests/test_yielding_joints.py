"""Joints that yield or have play, in laboratories with friction: sizes, loads and what no reading shows."""

import dataclasses

import numpy as np
import pytest

from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.joint import LEAST_STIFFNESS
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe

STANCE_LEG, SWING_LEG = "right_ankle_roll", "left_ankle_pitch"


def one_effect(robot, plan, label, size, preset="force-plate", seed=1002):
    name, _, target = label.partition(":")
    effect = EffectInstance(catalogue()[name], target, (size,))
    run = Laboratory(robot, preset, hidden=(effect,)).run(plan, seed, "statics")
    return effect, observe(run.measurements, nominal_robot(robot))


QUICK = [(f"joint-compliance:{SWING_LEG}", 0.0015), (f"backlash:{STANCE_LEG}", 0.006)]
SLOW = [(f"joint-compliance:{STANCE_LEG}", 0.0015), (f"backlash:{SWING_LEG}", 0.003)]
SLOW += [("rocking:left.rear_left", 0.0003)]


@pytest.mark.parametrize(
    ("label", "size"), [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)]
)
@pytest.mark.parametrize("preset", ["force-plate", pytest.param("wii", marks=pytest.mark.slow)])
def test_what_yields_is_sized(robot, plan, label, size, preset):
    effect, observed = one_effect(robot, plan, label, size, preset)
    found = self_calibrate(observed, effects=[effect])
    ((value,), (error,)) = found.effects[0].values, found.effect_errors[0]
    assert abs(value - size) < 4 * error
    assert error < 0.12 * size


def test_a_compliant_hip_is_not_surer_than_the_unseen_forces_allow(robot, plan):
    """The wrench between the feet loads a hip; friction opposes it alike in like postures."""
    effect, observed = one_effect(robot, plan, "joint-compliance:right_hip_roll", 0.0015)
    found = self_calibrate(observed, effects=[effect])
    error = found.effect_errors[0][0]
    assert abs(found.effects[0].values[0] - 0.0015) < 2 * error
    assert error < 0.3 * 0.0015


def test_a_leg_s_loads_come_from_its_own_foot(robot, plan):
    """So they hardly depend on the angle by which a joint yields."""
    m = Laboratory(robot, "ideal").run(plan, seed=1003, engine="statics").measurements
    observed = observe(m, nominal_robot(robot))
    servos = observed.servo_stiffness * (m.command - m.joint_angles)
    for joint in (STANCE_LEG, SWING_LEG):
        at = m.joints.index(joint)
        # What the servos bear but for friction is another route to the load.
        assert np.abs(observed.torques[:, at] + servos[:, at]).max() < 2.0
        turned = observed.joint_angles.copy()
        turned[:, at] += 0.01
        change = observed.changed(joint_angles=turned).torques[:, at] - observed.torques[:, at]
        assert np.abs(change).max() < 0.01 * 0.15 * observed.weight  # the ankle's height over the floor
    assert observed.loads.doubt.shape == observed.torques.shape
    single = dataclasses.replace(m, support=np.full(len(m), "right"))
    alone = observe(single, observed.nominal).loads
    assert not alone.levers.any()
    assert (
        alone.doubt[:, m.joints.index(STANCE_LEG)] > 0.1
    ).all()  # the point of the load is uncertain there too


def test_where_a_link_rests_in_its_play_is_a_clipped_normal(robot, plan):
    rng = np.random.default_rng(7)
    few = plan.take(plan.placement <= 3)
    m = Laboratory(robot, "wii").run(few, seed=1004, engine="statics").measurements
    observed = observe(m, nominal_robot(robot))
    at, half = m.joints.index("left_hip_yaw"), 0.002
    loads = observed.loads
    torque = loads.torques[:, at] + loads.doubt[:, at] * rng.standard_normal((40_000, len(m)))
    rest = np.clip(torque / np.maximum(loads.stiffness[:, at], LEAST_STIFFNESS), -half, half)
    play = catalogue()["backlash"]
    mean = play.remove(observed, "left_hip_yaw", (2 * half,)).joint_angles - observed.joint_angles
    assert mean[:, at] == pytest.approx(rest.mean(axis=0), abs=0.03 * half)
    assert play.mechanism.unsure is not None
    off = play.mechanism.unsure(observed, "left_hip_yaw", (2 * half,)).joint_angles - observed.joint_angles
    assert (off - mean)[:, at] == pytest.approx(rest.std(axis=0), abs=0.03 * half)
    assert not np.delete(off, at, axis=1).any()


def test_the_noise_of_cells_without_a_sheet_counts_too(robot, plan):
    few = plan.take(plan.placement <= 6)
    m = Laboratory(robot, "wii").run(few, seed=1005, engine="statics").measurements
    sheet = dataclasses.replace(m.sensors, cell_sd=None)
    observed = observe(dataclasses.replace(m, sensors=sheet), nominal_robot(robot))
    assert observed.cell_sd == 0
    assert self_calibrate(observed).observed.cell_sd == pytest.approx(m.sensors.cell_sd, rel=0.3)
