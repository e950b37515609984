"""Random postures and their margins: support polygon, clearance, boards, size of the robot."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.posed import check_standing
from tulip_testbed.base.errors import InputError
from tulip_testbed.identification import postures
from tulip_testbed.identification.feasibility import (
    boards_fit,
    foot_clearance,
    place_polygon,
    predicted_cell_loads,
    predicted_foot_loads,
    stability_margin,
    support_polygon,
)
from tulip_testbed.identification.planning.footing import footing
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import design_of
from tulip_testbed.identification.planning_ranges import Margins, planning_margins, planning_ranges
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements import lay_boards

SOLE = np.array([[0.13, 0.05], [0.13, -0.05], [-0.07, -0.05], [-0.07, 0.05]])


def test_margin_of_a_rectangle():
    polygon = support_polygon(SOLE)
    assert stability_margin(np.array([0.03, 0.0]), polygon) == pytest.approx(0.05)
    assert stability_margin(np.array([0.12, 0.0]), polygon) == pytest.approx(0.01)
    assert stability_margin(np.array([0.15, 0.0]), polygon) == pytest.approx(-0.02)


@pytest.mark.parametrize(
    ("pose", "clearance"),
    [([0, 0.2, 0], 0.1), ([0, 0.1, 0], 0.0), ([0, 0.05, 0], 0.0), ([0.5, 0.2, 0], np.hypot(0.3, 0.1))],
)
def test_clearance_between_feet(pose, clearance):
    assert foot_clearance(SOLE, place_polygon(SOLE, np.array(pose))) == pytest.approx(clearance, abs=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(x=st.floats(-0.05, 0.1), y=st.floats(0.0, 0.2), step=st.floats(-0.12, 0.12))
def test_predicted_loads_carry_the_weight_at_the_com(plate, x, y, step):
    com, ankles = np.array([x, y]), np.array([[0.0, 0.0], [step, 0.2]])
    soles = np.array([SOLE, SOLE + ankles[1]])
    boards = lay_boards(soles, plate.size, 0.01)
    share, cop = predicted_foot_loads(com, ankles)
    cells = predicted_cell_loads(share, cop, boards, plate, 225.63).reshape(2, 4)
    own = plate.mass * 9.81
    assert cells.sum() == pytest.approx(225.63 + 2 * own)
    positions = plate.cells + boards[:, None, :2]
    moment = ((cells - own / 4)[..., None] * positions).sum(axis=(0, 1))
    if 0.02 < (com - ankles[0]) @ ankles[1] / (ankles[1] @ ankles[1]) < 0.98:
        assert moment / 225.63 == pytest.approx(com, abs=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(x=st.floats(-0.12, 0.12), y=st.floats(0.12, 0.28), yaw=st.floats(-0.52, 0.52))
def test_boards_lie_parallel_apart_and_under_their_feet(plate, x, y, yaw):
    soles = np.array([SOLE, place_polygon(SOLE, np.array([x, y, yaw]))])
    boards = lay_boards(soles, plate.size, 0.01)
    assert (boards[:, 2] == 0).all()
    assert boards[1, 1] - boards[0, 1] >= plate.size[1] + 0.01 - 1e-12
    if boards_fit(soles, boards, plate):
        assert (np.abs(soles - boards[:, None, :2]) <= plate.size / 2 + 1e-9).all()


def test_shipped_plan_keeps_every_constraint(robot, plan):
    check_standing(robot, plan)


def test_shipped_sets_have_the_condition_numbers_of_random_postures(parameters, plan):
    """Three sets of 50: the paper's random starts had 647 to 926, our ranges are our own."""
    for first in (1, 11, 21):
        chosen = (plan.placement >= first) & (plan.placement < first + 10)
        assert chosen.sum() == 50
        assert 600 < np.linalg.cond(stacked_regressor(parameters, plan.joint_angles[chosen])) < 1300


def test_same_seed_same_plan(robot, plate):
    counted: list[int] = []
    first, second, other = (
        random_postures(robot, plate, 2, 3, seed, progress=counted.append) for seed in (4, 4, 5)
    )
    assert sum(counted) == 3 * len(first)
    assert first.joint_angles.tobytes() == second.joint_angles.tobytes()
    assert not np.array_equal(first.joint_angles, other.joint_angles)
    assert first.placement.tolist() == [1, 1, 1, 2, 2, 2]


def test_soles_keep_their_margin_by_the_planners_loads_too(robot, plate):
    """Centres of pressure as feed-forward chooses them, without what it allows for friction."""
    margins = dataclasses.replace(planning_margins(robot), foot_moment=0.0)
    problem = planning_problem(robot, plate, margins=margins)
    plan = random_postures(robot, plate, 6, 5, 431)
    design = design_of(problem, plan.joint_angles, plan.swing_pose)
    foot = footing(problem, np.column_stack([design[:, [0, 1, 6, 7, 8]], np.zeros((len(plan), 3))]))
    assert foot.soles.min() >= problem.ranges.sole_margin - 1e-9


def test_impossible_ranges_say_what_blocks(robot, plate, monkeypatch):
    monkeypatch.setattr(postures, "ATTEMPTS", 300)
    ranges = dataclasses.replace(planning_ranges(robot), least_height=0.8)
    with pytest.raises(InputError, match=r"admit no posture: 300 tries, none feasible; blocked by .*\("):
        random_postures(robot, plate, 1, 1, 0, ranges)


def test_many_postures_of_a_placement_are_no_impossible_ranges(robot, plate, monkeypatch):
    monkeypatch.setattr(postures, "ATTEMPTS", 300)
    assert len(random_postures(robot, plate, 1, 30, 0)) == 30


def test_tulips_margins_are_exactly_those_of_its_published_plans(robot):
    expected = Margins(foot_load=25.0, foot_moment=0.55, link_clearance=0.01, lifted=0.02)
    assert planning_margins(robot) == expected


def test_the_description_states_margins(robot, plate):
    table = robot.settings["planning"] | {"foot_load": 10, "board": 0.02, "link_clearance": 0}
    stated = dataclasses.replace(robot, settings=robot.settings | {"planning": table})
    margins = planning_margins(stated)
    assert (margins.foot_load, margins.board, margins.link_clearance) == (10.0, 0.02, 0.0)
    assert margins.foot_moment == 0.55
    assert planning_ranges(stated) == planning_ranges(robot)
    assert planning_problem(stated, plate).margins == margins


def test_margins_are_in_proportion_to_the_weight(robot, foreign):
    weight, other = (float(one.model.body_mass.sum()) for one in (robot, foreign["humanoid"]))
    assert planning_margins(foreign["humanoid"]).foot_load == pytest.approx(25.0 * other / weight, rel=0.01)
