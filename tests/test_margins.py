"""Margins of plans follow the robot's size, or its description."""

from __future__ import annotations

import dataclasses

import pytest

from tests.scaled_robot import write_scaled_robot
from tulip_testbed.identification.planning.closed_chain import chain_at
from tulip_testbed.identification.planning.constraints import limb_distances
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.optimal_plan import SearchTask, smallest_margins
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning_ranges import (
    Margins,
    leg_length,
    planning_margins,
    planning_ranges,
)
from tulip_testbed.sim.robot import joint_names
from tulip_testbed.sim.scene import nominal_plates

LIGHT = (31.0 / 225.63) ** (1 / 3)  # TULip's scale at a weight of 31 N


def with_table(robot, **table):
    settings = robot.settings | {"planning": robot.settings["planning"] | table}
    return dataclasses.replace(robot, settings=settings)


def test_tulips_margins_are_exactly_those_of_its_published_plans(robot):
    expected = Margins(foot_load=25.0, foot_moment=0.55, leg_clearance=0.01, link_clearance=0.01, lifted=0.02)
    assert planning_margins(robot) == expected


@pytest.fixture
def light(tmp_path):
    return write_scaled_robot(tmp_path / "light", LIGHT)


def test_margins_of_a_light_robot_are_in_proportion(light):
    margins = planning_margins(light)
    assert leg_length(light) == pytest.approx(LIGHT * 0.6449)
    assert margins.foot_load == pytest.approx(25.0 * LIGHT**3, rel=0.01)
    assert margins.foot_moment == pytest.approx(0.55 * LIGHT**4, rel=0.01)


@pytest.mark.slow
def test_a_light_robot_can_be_planned(light):
    problem = planning_problem(light, nominal_plates(light)[0])
    assert problem.weight == pytest.approx(31.0, abs=0.01)
    goal = objectives(problem.nominal, 4.16e-3)["condition"]
    plan = SearchTask(problem, goal, 5, 3, 421, hops=0).run()
    assert plan.made["final_objective"] < plan.made["initial_objective"]
    assert all(margin["value"] > -1e-6 for margin in smallest_margins(problem, plan).values())


def test_the_description_states_margins(robot, plate):
    stated = with_table(robot, foot_load=10, board=0.02, link_clearance=0)
    margins = planning_margins(stated)
    assert (margins.foot_load, margins.board, margins.link_clearance) == (10.0, 0.02, 0.0)
    assert margins.foot_moment == 0.55
    assert planning_ranges(stated) == planning_ranges(robot)
    assert planning_problem(stated, plate).margins == margins


def test_links_above_both_legs_belong_to_neither(foreign):
    """The humanoid's legs hang from a pelvis below a waist of three joints."""
    robot = foreign["humanoid"]
    problem = planning_problem(robot, nominal_plates(robot)[0])
    frames = problem.parameters.tree.frames
    assert [[frames[limb[0]] for limb in leg] for leg in problem.limbs] == [
        ["right_shin", "right_thigh"],
        ["left_shin", "left_thigh"],
    ]
    stand = robot.model.key("stand").qpos
    angles = stand[[robot.model.joint(name).qposadr[0] for name in joint_names(robot.model)]]
    distance, _ = limb_distances(problem, chain_at(problem, angles[None]))
    assert distance.min() > problem.margins.leg_clearance
