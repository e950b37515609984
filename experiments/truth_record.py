"""truth.json: what only a simulation knows, kept apart from the measurements."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from tulip_testbed.base.document import Document, Pair
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import check_new, present, write_text
from tulip_testbed.base.table_files import json_text
from tulip_testbed.effects.instance import EffectDocument
from tulip_testbed.effects.true_robot import true_model
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.run_file import Configuration, configuration_of
from tulip_testbed.identification.base_parameters import (
    base_parameters,
    common_support,
    standard_parameters,
)
from tulip_testbed.measurements import write_measurements
from tulip_testbed.sim.outcome import Attempt

Standard = Annotated[list[float], Field(min_length=4, max_length=4)]


class TruthAttempt(Document):
    """One try at a posture: why it was dropped, or the true state, as `Held` has it."""

    posture: int
    placement: int
    repeat: bool
    true_plates: list[list[float]]
    dropped: str | None = None
    joint_angles: list[float] | None = None
    motor_angles: list[float] | None = None
    commanded: list[float] | None = None
    torques: list[float] | None = None
    cell_forces: list[float] | None = None
    com: Pair | None = None
    drift: float | None = None
    settled_after: float | None = None
    books: dict[str, float] | None = None

    @model_validator(mode="after")
    def _is_held_or_dropped(self) -> Self:
        if (self.dropped is None) == (self.com is None):
            raise ValueError("expected either the key 'com' or the key 'dropped'")
        return self


class Truth(Document):
    """truth.json; base parameters by name [m], standard parameters by link [kg, kg m].

    The statics engine keeps no account of single tries: then there are no attempts. With sensors in the feet
    there are their true zeros and their true wrenches without zeros, by row of the measurements [N, Nm].
    """

    format: Literal["tulip-truth"]
    version: Literal[1]
    configuration: Configuration
    effects: list[EffectDocument]
    total_mass: float
    links: list[str]
    standard_parameters: list[Standard]
    base_parameters: dict[str, float]
    attempts: list[TruthAttempt]
    zeros: list[list[float]] | None = None
    wrenches: list[list[list[float]]] | None = None

    @property
    def held(self) -> list[TruthAttempt]:
        """The tries behind the rows of the measurements, in the same order; empty in statics."""
        return [attempt for attempt in self.attempts if attempt.com is not None]

    @property
    def com(self) -> np.ndarray | None:
        """True centre of mass of every row of the measurements, (m, 2) [m]; None in statics."""
        return np.array([attempt.com for attempt in self.held]) if self.attempts else None


def truth_of(run: Run) -> Truth:
    """Return what only the simulation knows of a run."""
    laboratory, truth = run.laboratory, run.truth
    model = true_model(laboratory.rig)
    parameters = base_parameters(laboratory.robot, model, common_support(run.plan.support))
    standard = standard_parameters(model)
    feet = {"zeros": truth.zeros, "wrenches": truth.wrenches}
    return Truth(
        format="tulip-truth",
        version=1,
        configuration=configuration_of(laboratory, run.plan, run.seed, run.engine),
        effects=[EffectDocument.model_validate(found.document()) for found in laboratory.hidden],
        total_mass=truth.mass,
        links=list(parameters.tree.links),
        standard_parameters=standard.tolist(),
        base_parameters=dict(zip(parameters.names, parameters.values(standard).tolist(), strict=True)),
        attempts=[_attempt(attempt) for attempt in truth.attempts],
        **{name: values.tolist() for name, values in feet.items() if values is not None},
    )


def _attempt(attempt: Attempt) -> TruthAttempt:
    content: dict[str, Any] = {
        "posture": attempt.posture,
        "placement": attempt.placement,
        "repeat": attempt.repeat,
        "true_plates": attempt.true_plates.tolist(),
    }
    if (held := attempt.held) is None:
        return TruthAttempt(**content, dropped=attempt.reason)
    return TruthAttempt(
        **content,
        joint_angles=held.joint_angles.tolist(),
        motor_angles=held.motor_angles.tolist(),
        commanded=held.commanded.tolist(),
        torques=held.torques.tolist(),
        cell_forces=held.cell_forces.tolist(),
        com=held.com.tolist(),
        drift=held.drift,
        settled_after=held.settled_after,
        books=dataclasses.asdict(held.balance),
    )


def check_places(out: Path, truth: Path | None) -> None:
    """Refuse, before the work, places at which measurements and truth could not be written.

    Raises:
        InputError: one of them exists, cannot be written, or lies in a measurement folder.
    """
    check_new(out)
    if truth is None:
        return
    check_new(truth)
    folder, file = (Path(os.path.realpath(path)) for path in (out, truth))
    if file.is_relative_to(folder):
        raise InputError(f"{truth}: lies inside the measurement folder, which must not hold the truth")
    if folder.is_relative_to(file):
        raise InputError(f"{out}: lies inside {truth}, which is to be a file")


def write_experiment(out: Path, truth: Path | None, run: Run) -> None:
    """Write the truth and the measurement folder; if the folder exists afterwards, so does its truth.

    Raises:
        InputError: one of them exists or cannot be written.
    """
    check_places(out, truth)
    if truth is not None:
        write_text(truth, json_text(truth_of(run).plain()), new=True)  # else another process's would be lost
    try:
        write_measurements(out, run.measurements)
    except BaseException as error:
        # An interruption may come when the folder is there; else the name is another process's.
        if truth is not None and (isinstance(error, InputError) or not present(out)):
            truth.unlink()
        raise
