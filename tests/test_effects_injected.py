"""Effects in the laboratory: what they change, and what the command line tells of them."""

import json
import pickle
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.edited_rows import changed, plus
from tests.effect_changes import SEED, first, measured, statically
from tests.test_cli import refused, told
from tests.test_refusals import refuse
from tulip_testbed.base.errors import InputError
from tulip_testbed.cli.main import main
from tulip_testbed.discovery.nominal_laboratory import exact_rig, measured_plan, simulated
from tulip_testbed.effects.catalogue import catalogue, effects_on
from tulip_testbed.effects.instance import EffectInstance, check_instance, injected, removed
from tulip_testbed.effects.random_effects import draw_effect
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import ROWS, residuals
from tulip_testbed.measurements import read_measurements
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import stages
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.statics.solved_plan import solve_plan


def test_a_tilt_turns_about_x_then_about_y(noiseless):
    """A level table's leg shortened: gravity in the floor's axes."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, -1.0]
    edit: Any = catalogue()["tilt"].inject(noiseless, "", (0.1, 0.2)).edit
    edit(spec)
    turned = Rotation.from_euler("xy", [0.1, 0.2]).apply(spec.option.gravity)
    assert turned == pytest.approx([0.0, 0.0, -1.0])


@pytest.mark.parametrize("name", ["random", "optimal"])
def test_the_nominal_laboratory_asked_again_shows_what_was_measured(name, robot, model, nominal):
    """Also if the plan has feed-forward torques, which the commands contain."""
    plan = first(read_plan(DEFAULT_PLAN.parent / name, robot), 8)
    observed = observe(measured(robot, plan, "wii", seed=SEED), nominal)
    again = simulated(exact_rig(observed), measured_plan(observed))
    assert len(again) == len(observed)
    assert np.abs(again.joint_angles - observed.joint_angles).max() < 5e-3
    feet = (again.cell_forces - observed.cell_forces).reshape(-1, 2, 4).sum(axis=2)
    assert np.abs(feet).max() < 15


@pytest.mark.parametrize(
    ("name", "target", "values"),
    [
        ("joint-compliance", "right_knee", (0.0005,)),
        ("payload-step", "torso", (1.0, 0.5)),
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


@pytest.mark.parametrize(
    ("second", "bound"),
    [("tether-spring=40", 2e-5), ("payload-step:right_ankle=0.7,0.3", 2e-5), ("tilt=0.01,0.01", 2e-4)],
)
def test_loads_act_over_all_that_the_contacts_bear(second, bound, few, nominal, noiseless, robot):
    """A mass of 3 % takes 3 % of the shift by what pulls; to tilted floors all masses are equally high."""
    both = [EffectInstance.parse(one, robot) for one in ("payload-step:right_ankle=0.7,0.5", second)]
    observed = observe(statically(injected(noiseless, both), few), nominal)
    left, turned = (residuals(removed(observed, one), nominal.value) for one in (both, both[::-1]))
    assert np.abs(left[:, ROWS["A"]]).max() < bound
    assert turned == pytest.approx(left, abs=1e-9)


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
    noisy = changed(found, cell_forces=plus(0.6, 2, [0, 2]))  # of the one that bears nothing
    assert not observe(noisy, nominal).on_four_cells[:, 0].any()
    tilt = rocking.remove(observed, "right.front_left", (0.0003,)).stance_tilt
    assert tilt[opposite > 5] == pytest.approx(0.0, abs=1e-12)
    distance = 2 * 0.2165 * 0.119 / np.hypot(0.2165, 0.119)  # of a cell from the diagonal
    assert np.linalg.norm(tilt[short > 5], axis=1) == pytest.approx(0.0003 / distance)


@pytest.mark.parametrize("name", [name for name, effect in catalogue().items() if not effect.statics])
def test_statics_refuses_what_it_does_not_know(name, noiseless, robot, two):
    effect = catalogue()[name]
    target = effect.targets.of(robot, (1,))[0]
    refuse("static equilibrium", solve_plan, effect.inject(noiseless, target, (0.001,)), two)


OFFSET = "encoder-offset:right_knee=0.01"


def by_command(folder, *more):
    assert (
        main(["simulate", "--engine", "statics", "--seed", "241", "--out", str(folder), *map(str, more)]) == 0
    )
    return read_measurements(folder)


def test_all_effects_are_listed(capsys):
    assert main(["atlas", "effects"]) == 0
    out = capsys.readouterr().out
    assert "encoder-offset:JOINT=OFFSET" in out
    assert all(name in out for name in catalogue())
    listed = told(capsys, "atlas", "effects")["effects"]
    assert [effect["name"] for effect in listed] == list(catalogue())
    assert "tilt=ABOUT_X,ABOUT_Y" in repr(catalogue())
    assert catalogue()._repr_html_().count("<tr>") == len(catalogue()) + 1
    assert repr(catalogue()["tilt"]) == "<Effect tilt=ABOUT_X,ABOUT_Y>"
    assert pickle.loads(pickle.dumps(catalogue())) is catalogue()


def test_a_hidden_effect_leaves_the_noise_and_the_folder_as_they_are(tmp_path):
    plain = by_command(tmp_path / "plain")
    hidden = by_command(tmp_path / "data", "--effects", OFFSET, "--truth", tmp_path / "truth.json")
    column = plain.joints.index("right_knee")
    change = hidden.joint_angles - plain.joint_angles
    assert change[:, column] == pytest.approx(np.full(len(plain), 0.01), abs=1e-12)
    assert np.delete(change, column, axis=1) == pytest.approx(0.0)
    assert np.array_equal(hidden.cell_forces, plain.cell_forces)
    manifests = [json.loads((tmp_path / name / "manifest.json").read_text()) for name in ("plain", "data")]
    assert manifests[0].keys() == manifests[1].keys()
    assert all(
        manifests[0][key] == manifests[1][key] for key in manifests[0] if key not in ("created", "tables")
    )
    truth = json.loads((tmp_path / "truth.json").read_text())
    (effect,) = map(EffectInstance.from_document, truth["effects"])
    assert str(effect) == OFFSET
    assert truth["configuration"]["statics"] is True


@pytest.mark.parametrize("style", [(), ("--json",)])
def test_a_random_effect_tells_the_truth_file_alone(style, tmp_path, capsys):
    by_command(tmp_path / "data", "--effects", "random", "--truth", tmp_path / "truth.json", *style)
    (effect,) = json.loads((tmp_path / "truth.json").read_text())["effects"]
    assert effect["name"] in catalogue()
    assert all(parameter["value"] != 0 for parameter in effect["parameters"])
    printed = "".join(capsys.readouterr()).replace("\n", "").replace(str(tmp_path), "")
    # Joints and cells are column names; a reason for a lost posture could be a hint.
    words = [effect["name"], "effect", "random", "dropped 1", "lost sole"]
    files = [path for path in (tmp_path / "data").rglob("*") if path.is_file()]
    folder = b"".join(path.read_bytes() for path in files).decode("latin-1")
    values = [repr(parameter["value"])[:8] for parameter in effect["parameters"]]
    assert not [word for word in words if word in printed]
    assert not [word for word in [effect["name"], "effect", "random", *values] if word in folder]
    assert '"reason": "' not in printed


def test_a_random_effect_that_cannot_be_simulated_is_not_named(tmp_path, capsys, monkeypatch):
    def fail(*_):
        raise InputError("joint-compliance at left_knee is too soft")

    monkeypatch.setattr("tulip_testbed.experiments.laboratory.run_statics", fail)
    more = ("--engine", "statics", "--effects", "random", "--truth", tmp_path / "truth.json")
    message = refused(capsys, "simulate", "--out", tmp_path / "data", *more)
    assert "give another seed" in message
    assert "knee" not in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("statics", [True, False])
def test_draws_are_valid_and_of_all_kinds(statics, robot):
    rng, placements = np.random.default_rng(242), range(1, 31)
    drawn = [draw_effect(robot, placements, rng, statics) for _ in range(600)]
    for found in drawn:
        check_instance(found, robot, placements, "draw")
        assert found.finding
    possible = [effect.name for effect in effects_on(None, statics) if effect.searched]
    assert {found.effect.name for found in drawn} == set(possible)
    sizes = [f.values[0] for f in drawn if f.effect.name == "encoder-offset"]
    assert np.std(sizes) == pytest.approx(np.radians(1.0), rel=0.5)
