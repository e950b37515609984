"""Where the runs come from: the whole dynamics anew, or one held experiment read anew."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from experiments.scenario import Scenario
from experiments.setting_up import tries
from experiments.terminal import progress
from identification.base_parameters import standard_parameters
from sim.errors import InputError
from sim.laboratory import Experiment, read_again, run_experiment
from sim.measurements import Measurements, PosturePlan
from sim.model import load_model
from sim.random_robots import draw_robot, edit_of
from sim.rig import Rig


@dataclass(frozen=True)
class Run:
    """What one run of the laboratory hands over and, beside it, the truth.

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


def dynamic_laboratory(scenario: Scenario, spread: float | None) -> Laboratory:
    """Every run held in the full dynamics.

    Args:
        spread: of random true robots, see `sim.random_robots`; None: the nominal robot.
    """
    return partial(_hold, scenario.rig, scenario.plan, load_model(scenario.rig.robot), spread)


def reading_laboratory(scenario: Scenario, workers: int) -> Laboratory:
    """One experiment held in the full dynamics; every run reads it through the sensors anew.

    Sensor noise, recorded placements and weighing are fresh in every run; what the robot and the boards
    really did (tracking errors, placements, dropped postures) is that of the one experiment.
    """
    with progress("holding postures once", tries(scenario)) as advance:
        held = run_experiment(scenario.rig, scenario.plan, scenario.seed, workers, advance)
    standard = standard_parameters(load_model(scenario.rig.robot))
    return partial(_read, scenario.rig, scenario.plan, held, standard)


def _hold(
    rig: Rig,
    plan: PosturePlan,
    model: mujoco.MjModel,
    spread: float | None,
    streams: Sequence[np.random.SeedSequence],
) -> list[Run | str]:
    return [_hold_one(rig, plan, model, spread, stream) for stream in streams]


def _hold_one(
    rig: Rig,
    plan: PosturePlan,
    model: mujoco.MjModel,
    spread: float | None,
    stream: np.random.SeedSequence,
) -> Run | str:
    robot, laboratory = stream.spawn(2)
    standard = standard_parameters(model)
    if spread is not None:
        standard = draw_robot(model, spread, np.random.default_rng(robot))
        rig = dataclasses.replace(rig, edit=edit_of(model, standard))
    seed = int.from_bytes(laboratory.generate_state(4, np.uint32).tobytes(), "little")
    try:
        held = run_experiment(rig, plan, seed)
    except InputError as error:
        return str(error)
    return Run(held.measurements, standard, len(held.dropped), held.true_mass)


def _read(
    rig: Rig,
    plan: PosturePlan,
    held: Experiment,
    standard: np.ndarray,
    streams: Sequence[np.random.SeedSequence],
) -> list[Run | str]:
    again = [read_again(rig, plan, held, np.random.default_rng(stream)) for stream in streams]
    return [Run(measured, standard, len(held.dropped), held.true_mass) for measured in again]
