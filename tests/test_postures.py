"""Random feasible postures keep every promise, checked through MuJoCo."""

import dataclasses

import numpy as np
import pytest

from tests.holding import check_standing
from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.planning.footing import footing
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import design_of
from tulip_testbed.identification.planning_ranges import planning_margins, planning_ranges
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import stacked_regressor


def test_shipped_plan_keeps_every_constraint(robot, plan):
    check_standing(robot, plan)


def test_shipped_sets_have_the_condition_numbers_of_random_postures(parameters, plan):
    """Three sets of 50: the paper's random starts had 647 to 926, our ranges are our own."""
    for first in (1, 11, 21):
        chosen = (plan.placement >= first) & (plan.placement < first + 10)
        assert chosen.sum() == 50
        assert 600 < np.linalg.cond(stacked_regressor(parameters, plan.joint_angles[chosen])) < 1300


def test_same_seed_same_plan(robot, plate):
    first, second, other = (random_postures(robot, plate, 2, 3, seed) for seed in (4, 4, 5))
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


def test_progress_counts_every_posture(robot, plate):
    observed = []
    random_postures(robot, plate, 3, 2, 1, progress=observed.append)
    assert sum(observed) == 6


def test_impossible_ranges_say_what_blocks(robot, plate):
    ranges = dataclasses.replace(planning_ranges(robot), least_height=0.8)
    with pytest.raises(InputError, match=r"admit no posture: 3000 tries, none feasible; blocked by .*\("):
        random_postures(robot, plate, 1, 1, 0, ranges)
