"""From the command line's options to a scenario or a plan; what cannot work is refused before it begins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tulip_testbed.effects.injection import check_built
from tulip_testbed.effects.instance import EffectInstance, check_instance, check_laboratory, injected
from tulip_testbed.effects.random_effects import RANDOM, read_effects
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.rig_folder import RIG_FILE, read_rig
from tulip_testbed.experiments.run_folder import check_new
from tulip_testbed.experiments.scenario import DEFAULT_PLAN, Scenario
from tulip_testbed.experiments.terminal import progress
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, common_support
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.identification.rank import labels, require_identifiable
from tulip_testbed.identification.regressor import ENCODER_SD, encoder_blur, stacked_regressor
from tulip_testbed.sim.errors import InputError, shortened
from tulip_testbed.sim.measurements import PosturePlan, read_plan
from tulip_testbed.sim.plates import plate_geometry
from tulip_testbed.sim.procedure import check_support
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_model, load_robot, sha256
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.scene_check import check_scene


def at_least(option: str, value: int, least: int) -> None:
    """Refuse a number below `least`."""
    if value < least:
        raise InputError(f"{option}: found {value}, expected {least} or more")


def read_scenario(
    plan: Path | None,
    preset: str,
    seed: int,
    robot: Path,
    workers: int,
    rig: Path | None = None,
    effects: Sequence[str] = (),
    statics: bool = False,
) -> Scenario:
    """A laboratory with a plan that fits it; the shipped plan if `plan` is None.

    Args:
        rig: folder of the effects that the laboratory is known to have.
        effects: to hide in it, as on the command line. statics: whether it is the static laboratory.

    Raises:
        InputError: what cannot be run.
    """
    at_least("--seed", seed, 0)
    at_least("--workers", workers, 1)
    described = described_robot(robot)
    made = plan_for(described, plan)
    nominal = preset_rig(preset, described)
    check_scene(nominal)
    placements = np.unique(made.placement).tolist()
    adopted = adopted_effects(rig, described, placements)
    for found in adopted:
        check_laboratory(found, statics, f"--rig {rig}")
    hidden = read_effects(effects, described, placements, seed, statics, "--effect")
    for text, found in zip(effects, hidden, strict=True):
        _check_built(nominal, found, text)
    changed = injected(injected(nominal, adopted), hidden)
    return Scenario(changed, made, seed, preset, adopted, hidden, statics)


def _check_built(rig: Rig, found: EffectInstance, text: str) -> None:
    """Refuse an effect with which there is no robot: more taken from a link than its mass.

    Raises:
        InputError: names the effect (not its size, where it was drawn).
    """
    try:
        check_built(injected(rig, [found]))
    except InputError as error:
        raise InputError(
            f"--effect {shortened(text)}: found a laboratory that cannot be built, expected one that can: "
            f"{'give another --seed' if text == RANDOM else error}"
        ) from None


def adopted_effects(rig: Path | None, robot: Robot, placements: Sequence[int]) -> tuple[EffectInstance, ...]:
    """The effects of a rig folder, none if `rig` is None, for an experiment with these placements.

    Raises:
        InputError: a rig that does not fit.
    """
    if rig is None:
        return ()
    found = read_rig(rig, robot)
    for instance in found:
        check_instance(instance, robot, placements, f"{rig / RIG_FILE}")
    return found


def plan_for(robot: Robot, plan: Path | None) -> PosturePlan:
    """A plan that fits the robot; the shipped one, which is TULip's, if `plan` is None.

    Raises:
        InputError: no such plan, or one for another model.
    """
    if plan is None and sha256(robot.model) != sha256(load_robot().model):
        raise InputError(
            f"{robot.path}: found no plan for this robot: the shipped one is TULip's. Make one with "
            f"`tulip postures --random --robot {robot.path} --out PLAN` and give its name"
        )
    return read_plan(plan or DEFAULT_PLAN, robot, load_model(robot))


def check_plan(robot: Robot, plan: Path | None) -> PosturePlan:
    """A plan that fits the robot and would identify it; the shipped one if `plan` is None.

    Raises:
        InputError: see `plan_for` and `identifiable_regressor`; a scene or a support that no laboratory
            stands on.
    """
    made = plan_for(robot, plan)
    check_scene(preset_rig("ideal", robot))
    check_support(made)
    identifiable_regressor(str(plan or DEFAULT_PLAN), made, planned_parameters(robot, made))
    return made


def tries(scenario: Scenario) -> int:
    """How many postures will be held, repeats included."""
    plan = scenario.plan
    return len(plan) + (min(scenario.rig.protocol.repeats, len(plan)) if plan.postures == len(plan) else 0)


def enough(where: str, postures: int, parameters: BaseParameters) -> None:
    """Refuse fewer data points than parameters."""
    if 2 * postures < (count := len(parameters.names)):
        raise InputError(f"{where}: found {postures} postures, too few for {count} base parameters")


def planned_parameters(robot: Robot, plan: PosturePlan) -> BaseParameters:
    """The base parameters that a plan's postures can tell."""
    return base_parameters(robot, support=common_support(plan.support, "plan"))


def true_parameters(scenario: Scenario) -> BaseParameters:
    """The base parameters that a scenario's plan can tell, with the lengths that are known to be true."""
    model = scenario.true_model() if scenario.adopted else None
    return base_parameters(scenario.rig.robot, model, common_support(scenario.plan.support, "plan"))


def identifiable_regressor(source: str, plan: PosturePlan, parameters: BaseParameters) -> np.ndarray:
    """The regressor (2m, p) of a plan whose postures, if all could be held, would identify the robot.

    Raises:
        InputError: too few postures, or such that cannot tell all parameters apart.
    """
    enough(source, len(plan), parameters)
    matrix = stacked_regressor(parameters, plan.joint_angles)
    names = labels(np.arange(1, matrix.shape[1] + 1), parameters.names)
    require_identifiable(matrix, names, source, encoder_blur(parameters, plan.joint_angles, ENCODER_SD))
    return matrix


def draw_plan(
    robot: Robot,
    parameters: BaseParameters,
    placements: int,
    per: int,
    seed: int,
    plan: Path | None,
    out: Path | None,
) -> PosturePlan:
    """Random postures for `--random`; nothing is written yet.

    Raises:
        InputError: options that do not go together, or ranges that admit nothing.
    """
    if plan is not None or out is None:
        raise InputError("--random: give the name of the new plan as --out PLAN, and no plan to read")
    at_least("--placements", placements, 1)
    at_least("--per-placement", per, 1)
    at_least("--seed", seed, 0)
    enough("--placements, --per-placement", placements * per, parameters)
    check_new(out)
    check_scene(preset_rig("ideal", robot))
    geometry = plate_geometry(load_scene(robot), "right")
    with progress("drawing postures", placements * per) as advance:
        return random_postures(robot, geometry, placements, per, seed, progress=advance)
