"""What the laboratory costs beside raw `mujoco.rollout` of the same model, states and inputs."""

import time
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from tulip_testbed.sim.dynamics.dynamic_run import run_placement
from tulip_testbed.sim.dynamics.hold import CLAMP_IMPEDANCE, hold, move, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.rig import preset_rig

INPUTS = mujoco.mjtState.mjSTATE_USER
START = mujoco.mjtState.mjSTATE_FULLPHYSICS
ROUNDS = 5


def state(stand: Stand, which: mujoco.mjtState) -> np.ndarray:
    values = np.empty(mujoco.mj_stateSize(stand.model, which))
    mujoco.mj_getState(stand.model, stand.data, values, which)
    return values


def laboratory(stand: Stand, angles: np.ndarray) -> None:
    """Put down, then move to and hold every posture."""
    put_down(stand, angles[0])
    hold(stand, angles[0])
    for before, planned in pairwise(angles):
        move(stand, before, planned, planned)
        hold(stand, planned)


def recorded(stand: Stand, angles: np.ndarray, monkeypatch) -> tuple[np.ndarray, np.ndarray]:
    """First state and the inputs of every step of the laboratory's work, (steps, inputs)."""
    inputs, first, run = [], [], stand.run

    def log_and_run(duration: float) -> None:
        if not first:
            first.append(state(stand, START))
        steps = max(1, round(duration / stand.model.opt.timestep))
        inputs.append(np.tile(state(stand, INPUTS), (steps, 1)))
        run(duration)

    with monkeypatch.context() as patch:
        patch.setattr(stand, "run", log_and_run)
        laboratory(stand, angles)
    return first[0], np.vstack(inputs)


@pytest.mark.benchmark(group="laboratory")
def test_laboratory_against_raw_rollout(benchmark, robot, plan, monkeypatch):
    """Ratio of the best of several rounds each, taken in turns; the goal is 1.15."""
    stand = Stand(preset_rig("wii", robot), plates(robot, plan))
    angles = plan.joint_angles[plan.placement == 1]
    first, inputs = recorded(stand, angles, monkeypatch)
    model = stand.model
    raw_data = mujoco.MjData(model)
    times: dict[str, list[float]] = {"laboratory": [], "rollout": []}
    for _ in range(ROUNDS):
        began = time.perf_counter()
        laboratory(stand, angles)
        times["laboratory"].append(time.perf_counter() - began)
        end = stand.data.qpos.copy()
        stand.reset(angles[0], first[1:8])  # the model's friction as it was
        model.eq_solimp[stand.clamps, :2] = CLAMP_IMPEDANCE
        began = time.perf_counter()
        states, _ = rollout.rollout(model, raw_data, first, inputs[None], control_spec=INPUTS)
        times["rollout"].append(time.perf_counter() - began)
        # The same work: only the fading of clamps and friction is not replayed.
        assert states[0, -1, 1 : 1 + model.nq] == pytest.approx(end, abs=2e-3)
    best = {name: min(values) for name, values in times.items()}
    rates = ", ".join(f"{name} {len(inputs) / seconds:.0f} steps/s" for name, seconds in best.items())
    ratio = best["laboratory"] / best["rollout"]
    print(f"\n{rates}; ratio of times {ratio:.3f} over {len(inputs)} steps")
    benchmark.pedantic(laboratory, (stand, angles), rounds=1)


def plates(robot, plan) -> np.ndarray:
    rig = preset_rig("ideal", robot)
    return run_placement(rig, plan, 1, frozenset(), np.random.SeedSequence(1))[0].true_plates
