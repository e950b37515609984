"""The nominal laboratory of an experiment, and its postures as a plan: to simulate the experiment again."""

from dataclasses import replace

import numpy as np

from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import swing_pose
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.sensors import ANKLE, PLATE, PRESETS, WrenchSensors
from tulip_testbed.sim.statics.read_mechanism import read_mechanism
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

STREAM = 0  # of friction and swaying


def exact_rig(observed: Observation) -> Rig:
    """Return the nominal laboratory of an experiment, with nothing random but friction."""
    rig = without_noise(preset_rig("ideal", observed.nominal.robot))
    if (contacts := observed.measurements.contacts) is None:
        return rig
    wrench = WrenchSensors(place=PLATE if contacts.mount == "ground" else ANKLE, channels=contacts.channels)
    return replace(rig, sensors=replace(rig.sensors, wrench=wrench))


def without_noise(rig: Rig) -> Rig:
    """Return a laboratory with nothing random but friction, and without repeats."""
    return replace(
        rig,
        sensors=PRESETS["ideal"],
        controller=replace(rig.controller, command_sd=0.0),
        protocol=replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0),
    )


def measured_plan(observed: Observation) -> PosturePlan:
    """Return the measured postures as a plan, one per row, with the torques that their commands exert there.

    The swing foot of each stance stands where the angles of its first posture put it. A command cannot tell
    that, because it contains the plan's feed-forward.
    """
    m = observed.measurements
    gain = read_mechanism(exact_rig(observed)).gain
    pose, rows = swing_pose(observed)[:, [0, 1, 5]], observed.geometry.on_swing_foot
    pose[rows] = observed.nominal.other_sole(observed.joint_angles, m.support)[rows]
    first = np.array([np.flatnonzero(observed.stance == number)[0] for number in observed.stance])
    return PosturePlan(
        joints=m.joints,
        joint_angles=observed.joint_angles,
        posture=np.arange(1, len(m) + 1),
        placement=observed.stance + 1,
        support=m.support,
        swing_pose=pose[first],
        robot={"model": m.robot["model"] or "", "sha256": m.robot["sha256"] or ""},
        torques=None if m.command is None else gain * (m.command - observed.joint_angles),
    )


def simulated(rig: Rig, plan: PosturePlan) -> Measurements:
    """Simulate a plan in a laboratory; every posture that has an equilibrium is measured."""
    run = run_statics(solve_plan(rig, plan), [np.random.SeedSequence(STREAM)], all_solved=True)[0]
    return run.measurements
