"""Dry friction against Coulomb's law: it holds what it can, and no more."""

import mujoco
import numpy as np
import pytest

from tulip_testbed.sim.dynamics.stiction import BREAKAWAY, Stiction

ARM = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="arm">
      <joint name="arm" axis="0 1 0" armature="0.05" frictionloss="{friction}"
        solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"/>
      <inertial pos="{lever} 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
  <actuator><position joint="arm" kp="100" kv="2" ctrlrange="-1 1"/></actuator>
</mujoco>"""

# A block of 10 kg on four corners.
BLOCK = """
<mujoco>
  <option timestep="0.001" cone="elliptic" tolerance="1e-12"/>
  <default>
    <pair condim="3" friction="{mu} {mu} 0.005 0.0001 0.0001" solref="0.02 1" solimp="0.9999 0.9999 0.001"
      solreffriction="{row} 1"/>
    <geom type="sphere" size="0.002" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="ground"><geom name="ground" type="box" size="1 1 0.05" pos="0 0 -0.05" mass="1"/></body>
    <body name="block" pos="0 0 0.002">
      <freejoint/>
      <inertial pos="0 0 0.02" mass="10" diaginertia="0.05 0.05 0.08"/>
      <geom name="a" pos="0.1 0.1 0"/> <geom name="b" pos="0.1 -0.1 0"/>
      <geom name="c" pos="-0.1 0.1 0"/> <geom name="d" pos="-0.1 -0.1 0"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="ground" geom2="a"/> <pair geom1="ground" geom2="b"/>
    <pair geom1="ground" geom2="c"/> <pair geom1="ground" geom2="d"/>
  </contact>
</mujoco>"""


def arm(friction: float, torque: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """An arm that hangs out level on `torque` [Nm], its servo switched off."""
    model = mujoco.MjModel.from_xml_string(ARM.format(friction=friction, lever=torque / 9.81))
    model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0
    return model, mujoco.MjData(model)


def block(angle: float, mu: float, row: float = 0.002) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A block that stood on the level and finds itself on a slope of `angle` [rad]; downhill is +x.

    `row`: time constant of the friction rows [s].
    """
    model = mujoco.MjModel.from_xml_string(BLOCK.format(mu=mu, row=row))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    model.opt.gravity[:] = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    return model, data


def stick(stiction: Stiction, model: mujoco.MjModel, data: mujoco.MjData, times: int) -> None:
    """Let what is at rest stick, again and again while the model goes on."""
    for _ in range(times):
        stiction.engage(data)
        mujoco.mj_step(model, data, 20)


def test_a_loaded_joint_holds_for_a_minute():
    """2 Nm of dry friction under 1.47 Nm: 0.1 mrad of creep by the friction row, nothing by sticking."""
    model, data = arm(2.0, 1.47)
    mujoco.mj_step(model, data, 200)
    start = data.qpos[0]
    mujoco.mj_step(model, data, 60_000)
    crept = data.qpos[0] - start
    assert 5e-5 < crept < 2e-4
    stiction = Stiction(model, [])
    stick(stiction, model, data, 5)
    start = data.qpos[0]
    mujoco.mj_step(model, data, 60_000)
    assert abs(data.qpos[0] - start) < 1e-8
    assert data.qfrc_applied[0] == pytest.approx(-1.47, rel=1e-3)
    assert stiction.overloaded(data) == []


def test_a_joint_lets_go_of_more_than_friction_carries():
    model, data = arm(2.0, 2.3)
    stiction = Stiction(model, [])
    stick(stiction, model, data, 5)
    assert stiction.overloaded(data) == ["arm"]
    assert abs(data.qfrc_applied[0]) <= BREAKAWAY * 2.0
    stiction.release(data)
    mujoco.mj_resetData(model, data)
    mujoco.mj_step(model, data, 100)
    inertia = 0.05 + 0.01 + 1.0 * (2.3 / 9.81) ** 2
    assert data.qvel[0] == pytest.approx(0.1 * (2.3 - 2.0) / inertia, rel=0.02)


@pytest.mark.parametrize("left", [0.7, 0.3, 0.0, -0.7])
def test_a_stuck_joint_whose_load_falls_does_not_move(left):
    """Near its limit, then unloaded and loaded the other way within it: friction must not push."""
    model, data = arm(2.0, 1.99)
    stiction = Stiction(model, [])
    stick(stiction, model, data, 5)
    model.opt.gravity[2] *= left
    start = data.qpos[0]
    mujoco.mj_step(model, data, 20)
    stick(stiction, model, data, 50)
    assert abs(data.qpos[0] - start) < 2e-7
    assert data.qfrc_applied[0] == pytest.approx(-1.99 * left, abs=2e-3)


@pytest.mark.parametrize(("torque", "slides"), [(5.0, False), (9.0, True)])
def test_a_foot_is_not_held_against_more_torsion_than_friction_has(torque, slides):
    """Four corners at 0.1414 m from the centre: mu N r = 6.94 Nm."""
    model, data = block(0.0, 0.5)
    stiction = Stiction(model, [(model.body("block").id, model.body("ground").id)])
    for part in np.linspace(0, 1, 50):
        data.xfrc_applied[:] = stiction.wrenches
        data.xfrc_applied[model.body("block").id, 5] += part * torque
        stiction.engage(data)
        mujoco.mj_step(model, data, 20)
    assert stiction.overloaded(data) == (["block"] if slides else [])


def test_a_foot_inside_the_cone_stays_for_a_minute():
    """20 degrees of slope on a friction of 0.5, which holds 26.6."""
    model, data = block(np.deg2rad(20), 0.5)
    stiction = Stiction(model, [(model.body("block").id, model.body("ground").id)])
    mujoco.mj_step(model, data, 500)
    stick(stiction, model, data, 10)
    start = data.qpos[:3].copy()
    mujoco.mj_step(model, data, 60_000)
    assert np.abs(data.qpos[:3] - start).max() < 1e-7
    assert stiction.overloaded(data) == []
    held = -data.xfrc_applied[model.body("block").id, 0]
    assert held == pytest.approx(10 * 9.81 * np.sin(np.deg2rad(20)), rel=1e-3)


def test_a_foot_outside_the_cone_slides_as_coulomb_says():
    """Softer friction rows: those of the laboratory make a sliding foot hop."""
    slope = np.deg2rad(35)
    model, data = block(slope, 0.5, row=0.02)
    stiction = Stiction(model, [(model.body("block").id, model.body("ground").id)])
    mujoco.mj_step(model, data, 100)
    before = data.qvel[0]
    mujoco.mj_step(model, data, 200)
    acceleration = (data.qvel[0] - before) / 0.2
    assert acceleration == pytest.approx(9.81 * (np.sin(slope) - 0.5 * np.cos(slope)), rel=0.01)
    stick(stiction, model, data, 3)
    assert stiction.overloaded(data) == ["block"]
