"""The atlas and the tolerances of a plan, held against simulations with and without each effect."""

import dataclasses
import json

import numpy as np
import pytest

from studies.runner import shipped_plan
from tests.test_cli import told
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.evidence import marginal_fits
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.experiments.atlases.atlas_result import ISOLABLE
from tulip_testbed.experiments.atlases.effect_atlas import angles, atlas
from tulip_testbed.experiments.atlases.planned_experiment import BiasWeights, bias, noisy, planned
from tulip_testbed.experiments.atlases.tolerance import tolerance
from tulip_testbed.identification.estimators import MIXED_MODEL, estimate_by
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.regressor import regression
from tulip_testbed.identification.residual_channels import CHANNELS
from tulip_testbed.identification.residual_noise import noise_of
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.statics.solved_plan import solve_plan

SEED = 112
CHECKED = 5  # runs with and without an effect


@pytest.fixture(scope="module")
def plan():
    robot = load_robot()
    return planned(shipped_plan(robot), "force-plate", robot, SEED)


@pytest.fixture(scope="module")
def found(plan):
    return atlas(plan, np.random.default_rng(SEED))


def row_of(found, label, name=""):
    (row,) = (r for r in found.effects if (r.label, r.name) == (label, name))
    return row


def solved_of(plan):
    """The postures of a plan that the nominal robot can be measured in, solved."""
    measured = np.isin(plan.plan.posture, plan.observed.measurements.posture)
    return solve_plan(plan.rig, plan.plan.take(measured))


def changed(plan, candidate, sizes):
    """The plan's laboratory with an effect."""
    rig = candidate.effect.inject(plan.rig, candidate.target, candidate.values(np.asarray(sizes)))
    solved = solved_of(plan)
    if dataclasses.replace(rig, misread=None) == plan.rig:
        return dataclasses.replace(solved, rig=rig)
    return solve_plan(rig, solved.plan)


def shifts_by(plan, solved_plan):
    """By simulation: the mean change of the estimates by an effect, the same random numbers without it."""

    def estimates(runs):
        data = (regression(plan.nominal.parameters, run, plan.nominal.robot, "plan") for run in runs)
        return np.array([estimate_by(each, MIXED_MODEL).value for each in data])

    with_it, without = (noisy(solved, SEED, CHECKED) for solved in (solved_plan, solved_of(plan)))
    return (estimates(with_it) - estimates(without)).mean(axis=0)


@pytest.mark.slow
def test_detectable_sizes_are_found_by_nine_of_ten_simulated_experiments(plan, found):
    runs, hits = 16, []
    for label in ("cell-gain:left.rear_left", "encoder-offset:right_knee", "sole-compliance"):
        row = row_of(found, label)
        candidate = candidate_of(plan, row.effect, row.target or "")
        solved_plan = changed(plan, candidate, [row.detectable])
        for run in noisy(solved_plan, SEED + 1, runs):
            observed = observe(run, plan.nominal)
            linear = linear_model(observed, noise_of(observed))
            columns = candidate_columns(linear, [candidate])
            hits.append(marginal_fits(columns, linear.residual)[0].p < found.level_of_each)
    # 90 % of 48, less 2.7 standard deviations of the binomial; at half the size it would be about 10 %.
    assert sum(hits) >= 38
    assert sum(hits) < len(hits)


def test_absorbed_effects_are_named_with_their_bias(plan, found):
    mass = row_of(found, "payload:torso", "mass")
    assert not mass.visible
    assert set(mass.by_channel.values()) == {np.inf}
    moved = shifts_by(
        plan, changed(plan, candidate_of(plan, "payload", "torso"), [mass.prior_sd, 0.0, 0.0, 0.0])
    )
    error = (moved - mass.bias_at_prior_m) / plan.standard_errors
    assert np.abs(mass.bias_at_prior_se).max() > 10
    assert np.abs(error).max() < 0.02 * np.abs(mass.bias_at_prior_se).max()


def candidate_of(plan, name, target):
    (candidate,) = (c for c in candidates(plan.observed, {name: catalogue()[name]}) if c.target == target)
    return candidate


@pytest.mark.parametrize(("name", "target"), [("tether-spring", ""), ("payload-step", "right_lower_leg")])
def test_biases_are_those_of_the_estimator(plan, name, target):
    candidate = candidate_of(plan, name, target)
    point = len(candidate.settings) // 2
    predicted = bias(plan, BiasWeights(plan), candidate, point)[:, 0]
    part = 0.1  # of the prior's s.d.: to first order
    rig = candidate.effect.inject(plan.rig, target, candidate.values(part * candidate.prior, point))
    moved = shifts_by(plan, solve_plan(rig, solved_of(plan).plan))
    first, second = predicted / plan.standard_errors, moved / plan.standard_errors / part
    assert first @ second / np.linalg.norm(first) / np.linalg.norm(second) > 0.98
    assert np.linalg.norm(second) / np.linalg.norm(first) == pytest.approx(1, abs=0.1)


