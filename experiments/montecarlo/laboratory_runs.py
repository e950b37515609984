"""Where the runs come from: static equilibria solved directly, or the full dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.true_robot import true_base_parameters, true_model
from tulip_testbed.experiments.imperfections import drawn
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.validate import held_balance
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

# One outcome a stream, or why there is none.
Source = Callable[[Sequence[np.random.SeedSequence]], list[Outcome | str]]


def stream_of(seed: int, run: int) -> np.random.SeedSequence:
    """Return the random stream of one run: by its number, so neither order nor company matters."""
    return np.random.SeedSequence(seed, spawn_key=(run,))


@dataclass(frozen=True, eq=False)
class OrdinaryOutcome(Outcome):
    """Outcome of an experiment in an ordinary laboratory.

    Attributes:
        base: base parameters of the robot that stood there, with its own lengths, (p,) [m].
    """

    base: np.ndarray


def source_of(
    laboratory: Laboratory,
    plan: PosturePlan,
    spread: float | None,
    engine: str,
    imperfections: float = 0.0,
) -> Source:
    """Make what gives the runs, so that it can travel to the workers.

    Args:
        spread: of random true robots, see `sim.random_robots`; None: the nominal robot.
        engine: see `Laboratory.run`.
        imperfections: scale of the ordinary imperfections of every run's laboratory; 0: it is exact.

    Raises:
        InputError: a plan or a scene that this laboratory cannot stand on.
    """
    rig = laboratory.rig
    model = true_model(rig) if laboratory.known else rig.robot.model
    if imperfections:
        laboratory.check(plan, engine)
        near = _similar(laboratory, plan, imperfections) if engine == "statics" else None
        return partial(_ordinary, laboratory, plan, model, spread, engine, imperfections, near)
    if engine == "dynamics":
        return partial(_hold, rig, plan, model, spread)
    return partial(_solve, solve_plan(rig, plan), model, spread)


def _similar(laboratory: Laboratory, plan: PosturePlan, scale: float) -> SolvedPlan | None:
    """Solve the plan in one ordinary laboratory, from whose equilibria those of all runs are near."""
    try:
        return solve_plan(drawn(laboratory, scale, np.random.SeedSequence(0)).rig, plan)
    except InputError:  # no laboratory can be built at such a scale: every run says so itself
        return None


def _robots(
    model: mujoco.MjModel, spread: float | None, streams: list[np.random.SeedSequence]
) -> list[np.ndarray]:
    """Return the standard parameters of every run's robot."""
    if spread is None:
        return [standard_parameters(model)] * len(streams)
    return [draw_robot(model, spread, np.random.default_rng(stream)) for stream in streams]


def _hold(
    rig: Rig,
    plan: PosturePlan,
    model: mujoco.MjModel,
    spread: float | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Outcome | str]:
    of_robot, of_laboratory = _split(streams)
    robots = _robots(model, spread, of_robot)
    return [_hold_one(rig, plan, model, *run) for run in zip(robots, of_laboratory, strict=True)]


def _hold_one(
    rig: Rig, plan: PosturePlan, model: mujoco.MjModel, standard: np.ndarray, stream: np.random.SeedSequence
) -> Outcome | str:
    try:
        held = run_dynamics(edited(rig, edit_of(model, standard)), plan, _number_of(stream))
        _check_balance(held, rig)
    except InputError as error:
        return str(error)
    return replace(held, truth=replace(held.truth, standard=standard))


def _solve(
    solved_plan: SolvedPlan,
    model: mujoco.MjModel,
    spread: float | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Outcome | str]:
    of_robot, of_laboratory = _split(streams)
    return _solve_all(solved_plan, np.array(_robots(model, spread, of_robot)), of_laboratory)


def _solve_all(
    solved_plan: SolvedPlan, robots: np.ndarray, streams: list[np.random.SeedSequence]
) -> list[Outcome | str]:
    try:
        done = run_statics(solved_plan, streams, robots)
    except InputError as error:
        if len(streams) == 1:
            return [str(error)]
        # One run without a single posture: which one, the message does not say.
        singly = (_solve_all(solved_plan, robots[k : k + 1], [stream]) for k, stream in enumerate(streams))
        return [outcome for (outcome,) in singly]
    return list(done)


def _ordinary(
    laboratory: Laboratory,
    plan: PosturePlan,
    model: mujoco.MjModel,
    spread: float | None,
    engine: str,
    scale: float,
    near: SolvedPlan | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Outcome | str]:
    of_robot, of_laboratory, of_members = _split(streams, 3)
    runs = zip(_robots(model, spread, of_robot), of_laboratory, of_members, strict=True)
    found: list[Outcome | str] = []
    for standard, stream, members in runs:
        try:
            edit = None if spread is None else edit_of(model, standard)
            found.append(_ordinary_one(drawn(laboratory, scale, members), plan, edit, engine, near, stream))
        except InputError as error:
            found.append(str(error))
    return found


def _ordinary_one(
    laboratory: Laboratory,
    plan: PosturePlan,
    edit: Callable[[mujoco.MjSpec], None] | None,
    engine: str,
    near: SolvedPlan | None,
    stream: np.random.SeedSequence,
) -> OrdinaryOutcome:
    """Carry out one experiment in a laboratory of its own.

    Raises:
        InputError: a laboratory in which nothing can be measured.
    """
    laboratory.check_effects(plan, engine)
    rig = laboratory.rig if edit is None else edited(laboratory.rig, edit)
    if engine == "dynamics":
        outcome = run_dynamics(rig, plan, _number_of(stream))
        _check_balance(outcome, rig)
    else:
        (outcome,) = run_statics(solve_plan(rig, plan, near), [stream])
    base = true_base_parameters(rig, common_support(plan.support))
    return OrdinaryOutcome(outcome.measurements, outcome.truth, base)


def _check_balance(held: Outcome, rig: Rig) -> None:
    """Refuse a run whose holds are out of balance, so that it counts as one that could not be identified.

    Raises:
        InputError: names the balance and its bound.
    """
    for check in held_balance(held.truth, rig, whole=False):
        if check.result == "fail":
            raise InputError(f"{check.name}: {check.source}")


def _number_of(stream: np.random.SeedSequence) -> int:
    return int.from_bytes(stream.generate_state(4, np.uint32).tobytes(), "little")


def _split(streams: Sequence[np.random.SeedSequence], parts: int = 2) -> list[list[np.random.SeedSequence]]:
    """Streams of the robots, of the laboratories' noise and of their imperfections, by run.

    So the laboratory's stream is the same with and without random robots or imperfections.
    """
    children = [stream.spawn(parts) for stream in streams]
    return [[child[k] for child in children] for k in range(parts)]
