"""A scenario: a virtual laboratory, a plan and a seed. The truth lives here alone."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.base_parameters import base_parameters, common_support, standard_parameters
from tulip_testbed.sim.dynamics.dynamic_run import Attempt, Experiment
from tulip_testbed.sim.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import CORNERS, PLATES, compile_spec
from tulip_testbed.sim.scene import load_scene
from tulip_testbed.sim.statics.static_run import StaticRun

DEFAULT_PLAN = Path(__file__).resolve().parent / "plans" / "random"
DEFAULT_SEED = 1


@dataclass(frozen=True)
class Scenario:
    """What an experiment is made of.

    Attributes:
        rig: the laboratory. plan: postures. seed: of everything random in the laboratory.
        preset: name of the sensors' preset.
        adopted: effects that the laboratory is known to have; the rig has them.
        hidden: effects of the rig that nobody is told.
        statics: whether it is the static laboratory.
    """

    rig: Rig
    plan: PosturePlan
    seed: int
    preset: str
    adopted: tuple[EffectInstance, ...] = ()
    hidden: tuple[EffectInstance, ...] = ()
    statics: bool = False

    def true_model(self) -> mujoco.MjModel:
        """The robot that really stands there at first, alone: with its own masses and lengths.

        What the nominal robot does not have, joints that yield and ropes, is no part of it; nor is what lies
        under a corner of a sole.
        """
        spec = load_scene(self.rig.robot)
        if self.rig.edit is not None:
            joints, tendons = ({part.name for part in parts} for parts in (spec.joints, spec.tendons))
            corners = [spec.geom(f"{foot}_{corner}") for foot in self.rig.robot.feet for corner in CORNERS]
            soles = [corner.pos.copy() for corner in corners]
            self.rig.edit(spec)
            for corner, place in zip(corners, soles, strict=True):
                corner.pos = place
            for part in [part for part in spec.tendons if part.name not in tendons]:
                spec.delete(part)
            for part in [part for part in spec.joints if part.name not in joints]:
                spec.delete(part)
        for plate in PLATES:
            spec.delete(spec.body(f"{plate}_plate"))
        for key in list(spec.keys):
            spec.delete(key)
        return compile_spec(spec, str(self.rig.robot.path))

    def true_base_parameters(self) -> np.ndarray:
        """Base parameters of that robot as the plan can tell them, with its own lengths, (p,) [m]."""
        model = self.true_model()
        support = common_support(self.plan.support)
        return base_parameters(self.rig.robot, model, support).values(standard_parameters(model))

    def configuration(self) -> dict[str, Any]:
        """Everything that was set, for run folders and truth files."""
        return {
            "preset": self.preset,
            "seed": self.seed,
            "robot": str(self.rig.robot.path.name),
            "controller": dataclasses.asdict(self.rig.controller),
            "drives": dataclasses.asdict(self.rig.drives),
            "compliance": dataclasses.asdict(self.rig.compliance),
            "sensors": dataclasses.asdict(self.rig.sensors),
            "protocol": dataclasses.asdict(self.rig.protocol),
            "edited": self.rig.edit is not None,
            "adopted": [found.document() for found in self.adopted],
            "statics": self.statics,
            "plan": {"robot": self.plan.robot, "made": self.plan.made, "postures": len(self.plan)},
        }


def truth_document(scenario: Scenario, experiment: Experiment | StaticRun) -> dict[str, Any]:
    """What only the simulation knows, as one JSON object; statics keeps no account of its attempts."""
    model = scenario.true_model()
    parameters = base_parameters(scenario.rig.robot, model, common_support(scenario.plan.support))
    standard = standard_parameters(model)
    return {
        "format": "tulip-truth",
        "version": 1,
        "configuration": scenario.configuration(),
        "effects": [found.document() for found in scenario.hidden],
        "total_mass": experiment.true_mass,
        "links": list(parameters.tree.links),
        "standard_parameters": standard.tolist(),
        "base_parameters": dict(zip(parameters.names, parameters.values(standard).tolist(), strict=True)),
        "attempts": [_attempt(a) for a in experiment.attempts] if isinstance(experiment, Experiment) else [],
    }


def _attempt(attempt: Attempt) -> dict[str, Any]:
    document: dict[str, Any] = {
        "posture": attempt.posture,
        "placement": attempt.placement,
        "repeat": attempt.repeat,
        "true_plates": attempt.true_plates.tolist(),
    }
    if attempt.held is None:
        return document | {"dropped": attempt.reason}
    return document | {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in dataclasses.asdict(attempt.held).items()
    }
