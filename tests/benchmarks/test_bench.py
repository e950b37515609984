"""`make bench`: times that are read as ratios within one run, never asserted."""

import dataclasses

import numpy as np
import pytest

from identification.estimators import least_squares, solve_least_squares
from identification.postures import random_postures
from identification.regressor import Regression, stacked_regressor
from sim.laboratory import run_experiment
from sim.rig import preset_rig
from tools.study import part_of


def tell_rate(benchmark, postures):
    print(f"\n{benchmark.name}: {postures / benchmark.stats['mean']:.1f} postures per second")


@pytest.mark.benchmark(group="one posture")
def test_plan_50_random_postures(benchmark, robot, plate):
    benchmark.pedantic(random_postures, (robot, plate, 10, 5, 0), rounds=3)
    tell_rate(benchmark, 50)


@pytest.mark.benchmark(group="one posture")
def test_simulate_5_postures(benchmark, robot, plan):
    rig = preset_rig("wii", robot)
    rig = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=0))
    benchmark.pedantic(run_experiment, (rig, part_of(plan, plan.placement == 2), 1), rounds=3)
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
