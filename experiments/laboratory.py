"""A virtual laboratory that a researcher drives, and the runs that it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from tulip_testbed.base.arguments import checked, expect
from tulip_testbed.base.errors import InputError, at_least, look_up
from tulip_testbed.base.threads import one_blas_thread, processes
from tulip_testbed.effects.catalogue import check_instrument
from tulip_testbed.effects.injection import check_built, check_experiment, edited, manipulated
from tulip_testbed.effects.instance import (
    EffectInstance,
    Effects,
    as_manipulated,
    check_different,
    check_instance,
    check_instances,
    check_laboratory,
    injected,
    instances_of,
    several,
)
from tulip_testbed.effects.true_robot import true_base_parameters, true_model
from tulip_testbed.experiments.defaults import DEFAULT_SEED
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, common_support
from tulip_testbed.measurements import Experiment, Measurements, PosturePlan
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.dynamics.moving_run import run_motion
from tulip_testbed.sim.outcome import Truth
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.random_robots import check_spread, draw_robot, edit_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.robot_check import check_scene, warn_of_robot
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

ENGINES = ("dynamics", "statics")
FROM_POSTURE_TO_POSTURE = ("cell-hysteresis", "lag", "unsettled")
ROBOT_STREAM = 2**32 - 2  # spawn key of a single experiment's robot: no placement has this number


@dataclass(frozen=True)
class Laboratory:
    """A robot on two force plates with its controller, its sensors and physical effects.

    Attributes:
        robot: the nominal robot.
        sensors: name of a preset of data-sheet figures: plates on cells "wii", "force-plate" or "ideal",
            other plates "plate-ft" or "plate-cop", sensors in the ankles "foot-ft" or "foot-ideal", or in
            the soles "sole-ft" or "sole-3axis".
        known: effects that the laboratory is known to have; estimates are corrected for them. Texts are read.
        hidden: effects that no estimator knows, likewise.
        nominal: the laboratory without effects; None: the nominal robot's, with the preset's sensors.
        experiment: session and manipulations, see `manipulated`; None: an ordinary set-up in no session.
        random_robot: spread (see `draw_robot`) and seed of the robot that stands there, which no estimator
            knows; None: the nominal one.
    """

    robot: Robot = field(default_factory=load_robot)
    sensors: str = "wii"
    known: tuple[EffectInstance, ...] = ()
    hidden: tuple[EffectInstance, ...] = ()
    nominal: Rig | None = field(default=None, repr=False)
    experiment: Experiment | None = None
    random_robot: tuple[float, int] | None = None

    def __post_init__(self) -> None:
        given = {"robot": Robot, "sensors": str, "nominal": Rig | None, "experiment": Experiment | None}
        for name, kind in {**given, "random_robot": tuple[float, int] | None}.items():
            expect(name, getattr(self, name), kind)
        if self.random_robot is not None:
            check_spread(self.random_robot[0])
            at_least("random_robot", self.random_robot[1], 0)
        look_up("preset", self.sensors, PRESETS, "sensors")
        for name in ("known", "hidden"):
            given = several(getattr(self, name), name)
            texts = any(isinstance(effect, str) for effect in given)
            if not texts:
                check_instances(tuple(e for e in given if not isinstance(e, str)), self.robot, name)
            object.__setattr__(self, name, self._instances(given) if texts else given)
        check_different(self.known, "known")

    def __reduce__(self) -> Any:
        """Leave the rig out, which holds functions that cannot be pickled."""
        return Laboratory, tuple(getattr(self, each.name) for each in fields(self))

    @property
    def _plain(self) -> Rig:
        rig = preset_rig(self.sensors, self.robot) if self.nominal is None else self.nominal
        if self.random_robot is None:
            return rig
        spread, seed = self.random_robot
        stream = np.random.SeedSequence(seed, spawn_key=(ROBOT_STREAM,))
        standard = draw_robot(self.robot.model, spread, np.random.default_rng(stream))
        return edited(rig, edit_of(self.robot.model, standard))

    @cached_property
    def rig(self) -> Rig:
        if self.experiment is None:
            return injected(injected(self._plain, self.known), self.hidden)
        known, hidden = (as_manipulated(some, self.experiment) for some in (self.known, self.hidden))
        return injected(injected(manipulated(self._plain, self.experiment), known), hidden)

    @checked
    def with_effects(self, *effects: EffectInstance | str) -> Laboratory:
        """Hide more effects in this laboratory.

        Args:
            effects: instances, or texts NAME[:TARGET]=VALUE[,VALUE...] in SI units, choices by name.

        Raises:
            InputError: an effect that cannot be read, that the robot does not have, or with which no
                laboratory can be built.
        """
        return replace(self, hidden=self.hidden + self._instances(effects))

    @checked
    def with_known(self, *effects: EffectInstance | str) -> Laboratory:
        """Add effects that the laboratory is known to have, written as in `with_effects`."""
        return replace(self, known=self.known + self._instances(effects))

    @checked
    def manipulated(self, *manipulations: str, session: str = "") -> Laboratory:
        """Return the laboratory after manipulations, in place of those before.

        Args:
            manipulations: "plates exchanged", "left plate turned by 180 deg", "plates moved",
                "cells re-tared", "cable removed", "robot turned by 180 deg", "encoder re-zeroed: JOINT",
                "known mass 2 kg at torso (0, 0, 0.3)".
            session: experiments of one session share tares, tilt of the floor and survey of the plates.

        Raises:
            InputError: a text outside the grammar, manipulations that contradict each other, or what this
                laboratory does not have.
        """
        experiment = Experiment(session, manipulations)
        check_experiment(self._plain, experiment)
        return replace(self, experiment=experiment)

    def _instances(self, effects: Effects) -> tuple[EffectInstance, ...]:
        instances = instances_of(effects, self.robot)
        for instance in instances:
            try:
                check_built(injected(preset_rig("ideal", self.robot), [instance]))
            except InputError as error:
                raise InputError(
                    f"effect {instance}: found a laboratory that cannot be built, expected one that can: "
                    f"{error}"
                ) from None
        return instances

    @checked
    @one_blas_thread
    def run(
        self,
        plan: PosturePlan,
        seed: int = DEFAULT_SEED,
        engine: str = "dynamics",
        workers: int | None = None,
        progress: Callable[[int], None] = lambda count: None,
    ) -> Run:
        """Carry out the experiment.

        Args:
            plan: postures to measure.
            seed: of everything random.
            engine: "dynamics": hold every posture, or move, in the full dynamics, half a minute; "statics":
                solve the equilibrium of every posture, a second; not of a plan that moves.
            workers: processes; None: one per core. Results do not depend on it.
            progress: called with the number of tries each time a placement is done.

        Raises:
            InputError: a plan that does not fit, or nothing could be measured.
        """
        count = processes(workers)
        at_least("seed", seed, 0)
        self.check(plan, engine)
        warn_of_robot(self.robot)
        samples = None
        if plan.motion is not None:
            moved = run_motion(self.rig, plan, seed, count, progress)
            outcome, samples = moved, moved.samples
        elif engine == "statics":
            (outcome,) = run_statics(solve_plan(self.rig, plan), [np.random.SeedSequence(seed)])
        else:
            outcome = run_dynamics(self.rig, plan, seed, count, progress)
        measured = outcome.measurements
        if self.experiment is not None:
            measured = replace(measured, experiments=(self.experiment,))
            samples = samples and replace(samples, experiments=(self.experiment,))
        return Run(self, plan, seed, engine, measured, outcome.truth, samples)

    def check(self, plan: PosturePlan, engine: str) -> None:
        """Refuse a plan that this laboratory cannot measure."""
        look_up("engine", engine, ENGINES, "engine")
        check_fits("plan", plan, self.robot)
        if plan.motion is not None and engine != "dynamics":
            raise InputError(
                f"engine: found '{engine}' with a plan that moves, expected 'dynamics': {engine} knows only "
                "postures at rest"
            )
        check_scene(self._plain)
        self.check_effects(plan, engine)

    def check_effects(self, plan: PosturePlan, engine: str) -> None:
        """Refuse effects that this laboratory cannot have."""
        placements, contacts = np.unique(plan.placement).tolist(), header_of(self.rig).contacts
        for effect in (*self.known, *self.hidden):
            where = str(effect)
            if plan.motion is not None and effect.effect.name in FROM_POSTURE_TO_POSTURE:
                raise InputError(
                    f"{where}: found an effect that acts from one posture to the next, in a plan that moves; "
                    "expected a plan of postures that are held"
                )
            check_laboratory(effect, engine == "statics", where)
            check_instrument(effect.effect, contacts, where)
            check_instance(effect, self.robot, placements, where)

    def true_base_parameters(self, plan: PosturePlan) -> np.ndarray:
        """Compute the base parameters of the robot that stands here, as a plan can tell them, (p,) [m]."""
        return true_base_parameters(self.rig, common_support(plan.support))

    def parameters(self, plan: PosturePlan) -> BaseParameters:
        """Derive the base parameters that a plan can tell, with the lengths that are known to be true."""
        model = true_model(self.rig) if self.known else None
        return base_parameters(self.robot, model, common_support(plan.support))


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment in a laboratory: what it handed over and, apart from it, what really happened.

    Attributes:
        laboratory, plan, seed, engine: how it was made.
        measurements: the data contract; without the truth.
        truth: what only the simulation knows.
        samples: of a plan that moves, of which the measurements are the rows; `posture` is the segment's
            number. None: postures were held.
    """

    laboratory: Laboratory
    plan: PosturePlan
    seed: int
    engine: str
    measurements: Measurements
    truth: Truth
    samples: Measurements | None = None

    def __repr__(self) -> str:
        used = f"{self.plan.postures - len(self.truth.dropped)} of {self.plan.postures} postures"
        if self.samples is not None:
            used = f"{len(self.samples)} samples"
        hidden = ", ".join(map(str, self.laboratory.hidden)) or "none"
        return (
            f"Run: {used} of {self.laboratory.robot.name} measured in {self.engine}, sensors "
            f"'{self.laboratory.sensors}', seed {self.seed}, hidden effects: {hidden}"
        )


def tries(laboratory: Laboratory, plan: PosturePlan) -> int:
    """Count the postures that will be held, repeats included, or the segments of a motion."""
    if plan.motion is not None:
        return len(plan.motion.segments)
    repeats = laboratory.rig.protocol.repeats if plan.postures == len(plan) else 0
    return len(plan) + min(repeats, len(plan))
