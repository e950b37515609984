"""Compute signatures: the error of the centre of pressure (CoP) that an effect makes in every posture.

The CoP that the plates measure is compared with the one that the measured angles and the nominal base
parameters predict. A fit of the base parameters to such data absorbs a part of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.discovery.nominal_laboratory import without_noise
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Effect, Values
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ROWS, residuals
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

NINETY = 1.645  # s.d.: nine in ten of the values that a careful laboratory may have are smaller
SEED = 21  # of sensors and dry friction
RUNS = 20  # without any effect, for the noise
# On what the examples act, by the word for the target in a usage text.
TARGETS = {
    "": "",
    "JOINT": "right_knee",
    "PLATE": "left",
    "PLATE.CORNER": "left.front_left",
    "LINK": "right_lower_leg",
    "FOOT.CORNER": "right_foot.front_left",
    "FOOT": "left",
    "FOOT.CHANNEL": "left.my",
    "FOOT.CHANNEL.LOAD": "left.my.fz",
    "PLACEMENT": "3",
}
OTHER_TARGETS = {"payload": "torso", "payload-step": "torso"}
CHOSEN = {"swapped-cells": (0.0, 2.0), "logged-command": (1.0,)}  # values of effects that have no size


@dataclass(frozen=True, eq=False)
class Signature:
    """An effect's error of the CoP, by the postures as they were measured.

    Attributes:
        observed: the measurements without noise.
        error: measured minus predicted CoP (x, y), (m, 2) [mm].
        simulated: whether the static laboratory simulated it; otherwise the effect's prediction gave it.
    """

    instance: EffectInstance
    observed: Observation
    error: np.ndarray
    simulated: bool


def example(effect: Effect, robot: Robot) -> EffectInstance:
    """Return an effect at the size that nine in ten plausible ones stay below, on a usual target."""
    target = OTHER_TARGETS.get(effect.name, TARGETS[effect.targets.word])
    values: Values = CHOSEN.get(effect.name) or tuple(
        p.grid[len(p.grid) // 2] if p.grid else NINETY * p.prior for p in effect.parameters
    )
    return EffectInstance(effect, target, values)


def examples(robot: Robot) -> list[EffectInstance]:
    """Return an example of every effect of the catalogue."""
    return [example(effect, robot) for effect in catalogue().values()]


def signature(instance: EffectInstance, robot: Robot, plan: PosturePlan) -> Signature:
    """Simulate an effect's signature without noise by statics; predict it where statics cannot."""
    effect = instance.effect
    plain = _plain(robot, effect.instrument)
    if effect.statics:
        rig = effect.inject(plain, instance.target, instance.values)
        observed = _observed(rig, plan, robot)
        return Signature(instance, observed, cop_error(observed), True)
    observed = _observed(plain, plan, robot)
    removed = effect.remove(observed, instance.target, instance.values)
    return Signature(instance, observed, cop_error(observed) - cop_error(removed), False)


def noise_sd(robot: Robot, plan: PosturePlan, preset: str) -> np.ndarray:
    """Return the s.d. of the CoP's error in a laboratory without effects, x and y, (2,) [mm]."""
    streams = np.random.SeedSequence(SEED).spawn(RUNS)
    runs = run_statics(solve_plan(preset_rig(preset, robot), plan), streams, all_solved=True)
    errors = [cop_error(observe(run.measurements, nominal_robot(robot))) for run in runs]
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def cop_error(observed: Observation) -> np.ndarray:
    """Return the measured CoP minus the prediction of nominal parameters and angles, (m, 2) [mm]."""
    return 1e3 * residuals(observed, observed.nominal.value)[:, ROWS["A"]]


def _plain(robot: Robot, instrument: str) -> Rig:
    rig = preset_rig({"wrenches": "plate-ft", "feet": "foot-ideal"}.get(instrument, "ideal"), robot)
    quiet = without_noise(rig)
    if rig.sensors.wrench is None:
        return quiet
    tared = replace(rig.sensors.wrench.exact, zero_sd=(0.0,) * len(rig.sensors.wrench.channels))
    return replace(quiet, sensors=replace(quiet.sensors, wrench=tared))


def _observed(rig: Rig, plan: PosturePlan, robot: Robot) -> Observation:
    (run,) = run_statics(solve_plan(rig, plan), [np.random.SeedSequence(SEED)], all_solved=True)
    return observe(run.measurements, nominal_robot(robot))
