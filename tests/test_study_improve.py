"""The studies of the paper's ways to improve, at their smallest size, and what they are built from."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from studies.improve import accuracy, conditioning, postures, simplified, single_support
from studies.improve.output import table
from studies.improve.repeat import monte_carlo_error, rms
from studies.improve.single_support import MARGIN, holding_torques, one_foot_postures
from studies.runner import shipped_plan
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PRESETS

pytest.importorskip("matplotlib")
SEED = 81


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot()


@pytest.fixture(scope="module")
def rig(robot: Robot) -> Rig:
    return preset_rig("wii", robot)


@pytest.fixture(scope="module")
def plan(robot: Robot) -> PosturePlan:
    return shipped_plan(robot, 6)


@pytest.fixture(scope="module")
def parameters(robot: Robot) -> BaseParameters:
    return base_parameters(robot)


def test_sensors_between_the_presets_end_in_them() -> None:
    assert accuracy.between(0.0) == PRESETS["wii"]
    ends = accuracy.between(1.0), PRESETS["force-plate"]
    assert ends[0].cell_noise == pytest.approx(ends[1].cell_noise)
    assert ends[0].placement_sd == pytest.approx(ends[1].placement_sd)
    assert accuracy.between(0.5).cell_noise == pytest.approx(np.sqrt(1.5 * 0.3))


def test_better_sensors_give_smaller_errors(
    rig: Rig, plan: PosturePlan, parameters: BaseParameters, tmp_path: Path
) -> None:
    rows = accuracy.study(rig, plan, parameters, 2, SEED, steps=2)
    assert rows[1]["full_median_rms_mm"] < 0.3 * rows[0]["full_median_rms_mm"]
    accuracy.draw(rows, tmp_path / "a.png")
    lines = list(table(tmp_path / "a.csv", rows))
    assert [line.split(" | ")[0] for line in lines[1:]] == [f"| {r['sensors']}" for r in rows]
    with (tmp_path / "a.csv").open() as file:
        assert [r["sensors"] for r in csv.DictReader(file)] == [r["sensors"] for r in rows]


def test_postures_study(rig: Rig, plan: PosturePlan, parameters: BaseParameters, tmp_path: Path) -> None:
    sizes, rows = postures.study(rig, plan, parameters, {25: 2, 30: 2}, SEED)
    assert [r["postures"] for r in sizes] == [25, 30]
    assert len(rows) == 25
    zero = [r["number"] for r in rows if not np.isfinite(r["postures_needed"])]
    assert zero == [2, 3, 4, 6, 7, 8, 11, 13, 14, 16, 18, 22]  # those that the simplified model drops
    postures.draw(sizes, rows, tmp_path / "p.png")


def test_exchange_lowers_what_it_is_told_to(plan: PosturePlan, parameters: BaseParameters) -> None:
    blocks = conditioning.placement_blocks(parameters, plan)
    rng = np.random.default_rng(SEED)
    start = conditioning.random_choices(blocks, 4, 10, rng)[-1]
    for criterion in conditioning.CRITERIA.values():
        found = conditioning.exchanged(blocks, start, criterion, 60, rng)
        assert criterion(conditioning.joined(blocks, found)) < criterion(conditioning.joined(blocks, start))
        assert len(set(found)) == 4
        assert len(conditioning.plan_of(plan, found)) == 20


def test_scaling_of_columns_leaves_the_scaled_condition_number() -> None:
    matrix = np.random.default_rng(SEED).standard_normal((40, 5))
    scaled = matrix * [1.0, 10.0, 1.0, 0.1, 5.0]
    assert conditioning.scaled_condition_number(scaled) == pytest.approx(
        conditioning.scaled_condition_number(matrix)
    )
    assert conditioning.condition_number(scaled) > 2 * conditioning.condition_number(matrix)


def test_conditioning_study(rig: Rig, plan: PosturePlan, parameters: BaseParameters, tmp_path: Path) -> None:
    rows = conditioning.study(rig, [("random", plan), ("optimal", plan)], parameters, 2, SEED)
    assert rows[0]["condition_number"] == rows[1]["condition_number"]
    conditioning.draw(rows, tmp_path / "c.png")


def test_predictions_rank() -> None:
    rng = np.random.default_rng(SEED)
    rows = [
        {
            "plan": "random",
            "postures": 50,
            "condition_number": float(k),
            "scaled_condition_number": float(rng.random()),
            "mean_se": float(-k),
            "predicted_se_mm": float(rng.random()),
            "rms_mm": 2.0 * k,
            "median_rms_mm": 2.0 * k,
        }
        for k in range(20)
    ]
    found = {(r["criterion"], r["error"]): r["random"] for r in conditioning.predictions(rows, SEED)}
    assert found["condition_number", "rms_mm"] == "+1.00"
    assert found["mean_se", "rms_mm"] == "-1.00"


def test_simplified_study(rig: Rig, plan: PosturePlan, parameters: BaseParameters, tmp_path: Path) -> None:
    arms = {"wii": (rig, plan, 2)}
    rows = simplified.study(arms, [0.02, 0.2], plan.joint_angles[:20], parameters, SEED)
    assert rows[1]["dropped_true_rms_mm"] > 5 * rows[0]["dropped_true_rms_mm"]
    simplified.draw(rows, tmp_path / "s.png")


def test_crossing() -> None:
    rows = [{"arm": "a", "spread": s, "ratio": s / 0.05, "prediction_ratio": 0.5} for s in (0.01, 0.1)]
    (found,) = simplified.crossings(rows)
    assert found == {
        "arm": "a",
        "ratio_is_1_at_spread": "0.050",
        "prediction_ratio_is_1_at_spread": "above 0.1",
    }


def test_one_foot_postures_stand_and_the_torques_balance(robot: Robot) -> None:
    angles = one_foot_postures(robot, 3, np.random.default_rng(SEED))
    parameters, model = base_parameters(robot, support="right"), robot.model
    com = parameters.regressor(angles) @ parameters.values(standard_parameters(model))
    assert (com > np.array([-0.07, -0.05]) + MARGIN).all()
    assert (com < np.array([0.13, 0.05]) - MARGIN).all()
    # The stance ankle roll axis passes over the foot's point: weight times lever, by hand.
    for q, point in zip(angles, com, strict=True):
        roll = holding_torques(robot, model, q, point)[5]
        assert abs(roll) == pytest.approx(23.0 * 9.81 * abs(point[1]), abs=0.35)


def test_single_support_study(rig: Rig, plan: PosturePlan, tmp_path: Path) -> None:
    one_foot = one_foot_postures(rig.robot, 10, np.random.default_rng(SEED))
    rows, errors = single_support.study(rig, plan, one_foot, [(30, 0), (30, 10)], SEED, 2)
    # More data can only help.
    assert rows[1]["median_predicted_mm"] < rows[0]["median_predicted_mm"]
    assert len(errors) == 25
    single_support.draw(errors, [(30, 0), (30, 10)], tmp_path / "s.png")


def test_monte_carlo_error_of_a_mean() -> None:
    off = np.random.default_rng(SEED).standard_normal((400, 1))
    assert monte_carlo_error(lambda e: float(e.mean()), off) == pytest.approx(0.05, rel=0.2)
    assert rms(np.array([[3.0], [4.0]])) == pytest.approx([np.sqrt(12.5)])
