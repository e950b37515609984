"""A simulated experiment: its outcome, the effects hidden in its laboratory, and its truth, kept apart."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, present, write_text
from tulip_testbed.base.result import Documented, Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import json_text
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.random_effects import RANDOM, read_effects
from tulip_testbed.effects.true_robot import true_model
from tulip_testbed.experiments.laboratory import Laboratory, Run
from tulip_testbed.experiments.run_file import configuration_of
from tulip_testbed.identification.base_parameters import base_parameters, common_support
from tulip_testbed.measurements import Measurements, PosturePlan, write_measurements, write_motion
from tulip_testbed.sim.outcome import Truth
from tulip_testbed.sim.procedure import header_of


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SimulatedTruth(Truth, Documented):
    """The truth of an experiment, truth.json, which only its simulation knows.

    Attributes:
        configuration: how it was made. effects: that were hidden in the laboratory.
        links: names of the rows of `standard`.
        base_parameters: by name [m].
    """

    format: Literal["tulip-truth"] = "tulip-truth"
    version: Literal[2] = 2
    configuration: dict[str, Any]
    effects: tuple[EffectInstance, ...]
    links: tuple[str, ...]
    base_parameters: dict[str, float]

    @classmethod
    def of(cls, run: Run) -> Self:
        laboratory, support = run.laboratory, common_support(run.plan.support)
        parameters = base_parameters(laboratory.robot, true_model(laboratory.rig), support)
        values = parameters.values(run.truth.standard).tolist()
        return cls(
            **vars(run.truth),
            configuration=configuration_of(laboratory, run.plan, run.seed, run.engine),
            effects=laboratory.hidden,
            links=parameters.tree.links,
            base_parameters=dict(zip(parameters.names, values, strict=True)),
        )

    @property
    def com(self) -> np.ndarray | None:
        """Return the true centre of mass of every row of the measurements, (m, 2) [m]; None in statics."""
        return np.array([held.com for held in self.held]) if self.attempts else None

    def check(self, links: tuple[str, ...], measurements: Measurements, where: Path) -> None:
        """Refuse the truth of a robot with other links or of other postures; where: the document."""
        if self.links != links or self.standard.shape != (len(links), 4):
            raise InputError(
                f"{where}: key 'links': found standard parameters of shape {self.standard.shape} of "
                f"{shortened(self.links)}, expected four for each of the robot's {len(links)} links"
            )
        if self.attempts and [one.posture for one in self.measured] != measurements.posture.tolist():
            raise InputError(f"{where}: found other postures than in the measurements")
        if any(held.com.shape != (2,) for held in self.held):
            raise InputError(f"{where}: key 'attempts': found a centre of mass of other than two numbers")


def check_places(out: Path, truth: Path | None) -> None:
    """Refuse, before the work, places at which measurements and truth could not be written."""
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
    """Write the truth and the measurement folder; if the folder exists afterwards, so does its truth."""
    check_places(out, truth)
    if truth is not None:  # a new file: else another process's would be lost
        write_text(truth, json_text(SimulatedTruth.of(run).to_json()), new=True)
    try:
        if run.samples is None:
            write_measurements(out, run.measurements)
        else:
            write_motion(out, run.samples)
    except BaseException as error:
        # An interruption may come when the folder is there; else the name is another process's.
        if truth is not None and (isinstance(error, InputError) or not present(out)):
            truth.unlink()
        raise


@dataclass(frozen=True)
class DroppedPosture:
    """A posture that could not be measured; the reason is None where it could hint at a random effect."""

    posture: int
    reason: str | None


def usable_postures(
    planned: int, rows: int, dropped: Sequence[str | None], paper: Mapping[str, Any] | None = None
) -> list[str]:
    """Describe how many postures could be used.

    Args:
        planned: how many there were. rows: of the measurements.
        dropped: why each of the others could not be used; None is not told.
        paper: the part `paper` of the robot's description.
    """
    beside = f" (paper {paper['postures_used']} of {paper['postures_planned']})" if paper else ""
    tally = Counter[str]()
    for reason in filter(None, dropped):
        key = reason.rsplit(" ", 1)[0] if reason.startswith(("lost", "lifted")) else reason
        tally["slipped" if reason.startswith("slipped") else key] += 1
    return [
        f"Usable postures: {planned - len(dropped)} of {planned}{beside}; {rows} rows with repeats.",
        *(f"  dropped {count}: {reason}" for reason, count in tally.most_common()),
    ]


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """Outcome of a simulated experiment, without its truth.

    Attributes:
        measurements: folder. postures_planned, rows: how many there are.
        dropped: postures that could not be measured, or segments of which not all could.
        segments, seconds: how many motions were measured, and their time; None: postures were held.
    """

    measurements: str
    postures_planned: int
    rows: int
    dropped: tuple[DroppedPosture, ...]
    segments: int | None = None
    seconds: float | None = None

    def tables(self) -> list[Table | str]:
        if self.seconds is not None:
            cut = [f"  segment {one.posture} was cut: {one.reason or 'not told'}" for one in self.dropped]
            measured = f"{self.segments} segments, {self.seconds / 60:.1f} min, are {self.rows} rows."
            return [measured, *cut, f"Measurement folder: {self.measurements}"]
        reasons = [posture.reason for posture in self.dropped]
        usable = usable_postures(self.postures_planned, self.rows, reasons)
        return [*usable, f"Measurement folder: {self.measurements}"]


def disturbed(
    laboratory: Laboratory, plan: PosturePlan, effects: Sequence[str], seed: int, statics: bool
) -> Laboratory:
    """Hide effects in a laboratory; random ones are the seed's."""
    placements = np.unique(plan.placement).tolist()
    contacts = header_of(laboratory.rig).contacts
    hidden = read_effects(effects, laboratory.robot, placements, seed, statics, "effects", contacts)
    for text, instance in zip(effects, hidden, strict=True):
        try:
            laboratory = laboratory.with_effects(instance)
        except InputError:
            if text != RANDOM:
                raise
            raise InputError(
                "effects random: found a laboratory that cannot be built, expected one that can; give "
                "another seed"
            ) from None
    return laboratory
