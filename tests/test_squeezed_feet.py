"""Forces between the feet that last as they stand: a foot is put down not quite where the servos want it."""

import dataclasses

import numpy as np
import pytest

from tulip_testbed.calibration.linearisation import SQUEEZE, sources_of
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.joint_fit import Data
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.load_rates import soles_by_wrench
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe, turned
from tulip_testbed.identification.residual_channels import ROWS
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.sensors import PLATE, PRESETS, WrenchSensors
from tulip_testbed.sim.statics import static_run
from tulip_testbed.sim.statics.solved_plan import solve_plan


@pytest.fixture(scope="module")
def few(plan):
    return plan.take(plan.placement <= 4)


def run(robot, plan, monkeypatch, off, wrench=None):
    """Carry out a plan by exact sensors with the left foot put down off its place, by (3,) [m, m, rad]."""
    rig = preset_rig("ideal", robot)
    rig = dataclasses.replace(
        rig,
        sensors=dataclasses.replace(PRESETS["ideal"], wrench=wrench),
        controller=dataclasses.replace(rig.controller, command_sd=0.0),
        protocol=dataclasses.replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0),
    )

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
    observed = observe(run(robot, plan, monkeypatch, off).measurements, nominal_robot(robot))
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
    soft = Laboratory(robot, "force-plate").with_effects(*soft, "sole-compliance=4e-4")
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
