"""`make bench`: physics steps per second of the composer laboratory beside raw rollouts of its model."""

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.rig import preset_rig

STEPS = 5000  # physics steps of 1 ms


@pytest.fixture
def stand(model):
    return model.key("stand").qpos[7:]


def tell_rate(benchmark):
    print(f"\n{benchmark.name}: {STEPS / benchmark.stats['min']:.0f} physics steps per second")


def drive(environment, command, period):
    environment.reset()
    for _ in range(STEPS // period):
        environment.step(command)


@pytest.mark.benchmark(group=f"{STEPS} physics steps of one robot")
@pytest.mark.parametrize(("period", "buffer"), [(20, 1), (20, 300), (1, 1)])
def test_composer(benchmark, robot, stand, period, buffer):
    """An action every `period` steps, the cells as a mean of `buffer` samples."""
    environment = laboratory_environment(
        preset_rig("wii", robot),
        stand,
        control_timestep=1e-3 * period,
        observable_options={"cells": {"buffer_size": buffer, "aggregator": "mean"}},
        seed=0,
    )
    benchmark.pedantic(drive, (environment, stand, period), rounds=5, warmup_rounds=1)
    tell_rate(benchmark)


@pytest.mark.benchmark(group=f"{STEPS} physics steps of one robot")
def test_raw_rollout(benchmark, robot, stand):
    """The same model from the same state with the same command, in one call."""
    environment = laboratory_environment(preset_rig("wii", robot), stand)
    environment.reset()
    model, data = environment.physics.model.ptr, environment.physics.data.ptr
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    command = np.tile(stand, (1, STEPS, 1))
    work = mujoco.MjData(model)
    benchmark.pedantic(rollout.rollout, (model, work, state[None], command), rounds=5, warmup_rounds=1)
    tell_rate(benchmark)
