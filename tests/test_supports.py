"""Centre of mass and of pressure, wrenches, torques and what pushes the feet, against MuJoCo and by hand."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

import tulip_testbed as tt
from tests.moving_robots import by_inverse_dynamics, moving, random_robot
from tulip_testbed.calibration.linearisation import SQUEEZE, sources_of
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.joint_fit import Data
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.inertial_wrench import link_wrenches
from tulip_testbed.identification.load_rates import load_rates, soles_by_wrench
from tulip_testbed.identification.nominal import PostureGeometry, jacobian, nominal_robot
from tulip_testbed.identification.observation import Observation, observe, turned
from tulip_testbed.identification.residual_channels import ROWS
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.sensors import PLATE, PRESETS, WrenchSensors
from tulip_testbed.sim.statics import static_run
from tulip_testbed.sim.statics.solved_plan import solve_plan

SUPPORT = np.array(["double", "right", "left"] * 4)


def test_slopes_are_those_of_finite_differences(robot, plan):
    nominal, rng = nominal_robot(robot, "mixed"), np.random.default_rng(5)
    angles = plan.joint_angles[: len(SUPPORT)] + 0.2 * rng.standard_normal((len(SUPPORT), 12))
    geometry = PostureGeometry(
        nominal, nominal.parameters.tree, angles, SUPPORT, standard_parameters(robot.model)
    )
    by_angle = geometry.slope_along(nominal.value) + geometry.stance_sole_slope[:, :2]
    assert geometry.slope_along(nominal.value) == pytest.approx(geometry.slope @ nominal.value, abs=1e-14)
    expected = jacobian(lambda q: nominal.center_of_mass(q, SUPPORT), angles)
    np.testing.assert_allclose(by_angle, expected, atol=1e-8)
    np.testing.assert_allclose(geometry.center[:, :2], nominal.center_of_mass(angles, SUPPORT), atol=1e-12)


@pytest.mark.parametrize("which", ["tulip", "humanoid"])
def test_it_is_what_inverse_dynamics_need(which, robot, foreign):
    rng = np.random.default_rng(210)
    for _ in range(3):
        one = random_robot(robot if which == "tulip" else foreign[which], rng)
        nominal, m = nominal_robot(one), moving(one, rng)
        found = link_wrenches(nominal, m)[0].sum(axis=1)
        for row, support in enumerate(m.support):
            side = int(support == "left")
            foot = (one.stance_foot, one.swing_foot)[side]
            motion = m.joint_angles[row], m.joint_rates[row], m.joint_accelerations[row]
            expected, *_ = by_inverse_dynamics(one, foot, nominal.points[side], *motion)
            assert found[row] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.fixture(scope="module")
def measured_of_joint(robot, plan):
    few = plan.take(plan.placement <= 2)
    return tt.Laboratory(robot, "force-plate").run(few, seed=3, engine="statics").measurements


@pytest.fixture(scope="module")
def observed(measured_of_joint, nominal) -> Observation:
    return observe(measured_of_joint, nominal)


def loads(measurements, nominal, gains):
    return observe(dataclasses.replace(measurements, gains=gains, command=None), nominal)


def test_stated_gains_decide_how_the_legs_share_their_forces(measured_of_joint, nominal):
    plain = loads(measured_of_joint, nominal, {})
    soft = {"right_knee": 300.0, "left_hip_roll": 900.0}
    stated = loads(measured_of_joint, nominal, soft)
    names = list(measured_of_joint.joints)
    assert stated.servo_stiffness[names.index("right_knee")] == 300
    other = names.index("left_knee")
    assert stated.servo_stiffness[other] == plain.servo_stiffness[other]
    for row in range(len(measured_of_joint)):
        levers = stated.loads.levers[row]
        rest = stated.torques[row] - levers @ stated.loads.internal_wrench[row]

        def energy(wrench, rest=rest, levers=levers):
            return ((rest + levers @ wrench) ** 2 / stated.servo_stiffness).sum()

        found = minimize(energy, np.zeros(3), method="BFGS", options={"gtol": 1e-10})
        assert stated.loads.internal_wrench[row] == pytest.approx(found.x, abs=1e-3)
    assert np.abs(stated.loads.internal_wrench - plain.loads.internal_wrench).max() > 1


@pytest.mark.parametrize(("part", "soft"), [(1.0, 0.0), (0.7, 0.0), (1.0, 9e-4)])
def test_feed_forward_of_holds_takes_side_forces_off(robot, part, soft):
    """Servos do not sag then, which commands tell; a soft knee moves the load off its planned share."""
    plan, rig = (
        tt.plans.optimal.take(tt.plans.optimal.placement <= 6),
        exact(robot, WrenchSensors(place=PLATE)),
    )
    assert plan.torques is not None
    inside = tt.Laboratory(robot, nominal=rig).with_effects(
        *[f"joint-compliance:right_knee={soft}"] * (soft > 0)
    )
    m = inside.run(dataclasses.replace(plan, torques=part * plan.torques), 1, "statics").measurements
    observed, at = observe(m, nominal_robot(robot)), m.joints.index("right_knee")
    assert observed.sag == pytest.approx(1 - part, abs=0.1)
    zero = dataclasses.replace(m, joint_angles=m.joint_angles + np.radians(1.0) * (np.arange(12) == at))
    assert observe(zero, observed.nominal).sag == pytest.approx(1 - part, abs=0.3)
    stiffness = observed.servo_gain.copy()
    stiffness[at] = 1 / (1 / stiffness[at] + soft)
    yielding = dataclasses.replace(observed, servo_stiffness=stiffness)
    angles = observed.joint_angles.copy()
    angles[:, at] += soft * yielding.torques[:, at]
    assert m.wrenches is not None
    off = turned(m.plate_poses[:, 1, 2], m.wrenches[:, 1, :2])
    off -= yielding.changed(joint_angles=angles).loads.internal_wrench[:, :2]
    assert np.sqrt((off**2).mean(axis=0)).max() < 1  # N, friction of the drives


def moved(observed: Observation, reading: int, step: float) -> Observation:
    change = step * np.eye(14)[reading]
    return observed.changed(
        cell_forces=observed.cell_forces + change[:8],
        plate_poses=observed.plate_poses + change[8:].reshape(2, 3),
    )


def test_loads_by_cells_and_plates(observed):
    torques, soles = load_rates(observed)
    for reading in range(14):
        step = 1e-2 if reading < 8 else 1e-5
        ends = [moved(observed, reading, sign * step) for sign in (1, -1)]
        by_torque = (ends[0].torques - ends[1].torques) / (2 * step)
        by_sole = (ends[0].sole_loads - ends[1].sole_loads) / (2 * step)
        assert torques[..., reading] == pytest.approx(by_torque, abs=1e-6 * np.abs(by_torque).max() + 1e-9)
        assert soles[..., reading] == pytest.approx(by_sole, abs=1e-6 * np.abs(by_sole).max() + 1e-9)


def test_a_softer_joint_takes_load_off(observed):
    """The closed legs share the load by the servos' stiffness: the derivative by one compliance."""
    for joint in (0, 3, 8):
        ends = []
        for sign in (1, -1):
            softer = 1 / observed.servo_stiffness
            softer[joint] += sign * 1e-6
            ends.append(dataclasses.replace(observed, servo_stiffness=1 / softer).torques)
        expected = -observed.loads.sharing[..., joint] * observed.torques[:, [joint]]
        assert expected == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-4 * np.abs(expected).max())


