"""Springs, dead bands and lifting corners against their closed forms."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import within
from tulip_testbed.calibration.linearisation import LOOSE, sources_of
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import removed
from tulip_testbed.effects.joint import LEAST_STIFFNESS
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals, sensitivity
from tulip_testbed.measurements import lay_boards
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.drives import Drives, add_drives
from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import sole_corners
from tulip_testbed.sim.scene import load_scene

PENDULUM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="frame">
      <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
      <body name="arm">
        <joint name="arm" axis="0 1 0" armature="0.05" damping="0.5"/>
        <inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="arm" joint="arm" forcerange="-20 20"/></actuator>
</mujoco>"""


def standing(robot, model, plan, **changes) -> Stand:
    """The robot held at the plan's first posture in a changed laboratory."""
    soles = np.array([sole_corners(model, foot)[:, :2] for foot in robot.feet])
    soles[1] += plan.swing_pose[0, :2]
    rig = dataclasses.replace(preset_rig("ideal", robot), **changes)
    stand = Stand(rig, lay_boards(soles, np.array([0.5, 0.3]), 0.01))
    put_down(stand, plan.joint_angles[0])
    held, reason = hold(stand, plan.joint_angles[0])
    assert held is not None, reason
    return stand


def spring(stand: Stand, name: str) -> float:
    return float(stand.data.joint(name).qpos[0])


def test_a_sole_gives_way_by_its_load(robot, model, plan):
    stand = standing(robot, model, plan, compliance=Compliance(sole=1e-5, sole_tilt=5e-4))
    # The cells carry the foot's load; its moments about the centre of the sole tilt it.
    loads = stand.cell_forces().reshape(2, 4).sum(axis=1)
    mujoco.mj_rnePostConstraint(stand.model, stand.data)
    for foot, sole, load in zip(robot.feet, stand.soles, loads, strict=True):
        assert spring(stand, f"{foot}_sole_z") == pytest.approx(1e-5 * load, rel=1e-3)
        body = stand.data.body(sole)
        wrench, centre = stand.data.cfrc_ext[sole], stand.data.subtree_com[stand.torso]
        ankle = stand.data.body(foot)
        point = sole_corners(model, foot).mean(axis=0) + np.array([0, 0, spring(stand, f"{foot}_sole_z")])
        point = ankle.xpos + ankle.xmat.reshape(3, 3) @ point
        moment = body.xmat.reshape(3, 3).T @ (wrench[:3] + np.cross(centre - point, wrench[3:]))
        for k, way in enumerate(("roll", "pitch")):
            assert spring(stand, f"{foot}_sole_{way}") == pytest.approx(5e-4 * moment[k], rel=2e-3, abs=1e-7)


def test_a_cell_gives_way_by_its_reading(robot, model, plan):
    stand = standing(robot, model, plan, compliance=Compliance(cell=1e-6))
    loads = stand.cell_forces() + stand.tare
    for name, load in zip([f"{p}_plate_{c}" for p in ("right", "left") for c in CORNERS], loads, strict=True):
        assert spring(stand, f"{name}_cell_z") == pytest.approx(1e-6 * load, rel=1e-3)


@pytest.mark.parametrize("backlash", [0.0, 0.01])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_drive_winds_up_by_its_torque_and_half_its_backlash(side, backlash):
    spec = mujoco.MjSpec.from_string(PENDULUM)
    add_drives(spec, Drives(wind_up=0.02, backlash=backlash))
    pendulum = spec.compile()
    data = mujoco.MjData(pendulum)
    pendulum.opt.gravity[2] *= side
    pendulum.dof_armature[pendulum.joint("arm_motor").dofadr[0]] = 1e6  # a motor that holds still
    mujoco.mj_step(pendulum, data, 20_000)
    joint, motor = data.joint("arm").qpos[0], data.joint("arm_motor").qpos[0]
    torque = side * 2 * 9.81 * 0.2 * np.cos(joint)
    assert joint - motor == pytest.approx(torque * 0.02 / 20 + side * backlash / 2, rel=1e-3)


STANCE_LEG, SWING_LEG = "right_ankle_roll", "left_ankle_pitch"


def one_effect(robot, plan, label, size, preset="force-plate"):
    name, _, target = label.partition(":")
    effect = tt.EffectInstance(catalogue()[name], target, (size,))
    run = tt.Laboratory(robot, preset, hidden=(effect,)).run(plan, 1002, "statics")
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


def test_a_yielding_knee_is_sized_though_the_robot_sinks(robot, plan):
    """The formula of the knee alone is 8 % off: the whole robot sinks and shifts its load."""
    effect, observed = one_effect(robot, plan, "joint-compliance:right_knee", 0.0008, "ideal")
    assert self_calibrate(observed, effects=[effect]).effects[0].values[0] == pytest.approx(8e-4, rel=0.02)


