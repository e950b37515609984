"""Where the runs come from: static equilibria solved directly, or the full dynamics."""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

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
from tulip_testbed.sim.dynamics.moving_run import run_motion
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
        sizes: of the hidden effects, by the name of every number [SI].
    """

    base: np.ndarray
    sizes: dict[str, float]


def source_of(
    laboratory: Laboratory, plan: PosturePlan, spread: float | None, engine: str, imperfections: float = 0.0
) -> Source:
    """Make what gives the runs, so that it can travel to the workers.

    Args:
        spread: of random true robots, see `sim.random_robots`; None: the nominal robot.
        engine: see `Laboratory.run`.
        imperfections: scale of the ordinary imperfections of every run's laboratory; 0: it is exact.
    """
    rig, solved = laboratory.rig, None
    model = true_model(rig) if laboratory.known else rig.robot.model
    if imperfections:
        laboratory.check(plan, engine)
        if engine == "statics":
            with suppress(InputError):  # no laboratory can be built at such a scale: every run says so itself
                similar = drawn(laboratory, imperfections, np.random.SeedSequence(0))
                solved = solve_plan(similar.rig, plan)
    elif engine == "statics":
        solved = solve_plan(rig, plan)

    def repeated(streams: Sequence[np.random.SeedSequence]) -> list[Outcome | str]:
        # So the laboratory's stream is the same with and without random robots or imperfections.
        parts = [stream.spawn(3) for stream in streams]
        robots = [
            standard_parameters(model)
            if spread is None
            else draw_robot(model, spread, np.random.default_rng(of_robot))
            for of_robot, _, _ in parts
        ]
        if solved is not None and not imperfections:
            return _solved(solved, np.array(robots), [of_noise for _, of_noise, _ in parts])
        outcomes: list[Outcome | str] = []
        for standard, (_, of_noise, of_members) in zip(robots, parts, strict=True):
            try:
                if imperfections:
                    outcomes.append(ordinary(standard, of_noise, of_members))
                else:
                    outcome = _held(edited(rig, edit_of(model, standard)), plan, of_noise)
                    truth = replace(outcome.truth, standard=standard)
                    outcomes.append(replace(outcome, truth=truth))
            except InputError as error:
                outcomes.append(str(error))
        return outcomes

    def ordinary(
        standard: np.ndarray, of_noise: np.random.SeedSequence, of_members: np.random.SeedSequence
    ) -> OrdinaryOutcome:
        """Carry out one experiment in a laboratory of its own; statics starts from a similar one."""
        own = drawn(laboratory, imperfections, of_members)
        own.check_effects(plan, engine)
        rig = own.rig if spread is None else edited(own.rig, edit_of(model, standard))
        if engine == "dynamics":
            outcome = _held(rig, plan, of_noise)
        else:
            (outcome,) = run_statics(solve_plan(rig, plan, solved), [of_noise])
        base = true_base_parameters(rig, common_support(plan.support))
        sizes: Counter[str] = Counter()
        for effect in own.hidden:
            sizes.update(effect.named_values)
        return OrdinaryOutcome(outcome.measurements, outcome.truth, base, dict(sizes))

    return repeated


def _solved(
    plan: SolvedPlan, robots: np.ndarray, streams: list[np.random.SeedSequence]
) -> list[Outcome | str]:
    """Carry out experiments by statics, all at once."""
    try:
        return list(run_statics(plan, streams, robots))
    except InputError as error:
        if len(streams) == 1:
            return [str(error)]
        # One run without a single posture: which one, the message does not say.
        singly = (_solved(plan, robots[k : k + 1], [stream]) for k, stream in enumerate(streams))
        return [outcome for (outcome,) in singly]


def _held(rig: Rig, plan: PosturePlan, stream: np.random.SeedSequence) -> Outcome:
    """Hold or move in the full dynamics; refuse holds out of balance: the run counts as failed."""
    seed = int.from_bytes(stream.generate_state(4, np.uint32).tobytes(), "little")
    if plan.motion is not None:
        moved = run_motion(rig, plan, seed)
        return Outcome(moved.measurements, moved.truth)
    outcome = run_dynamics(rig, plan, seed)
    for check in held_balance(outcome.truth, rig, whole=False):
        if check.result == "fail":
            raise InputError(f"{check.name}: {check.source}")
    return outcome