@pytest.fixture(scope="module")
def few(plan):
    return plan.take(plan.placement <= 4)


def exact(robot, wrench):
    """Return the rig of exact sensors, commands and plates."""
    rig = preset_rig("ideal", robot)
    return dataclasses.replace(
        rig,
        sensors=dataclasses.replace(PRESETS["ideal"], wrench=wrench),
        controller=dataclasses.replace(rig.controller, command_sd=0.0),
        protocol=dataclasses.replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0),
    )


def run(robot, plan, monkeypatch, off, wrench=None):
    """Carry out a plan by exact sensors with the left foot put down off its place, by (3,) [m, m, rad]."""
    rig = exact(robot, wrench)

    def moved(*given, put_down=static_run._feet):
        feet = put_down(*given).copy()
        feet[:, 1] += off
        return feet

    with monkeypatch.context() as patch:
        patch.setattr(static_run, "_feet", moved)
        (out,) = static_run.run_statics(solve_plan(rig, plan), [np.random.SeedSequence(1)], all_solved=True)
    return out


def between_the_feet(robot, plan, monkeypatch, off):
    """Return the observation and the side force on the left foot that cells do not explain, (m, 2) [N]."""
    measured = dataclasses.replace(run(robot, plan, monkeypatch, off).measurements, command=None)
    observed = observe(measured, nominal_robot(robot))
    truth = run(robot, plan, monkeypatch, off, WrenchSensors(place=PLATE)).truth.wrenches
    assert truth is not None
    yaw = observed.plate_poses[:, 1, 2]
    return observed, turned(yaw, truth[:, 1, :2]) - observed.loads.internal_wrench[:, :2]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_foot_that_stands_off_is_pushed_as_the_closed_legs_resist(robot, few, monkeypatch, axis):
    size = (1e-3, 1e-3, 2e-3)[axis] * np.eye(3)[axis]
    observed, plain = between_the_feet(robot, few, monkeypatch, np.zeros(3))
    _, pushed = between_the_feet(robot, few, monkeypatch, size)
    lever = observed.foot_loads[1][:, 1] - observed.swing_sole[0][:, :2]
    of_load = size + size[2] * np.column_stack([-lever[:, 1], lever[:, 0], 0 * lever[:, 0]])
    expected = (observed.loads.closed @ of_load[..., None])[:, :2, 0]
    assert pushed - plain == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_what_pushes_the_feet_loads_the_soles(robot, few, monkeypatch):
    """By the moment about the height of the sole; a robot on one foot has nothing to push against."""
    observed = observe(run(robot, few, monkeypatch, np.zeros(3)).measurements, nominal_robot(robot))
    more = np.array([3.0, -2.0, 1.0])
    pushed = dataclasses.replace(observed)
    loads = dataclasses.replace(observed.loads, internal_wrench=observed.loads.internal_wrench + more)
    pushed.__dict__["loads"] = loads
    assert soles_by_wrench(observed) @ more == pytest.approx(pushed.sole_loads - observed.sole_loads)
    assert np.abs(soles_by_wrench(observed) @ more).max() > 0.05
    single = dataclasses.replace(observed.measurements, support=np.full(len(observed), "right"))
    alone = observe(single, observed.nominal)
    assert not soles_by_wrench(alone).any()
    assert not alone.loads.closed.any()


def test_rows_of_a_placement_share_what_pushes_their_feet(robot, few, monkeypatch):
    """Noise of single rows would average out; compliances seem surer then than the unseen force allows."""
    observed = observe(run(robot, few, monkeypatch, np.zeros(3)).measurements, nominal_robot(robot))
    soft = [f"joint-compliance:{joint}=2e-4" for joint in observed.tree.joints]
    soft = tt.Laboratory(robot, "force-plate").with_effects(*soft, "sole-compliance=4e-4")
    found = self_calibrate(observe(soft.run(few, 1, "statics").measurements, observed.nominal))
    structure, at = found.problem.noise, sources_of(found.observed).index(SQUEEZE)
    shared = structure.shared[..., structure.owner == at]
    assert shared.shape[2] == 3
    # The joints and the soles turn: the swing foot's tilt follows, as the noise of an encoder or more.
    assert np.abs(shared[:, ROWS["C"]][:, 1:3]).max() > 1e-5
    again = found.background()
    assert again.squeeze == pytest.approx(shared * found.solved.scales[at])
    fit = Data(found.observed, found.noise, again).null
    assert fit.linear.whitening.levers.shape[2] == 9