def test_a_compliant_hip_is_not_surer_than_the_unseen_forces_allow(robot, plan):
    """The wrench between the feet loads a hip; friction opposes it alike in like postures."""
    effect, observed = one_effect(robot, plan, "joint-compliance:right_hip_roll", 0.0015)
    found = self_calibrate(observed, effects=[effect])
    error = found.effect_errors[0][0]
    assert abs(found.effects[0].values[0] - 0.0015) < 2 * error
    assert error < 0.3 * 0.0015


def test_a_leg_s_loads_come_from_its_own_foot(robot, plan):
    """So they hardly depend on the angle by which a joint yields."""
    m = tt.Laboratory(robot, "ideal").run(plan, seed=1003, engine="statics").measurements
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


@pytest.mark.parametrize(
    ("name", "sizes"), [("tether-spring", (150.0,)), ("tether", (6.0, 4.0)), ("tilt", (0.03, 0.03))]
)
def test_what_pulls_sideways_loads_the_legs(robot, plan, name, sizes):
    """The servos bear it: their errors are another route to the loads."""
    few = plan.take(plan.placement <= 3)
    pull = tt.EffectInstance(catalogue()[name], "", sizes)
    m = tt.Laboratory(robot, "ideal", hidden=(pull,)).run(few, 1003, "statics").measurements
    observed = observe(m, nominal_robot(robot))
    borne = -observed.servo_stiffness * (m.command - m.joint_angles)
    hips = [k for k, joint in enumerate(m.joints) if "hip" in joint]
    both = ((each.torques - borne)[:, hips] for each in (removed(observed, [pull]), observed))
    known, plain = (np.sqrt((off**2).mean()) for off in both)
    assert known < min(1.2, 0.75 * plain)


@pytest.mark.parametrize("plate", ["right", "left"])
def test_the_ground_resists_what_pulls_on_both_feet(robot, plan, plate):
    """Cells that read a part of the side force show it."""
    few = plan.take(plan.placement <= 3)
    pull = tt.EffectInstance(catalogue()["tether"], "", (6.0, 4.0))
    coupled = tt.EffectInstance(catalogue()["cell-side-force"], plate, (0.1, 0.1))
    with_both, alone = (
        tt.Laboratory(robot, "ideal", hidden=hidden).run(few, 1003, "statics").measurements
        for hidden in ((pull, coupled), (pull,))
    )
    observed = removed(observe(with_both, nominal_robot(robot)), [pull])
    taken_off = observed.cell_forces - removed(observed, [coupled]).cell_forces
    both = np.isin(with_both.posture, alone.posture), np.isin(alone.posture, with_both.posture)
    read = with_both.cell_forces[both[0]] - alone.cell_forces[both[1]]
    off = (taken_off[both[0]] - read).sum(axis=1)
    assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((read.sum(axis=1) ** 2).mean())


def test_where_a_link_rests_in_its_play_is_a_clipped_normal(robot, plan):
    rng = np.random.default_rng(7)
    few = plan.take(plan.placement <= 3)
    m = tt.Laboratory(robot, "wii").run(few, seed=1004, engine="statics").measurements
    observed = observe(m, nominal_robot(robot))
    at, half = m.joints.index("left_hip_yaw"), 0.002
    loads = observed.loads
    torque = loads.torques[:, at] + loads.doubt[:, at] * rng.standard_normal((40_000, len(m)))
    rest = np.clip(torque / np.maximum(loads.stiffness[:, at], LEAST_STIFFNESS), -half, half)
    play: Any = catalogue()["backlash"]
    mean = play.remove(observed, "left_hip_yaw", (2 * half,)).joint_angles - observed.joint_angles
    assert mean[:, at] == pytest.approx(rest.mean(axis=0), abs=0.03 * half)
    off = play.mechanism.unsure(observed, "left_hip_yaw", (2 * half,)).joint_angles - observed.joint_angles
    assert (off - mean)[:, at] == pytest.approx(rest.std(axis=0), abs=0.03 * half)
    assert not np.delete(off, at, axis=1).any()


