"""Where the runs come from: static equilibria solved directly, or the full dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from tulip_testbed.effects.injection import edited
from tulip_testbed.experiments.scenario import Scenario
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.sim.dynamics.dynamic_run import run_experiment
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import Measurements, PosturePlan
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, solve_plan
from tulip_testbed.sim.statics.static_run import run_static


@dataclass(frozen=True)
class Run:
    """What one run of a laboratory hands over and, beside it, the truth.

    Attributes:
        standard: true standard parameters (eq. 5), (n_links, 4) [kg, kg m].
        dropped: number of planned postures that could not be measured.
        true_mass: [kg].
    """

    measurements: Measurements
    standard: np.ndarray
    dropped: int
    true_mass: float


# One outcome a stream: a run, or why it gave none.
Laboratory = Callable[[Sequence[np.random.SeedSequence]], list[Run | str]]


def stream_of(seed: int, run: int) -> np.random.SeedSequence:
    """The random stream of one run: by its number, so neither order nor company matters."""
    return np.random.SeedSequence(seed, spawn_key=(run,))


def laboratory(scenario: Scenario, spread: float | None, dynamics: bool) -> Laboratory:
    """A laboratory that can travel to the workers.

    Args:
        spread: of random true robots, see `sim.random_robots`; None: the nominal robot.
        dynamics: hold every posture in the full dynamics, instead of solving its equilibrium.

    Raises:
        InputError: a plan or a scene that this laboratory cannot stand on.
    """
    rig, plan = scenario.rig, scenario.plan
    model = scenario.true_model() if scenario.adopted else rig.robot.model
    if dynamics:
        return partial(_hold, rig, plan, model, spread)
    return partial(_solve, solve_plan(rig, plan), model, spread)


def _robots(
    model: mujoco.MjModel, spread: float | None, streams: list[np.random.SeedSequence]
) -> list[np.ndarray]:
    """Standard parameters of every run's robot."""
    if spread is None:
        return [standard_parameters(model)] * len(streams)
    return [draw_robot(model, spread, np.random.default_rng(stream)) for stream in streams]


def _hold(
    rig: Rig,
    plan: PosturePlan,
    model: mujoco.MjModel,
    spread: float | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Run | str]:
    of_robot, of_laboratory = _split(streams)
    robots = _robots(model, spread, of_robot)
    return [_hold_one(rig, plan, model, *run) for run in zip(robots, of_laboratory, strict=True)]


def _hold_one(
    rig: Rig, plan: PosturePlan, model: mujoco.MjModel, standard: np.ndarray, stream: np.random.SeedSequence
) -> Run | str:
    seed = int.from_bytes(stream.generate_state(4, np.uint32).tobytes(), "little")
    try:
        held = run_experiment(edited(rig, edit_of(model, standard)), plan, seed)
    except InputError as error:
        return str(error)
    return Run(held.measurements, standard, len(held.dropped), held.true_mass)


def _solve(
    solved_plan: SolvedPlan,
    model: mujoco.MjModel,
    spread: float | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Run | str]:
    of_robot, of_laboratory = _split(streams)
    return _solve_all(solved_plan, np.array(_robots(model, spread, of_robot)), of_laboratory)


def _solve_all(
    solved_plan: SolvedPlan, robots: np.ndarray, streams: list[np.random.SeedSequence]
) -> list[Run | str]:
    try:
        done = run_static(solved_plan, streams, robots)
    except InputError as error:
        if len(streams) == 1:
            return [str(error)]
        # One run without a single posture: which one, the message does not say.
        singly = (_solve_all(solved_plan, robots[k : k + 1], [stream]) for k, stream in enumerate(streams))
        return [outcome for (outcome,) in singly]
    return [Run(r.measurements, r.standard, len(r.dropped), r.true_mass) for r in done]


def _split(
    streams: Sequence[np.random.SeedSequence],
) -> tuple[list[np.random.SeedSequence], list[np.random.SeedSequence]]:
    """Streams of the robots and of the laboratories: the same noise with and without random robots."""
    pairs = [stream.spawn(2) for stream in streams]
    return [robot for robot, _ in pairs], [laboratory for _, laboratory in pairs]
