"""Effects in the laboratory: what they change, what they leave, and when."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.effect_changes import SEED, first, statically
from tests.test_refusals import refuse
from tulip_testbed.base.errors import InputError
from tulip_testbed.discovery.refit import exact_rig, measured_plan, simulated
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, injected, removed
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.observation import fraction_of_time, observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig, stages
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics


def test_a_tilt_turns_about_x_then_about_y(noiseless):
    """A level table's leg shortened: gravity in the floor's axes."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, -1.0]
    edit: Any = catalogue()["tilt"].inject(noiseless, "", (0.1, 0.2)).edit
    edit(spec)
    a, b = 0.1, 0.2
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    assert (about_y @ about_x) @ spec.option.gravity == pytest.approx([0.0, 0.0, -1.0])


@pytest.mark.parametrize("name", ["random", "optimal"])
def test_the_nominal_laboratory_asked_again_shows_what_was_measured(name, robot, model, nominal):
    """Also if the plan has feed-forward torques, which the commands contain."""
    plan = first(read_plan(DEFAULT_PLAN.parent / name, robot), 8)
    run = run_statics(solve_plan(preset_rig("wii", robot), plan), np.random.SeedSequence(SEED).spawn(1))[0]
    observed = observe(run.measurements, nominal)
    again = simulated(exact_rig(observed), measured_plan(observed))
    assert len(again) == len(observed)
    assert np.abs(again.joint_angles - observed.joint_angles).max() < 5e-3
    feet = (again.cell_forces - observed.cell_forces).reshape(-1, 2, 4).sum(axis=2)
    assert np.abs(feet).max() < 15


@pytest.mark.parametrize(
    ("name", "target", "values"),
    [
        ("joint-compliance", "right_knee", (0.0005,)),
        ("backlash", "right_hip_pitch", (0.005,)),
        ("tether", "", (1.0, 2.0)),
        ("sole-compliance", "", (0.0005,)),
        ("lifted-corner", "left_foot.front_left", (0.0003,)),
        ("rocking", "right.front_left", (0.0003,)),
    ],
)
def test_what_an_effect_adds_is_no_part_of_the_true_robot(name, target, values, noiseless, few, nominal):
    changed = catalogue()[name].inject(noiseless, target, values)
    truth = true_base_parameters(changed)
    assert truth == pytest.approx(nominal.value, abs=1e-12)


def test_effects_are_removed_in_the_reverse_order_of_their_stages(noiseless, few, nominal):
    """Otherwise the compliance of a sole would be computed from cells that are still swapped."""
    listed = [
        EffectInstance(catalogue()["swapped-cells"], "left", (1, 3)),
        EffectInstance(catalogue()["cell-gain"], "right.front_left", (0.1,)),
        EffectInstance(catalogue()["sole-compliance"], "", (4e-4,)),
    ]
    sole = listed[2:]
    alone = residuals(
        removed(observe(statically(injected(noiseless, sole), few), nominal), sole), nominal.value
    )
    for order in (listed, listed[::-1]):
        observed = observe(statically(injected(noiseless, order), few), nominal)
        assert residuals(removed(observed, order), nominal.value) == pytest.approx(alone, abs=1e-9)


def test_the_truth_is_of_the_robot_that_stood_there_first(noiseless, few, nominal):
    step = catalogue()["payload-step"].inject(noiseless, "torso", (1.0, 0.5))
    longer = catalogue()["link-length"].inject(step, "right_lower_leg", (0.01,))
    assert true_base_parameters(step) == pytest.approx(nominal.value, abs=1e-12)
    assert np.abs(true_base_parameters(longer) - nominal.value).max() > 1e-3


def test_what_is_changed_after_a_step_is_changed_before_and_after(noiseless):
    step = catalogue()["payload-step"]
    rig = step.inject(step.inject(noiseless, "torso", (1.0, 0.6)), "right_hip", (1.0, 0.3))
    rig = catalogue()["sole-compliance"].inject(rig, "", (1e-4,))
    assert [start for start, _ in stages(rig)] == [0.0, 0.3, 0.6]
    assert {one.compliance.sole_tilt for _, one in stages(rig)} == {1e-4}
    spec = load_scene(rig.robot)
    edit: Any = stages(rig)[2][1].edit
    edit(spec)
    plain = load_scene(rig.robot)
    for link in ("torso", "right_hip"):
        assert spec.body(link).mass == pytest.approx(plain.body(link).mass + 1.0)


def test_a_step_comes_at_its_part_of_the_recorded_time(noiseless, few, nominal):
    found = statically(catalogue()["payload-step"].inject(noiseless, "torso", (0.5, 0.41)), few)
    heavy = found.cell_forces.sum(axis=1) / found.gravity - nominal.mass
    assert heavy == pytest.approx(0.5 * (fraction_of_time(found.time) >= 0.41), abs=1e-6)


def test_a_laboratory_does_not_change_before_it_begins(noiseless):
    for parts in ((0.0,), (1.5,)):
        with pytest.raises(InputError, match="expected more than 0 and at most 1"):
            stages(catalogue()["payload-step"].inject(noiseless, "torso", (0.5, *parts)))


def test_a_board_that_rocks_has_no_cell_under_load_on_either_side(noiseless, few, nominal):
    """Which cell is idle changes with the load; the board is tilted only on the side of the short foot."""
    rocking = catalogue()["rocking"]
    found = statically(rocking.inject(noiseless, "right.front_left", (0.0003,)), few)
    short, opposite = found.cell_forces[:, 0], found.cell_forces[:, 2]
    # Tared on the diagonal, the two cells read zero if they bear nothing.
    assert np.minimum(short, opposite) == pytest.approx(0.0, abs=1e-9)
    assert (short > 1).any()
    assert (opposite > 1).any()
    observed = observe(found, nominal)
    assert not observed.on_four_cells[:, 0].any()
    assert observed.on_four_cells[:, 1].mean() > 0.9
    noisy = found.cell_forces.copy()
    noisy[2, [0, 2]] += 0.6  # of the one that bears nothing, noise and crosstalk
    assert not observe(replace(found, cell_forces=noisy), nominal).on_four_cells[:, 0].any()
    tilt = rocking.remove(observed, "right.front_left", (0.0003,)).stance_tilt
    assert tilt[opposite > 5] == pytest.approx(0.0, abs=1e-12)
    distance = 2 * 0.2165 * 0.119 / np.hypot(0.2165, 0.119)  # of a cell from the diagonal
    assert np.linalg.norm(tilt[short > 5], axis=1) == pytest.approx(0.0003 / distance)


def test_two_short_feet_of_one_board_are_refused_by_statics(noiseless, two):
    rig = catalogue()["rocking"].inject(noiseless, "right.front_left", (0.0003,))
    rig = catalogue()["rocking"].inject(rig, "right.rear_left", (0.0002,))
    refuse("found a plate with 2 short feet, expected one at most", solve_plan, rig, two)


@pytest.mark.parametrize("name", [name for name, effect in catalogue().items() if not effect.statics])
def test_statics_refuses_what_it_does_not_know(name, noiseless, robot, two):
    effect = catalogue()[name]
    target = effect.targets.of(robot, (1,))[0]
    refuse("static equilibrium", solve_plan, effect.inject(noiseless, target, (0.001,)), two)