@pytest.mark.parametrize(("joint", "most"), [("left_hip_roll", 0.8), ("left_ankle_roll", 1.0)])
def test_how_well_the_rest_in_a_play_is_known_is_estimated(robot, plan, joint, most):
    """The tilt of the swing foot shows where the link rests, encoders being ten times as exact."""
    effect, observed = one_effect(robot, plan, f"backlash:{joint}", 0.009)
    play: Any = effect.effect
    found = self_calibrate(observed, effects=[effect])
    scale = found.solved.scales[sources_of(observed).index(LOOSE)]
    at, theta, tilt = observed.tree.joints.index(joint), observed.nominal.value, slice(6, 8)
    clean = play.remove(observed, joint, effect.values)
    spread = play.unsure(observed, joint, effect.values).joint_angles - clean.joint_angles
    slope = sensitivity(observed, theta)[:, tilt, at]
    off = (residuals(clean, theta)[:, tilt] * slope).sum(axis=1) / (slope**2).sum(axis=1)
    unknown = spread[:, at] > 0.3 * 0.009 / 2
    shown = (off - np.median(off))[unknown] / spread[unknown, at]
    assert scale < most  # in an exact laboratory the load is known better than assumed
    assert scale == pytest.approx(shown.std(), rel=0.2)


def test_a_joint_on_the_ground_is_as_stiff_as_least_energy_says(robot, plan):
    """Turn each joint a little; the others give way as the closed legs allow (displacements, not forces)."""
    few = plan.take(plan.placement <= 1)
    m = tt.Laboratory(robot, "ideal").run(few, seed=1006, engine="statics").measurements
    observed, step = observe(m, nominal_robot(robot)), 1e-6
    servos, count = observed.servo_stiffness, len(m.joints)
    for row, angles in enumerate(m.joint_angles):
        sole = observed.nominal.swing_sole(angles + step * np.vstack([np.eye(count), -np.eye(count)]))
        jacobian = ((sole[:count] - sole[count:]) / (2 * step)).T
        # Servos deflect by s with the least energy among J (s + turn) = 0; each bears its stiffness times s.
        weighted = jacobian / servos
        push = np.linalg.solve(weighted @ jacobian.T, jacobian)
        torque = -servos[:, None] * (weighted.T @ push)
        assert observed.loads.held[row] == pytest.approx(-np.diag(torque), rel=1e-4)
    assert not observe(
        dataclasses.replace(m, support=np.full(len(m), "right")), observed.nominal
    ).loads.held.any()


def test_a_link_rests_anywhere_in_a_wide_play_while_it_bears_no_load(robot, plan):
    """Cheap cells do not tell a load of none from one that presses it to an end."""
    joint, width, tilt = STANCE_LEG, 0.0158, slice(6, 8)
    effect, seen = one_effect(robot, plan, f"backlash:{joint}", width, "wii")
    _, exact = one_effect(robot, plan, f"backlash:{joint}", width, "ideal")
    plain = observe(tt.Laboratory(robot, "ideal").run(plan, 1002, "statics").measurements, seen.nominal)
    some, others, rest = (one.measurements.posture for one in (seen, exact, plain))
    common = np.intersect1d(np.intersect1d(some, others), rest)
    seen, exact, plain = (o.take(np.isin(o.measurements.posture, common)) for o in (seen, exact, plain))
    at, theta = seen.tree.joints.index(joint), seen.nominal.value
    slope = sensitivity(exact, theta)[:, tilt, at]
    change = (residuals(exact, theta) - residuals(plain, theta))[:, tilt]
    rest = -(change * slope).sum(axis=1) / (slope**2).sum(axis=1)
    play: Any = effect.effect
    clean = play.remove(seen, joint, (width,))
    mean = (clean.joint_angles - seen.joint_angles)[:, at]
    sd = (play.unsure(seen, joint, (width,)).joint_angles - clean.joint_angles)[:, at]
    assert (np.abs(rest) < 0.4 * width).mean() > 0.6  # most rest between the ends
    off = (rest - mean) / sd
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.3
    assert np.abs(off).max() < 6  # about 30 without what rests between the ends


def test_a_light_load_turns_a_link_through_its_play_within_a_row_of_a_motion(robot):
    play, width = catalogue()["backlash"], np.radians(1.0)
    spec, edit = load_scene(robot), play.inject(preset_rig("ideal", robot), "right_knee", (width,)).edit
    assert edit is not None
    edit(spec)
    speed = 1.0 / spec.joint("right_knee_play").damping[0]  # rad/s under 1 Nm
    assert width / speed < 0.25  # s, half a row


def test_the_noise_of_cells_without_a_sheet_counts_too(robot, plan):
    few = plan.take(plan.placement <= 6)
    m = tt.Laboratory(robot, "wii").run(few, seed=1005, engine="statics").measurements
    observed = observe(within("sensors", m, cell_sd=None), nominal_robot(robot))
    assert observed.cell_sd == 0
    assert self_calibrate(observed).observed.cell_sd == pytest.approx(m.sensors.cell_sd, rel=0.3)
