"""`make bench`: times that are read as ratios within one run, never asserted."""

import dataclasses

import numpy as np
import pytest

from tulip_testbed.identification.estimators import least_squares, solve_least_squares
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.linear_steps import EvaluatedPlan, linear_step
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import design_of
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.regressor import Regression, stacked_regressor
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.rig import preset_rig


def tell_rate(benchmark, postures):
    print(f"\n{benchmark.name}: {postures / benchmark.stats['mean']:.1f} postures per second")


@pytest.fixture
def optimisation(robot, plate, plan):
    problem = planning_problem(robot, plate)
    angles = plan.joint_angles[:50]
    return problem, design_of(problem, angles, plan.swing_pose[:50]), angles


def one_iteration(problem, design, found):
    smooth = objectives(problem.nominal, 1e-3)["condition"].smooth[0]
    return linear_step(problem, EvaluatedPlan(design, found, 5), smooth, np.full(len(design), 0.1))


@pytest.mark.benchmark(group="one iteration of `tulip plan optimal`, 50 postures")
def test_with_analytic_derivatives(benchmark, optimisation):
    problem, design, angles = optimisation
    benchmark(lambda: one_iteration(problem, design, evaluate(problem, design, angles)))


@pytest.mark.benchmark(group="one iteration of `tulip plan optimal`, 50 postures")
def test_with_forward_differences(benchmark, optimisation):
    """Every evaluation brings its derivatives along, so differences cost a little less than this."""
    problem, design, angles = optimisation

    def iteration():
        found = evaluate(problem, design, angles)
        ahead = [evaluate(problem, design + step, angles) for step in 1e-7 * np.eye(design.shape[1])]
        slots = np.stack([(a.inequalities - found.inequalities) / 1e-7 for a in ahead], axis=-1)
        regressor = np.stack([(a.regressor - found.regressor) / 1e-7 for a in ahead], axis=-1)
        found = dataclasses.replace(found, inequality_jacobian=slots, regressor_slopes=regressor)
        return one_iteration(problem, design, found)

    benchmark(iteration)


@pytest.mark.benchmark(group="one posture")
def test_plan_50_random_postures(benchmark, robot, plate):
    benchmark.pedantic(random_postures, (robot, plate, 10, 5, 0), rounds=3)
    tell_rate(benchmark, 50)


@pytest.mark.benchmark(group="one posture")
def test_simulate_5_postures(benchmark, robot, plan):
    rig = preset_rig("wii", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    benchmark.pedantic(run_dynamics, (rig, plan.take(plan.placement == 2), 1), rounds=3)
    tell_rate(benchmark, 5)


@pytest.mark.benchmark(group="identification of 150 postures")
def test_stack_the_regressor(benchmark, parameters, plan):
    benchmark(stacked_regressor, parameters, plan.joint_angles)


@pytest.fixture
def data(parameters, plan):
    matrix = stacked_regressor(parameters, plan.joint_angles)
    rng = np.random.default_rng(0)
    share = rng.uniform(0.3, 0.7, len(plan))
    output = rng.standard_normal(len(matrix))
    numbers = np.arange(1, 26)
    return Regression(
        matrix, output, numbers, parameters.names, plan.placement, np.column_stack([1 - share, share])
    )


@pytest.mark.benchmark(group="identification of 150 postures")
def test_solve_alone(benchmark, data):
    benchmark(solve_least_squares, data.matrix, data.output)


@pytest.mark.benchmark(group="identification of 150 postures")
def test_least_squares_with_clustered_errors(benchmark, data):
    benchmark(least_squares, data)