def test_tolerances_agree_with_simulation(plan):
    found = tolerance(plan)
    assert len(found.sources) == 28
    wanted = ("plate-translation:right y", "plate-yaw:left", "tilt about x", "cell-gain:right.rear_left")
    chosen = [s for s in found.sources if s.label in (*wanted, "encoder-offset:right_ankle_roll")]
    assert len(chosen) == 5
    for source in chosen:
        candidate = candidate_of(plan, source.effect, source.target or "")
        numbers = [candidate.effect.parameters[k].name for k in candidate.effect.sizes]
        sizes = [source.amount * (name == source.parameter) for name in numbers]
        shift = shifts_by(plan, changed(plan, candidate, sizes)) / plan.standard_errors
        worst = int(np.abs(source.bias_se).argmax())
        assert abs(source.bias_se[worst]) > 0.5  # there is something to compare
        assert shift[worst] == pytest.approx(source.bias_se[worst], rel=0.1)
        assert np.abs(shift - source.bias_se).max() < 0.15
        assert source.allowed_units * np.abs(source.bias_se).max() == pytest.approx(0.5)
        (kind,) = (kind for kind in found.kinds if kind.effect == source.effect)
        assert 0 < kind.together_units <= kind.alone_units <= source.allowed_units


def test_angles_are_those_of_the_subspaces():
    x, y, z = np.eye(3)[:, :, None]
    tipped = np.cos(np.radians(30)) * x + np.sin(np.radians(30)) * y
    found = np.degrees(angles([[x], [y], [tipped], [np.hstack([y, z])], [z, 2 * x]]))
    assert found[0] == pytest.approx([0, 90, 30, 90, 0], abs=1e-5)
    assert found[3] == pytest.approx([90, 0, 60, 0, 0], abs=1e-5)
    assert found == pytest.approx(found.T)


def test_structural_twins_share_a_group(found):
    named = [set(group) for group in found.groups]
    for pair in (
        {"plate-translation:right", "plate-translation:left"},
        {"cell-tare:left.front_left", "cell-tare:left.rear_right"},
    ):
        assert any(pair <= group for group in named), pair
    for group in found.groups:
        numbers = [found.shown.index(label) for label in group]
        assert found.angle_rad[np.ix_(numbers, numbers)].max() < ISOLABLE


def test_document_is_what_the_rows_say(found):
    said = found.to_json()
    assert len(said["effects"]) == len(found.effects)
    assert set(said["effects"][0]["by_channel"]) == set(CHANNELS)
    assert len(said["angle_rad"]) == len(said["shown"])
    entry = next(e for e in said["effects"] if e["effect"] == "plate-translation" and e["parameter"] == "y")
    row = row_of(found, f"plate-translation:{entry['target']}", "y")
    at_found = np.array(entry["bias_at_prior_se"]) * row.detectable / row.prior_sd
    assert entry["bias_at_detectable_se"] == pytest.approx(at_found)
    frame = found.to_frame()
    assert frame["detectable"].tolist() == [row.detectable for row in found.effects]
    assert frame["unit"][frame["effect"] == "plate-yaw"].eq("rad").all()
    opening, kinds, closing = found.tables()
    assert opening.startswith(f"{found.postures} of ")
    assert {row[0] for row in kinds.rows} == {row.effect for row in found.effects}
    assert f"of {len(found.shown)} effects" in closing


def test_commands(tmp_path, capsys):
    small_plan, whole, out = tmp_path / "small", shipped_plan(load_robot()), tmp_path / "atlas"
    write_plan(small_plan, whole.take(whole.placement <= 6))
    said = told(capsys, "atlas", small_plan, "--out", out)
    assert {path.name for path in out.iterdir()} == {"atlas.html", "atlas.json"}
    page = (out / "atlas.html").read_text(encoding="utf-8")
    assert all(f"<td>{entry['effect']}" in page for entry in said["effects"])
    assert '<input id="search"' in page
    assert json.loads((out / "atlas.json").read_text()) == said
    assert "Infinity" not in (out / "atlas.json").read_text()
    assert len(told(capsys, "atlas", "tolerance", small_plan)["sources"]) == 28
