"""A proposed experiment as a plan folder: postures, manipulations and numbered steps for the laboratory."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, computed_field

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import present
from tulip_testbed.base.result import Documented, Outside, Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import json_text
from tulip_testbed.discovery.discover import AMBIGUOUS
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.next_experiment import (
    MANIPULATION,
    PLACEMENT,
    POSTURE,
    NextExperiment,
    doubts_of,
    rank_experiments,
    session_of,
)
from tulip_testbed.measurements import Experiment, Measurements, PosturePlan
from tulip_testbed.measurements.manipulations import arrangement_of
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.robot import Robot

EXPERIMENT_FILE, STEPS_FILE = "experiment.json", "steps.md"


@dataclass(frozen=True, kw_only=True)
class ExperimentFile(NextExperiment, Documented):
    """experiment.json of a plan folder; number: of the experiment, from 1."""

    format: Literal["tulip-experiment"] = "tulip-experiment"
    version: Literal[1] = 1
    number: Annotated[int, Field(ge=1)]


@dataclass(frozen=True, eq=False, repr=False)
class Proposals(Result):
    """Experiments that would settle an ambiguous discovery, the best first.

    Attributes:
        verdict: of the discovery; nothing is proposed unless it is "ambiguous".
        number: of the next experiment, from 1.
    """

    verdict: str
    experiments: tuple[NextExperiment, ...]
    number: int
    session: Annotated[str, Outside()]

    @property
    def best(self) -> NextExperiment:
        """Return the best experiment.

        Raises:
            InputError: nothing is to be settled.
        """
        if not self.experiments:
            raise InputError(
                f"found the verdict {self.verdict}, expected {AMBIGUOUS}: no experiment is needed to "
                "distinguish explanations"
            )
        return self.experiments[0]

    @computed_field
    @property
    def assumed_minutes(self) -> dict[str, float]:
        """Return the assumed time of a posture, of a placement and of each manipulation [min]."""
        return {"posture": POSTURE, "placement": PLACEMENT} | MANIPULATION

    def tables(self) -> list[Table | str]:
        if not self.experiments:
            return [f"Verdict: {self.verdict}. There is nothing to settle between explanations."]
        out: list[Table | str] = [self.table(), prediction_table(self.best)]
        if not self.session:
            out.append(
                "The measurements state no session: tares, tilt of the floor and survey of the plates count "
                "as new in the next experiment. State the same `session` in all manifests if they stay."
            )
        out.append(
            f"Assumed time: {POSTURE:g} min a posture, {PLACEMENT:g} min a placement; manipulations "
            + ", ".join(f"{name} {time:g} min" for name, time in MANIPULATION.items())
            + "."
        )
        return out

    def save(self, folder: str | Path) -> None:
        """Write the best experiment as a plan folder with its manipulations and steps; it appears whole."""
        best = self.best
        document = ExperimentFile(**vars(best), number=self.number)
        files = {EXPERIMENT_FILE: json_text(document.to_json()), STEPS_FILE: steps(document)}
        write_plan(Path(folder), best.plan, files)

    def table(self) -> Table:
        return experiment_table(self.experiments)


def prediction_table(experiment: NextExperiment) -> Table:
    rows = [astuple(one) for one in experiment.predictions]
    center = ((f"CoP {axis}", "mm", "+.2f") for axis in "xy")
    forces = ((name, "N", "+.2f") for name in ("sum", "twist right", "twist left"))
    heads = ("if it is", *center, *forces)
    return Table("Mean residuals that each explanation predicts for the best", heads, rows)


def experiment_table(experiments: Sequence[NextExperiment]) -> Table:
    rows = [[one.words, one.postures, one.minutes, one.settled, one.separation] for one in experiments]
    figures = ("time", "min", ".0f"), ("settled", "%", ".0f", 100.0), ("least ln BF", "", ".1f")
    heads = ("experiment", ("postures", "", "d"), *figures)
    note = (
        "settled: expected decrease of the explanations' entropy, whose rate per minute orders the rows; "
        "least ln BF: expected between the two closest explanations."
    )
    return Table("Experiments, the best first", heads, rows, note)


def propose_experiments(
    measurements: Measurements,
    robot: Robot,
    verdict: str,
    explanations: Sequence[Explanation],
    plan: PosturePlan | None = None,
    seed: int = 0,
) -> Proposals:
    """Rank the experiments that would settle a discovery, see `tulip_testbed.next_experiment`."""
    doubts = doubts_of(verdict, explanations)
    ranking = rank_experiments(measurements, robot, doubts, plan, seed) if doubts else []
    count = max(len(measurements.experiments), 1)
    return Proposals(verdict, tuple(ranking), count + 1, session_of(measurements))


def steps(document: ExperimentFile) -> str:
    """Describe what to do in the laboratory, as numbered steps in Markdown."""
    todo = [
        f"{text[0].upper()}{text[1:]}: {next(ADVICE[kind] for kind in ADVICE if kind in text)}"
        for text in document.manipulations
    ] or ["Leave everything as it was."]
    if document.session:
        todo.append(
            f"Do not tare the cells unless a step says so: the experiment belongs to session "
            f"'{document.session}'."
        )
    keys = json_text({"session": document.session or None, "manipulations": document.manipulations}).strip()
    todo += [
        f"Measure the {document.postures} postures of this plan on their {document.placements} placements. "
        "Columns name places on the floor as the robot sees them, not devices.",
        f"State in the manifest of the measurements:\n\n```json\n{keys}\n```",
    ]
    lines = [
        *(f"# Experiment {document.number}: {document.words}", ""),
        *(f"{k}. {text}" for k, text in enumerate(todo, 1)),
        *("", f"Assumed time: {document.minutes:.0f} min.", ""),
        *("Mean residuals that each explanation predicts:", ""),
        prediction_table(document).markdown(),
    ]
    return "\n".join(lines) + "\n"


ADVICE = {
    "plates exchanged": "put each plate where the other one was, facing the same way.",
    "plate turned": "turn it about the vertical through its middle, cables and all.",
    "plates moved": "survey the plates' places again.",
    "cells re-tared": "unload the plates and tare all cells.",
    "cable removed": "take off every cable and hoist that touches the robot.",
    "robot turned": "turn the robot about the vertical, so that it faces the other way on the same plates.",
    "encoder re-zeroed": "zero the joint's encoder at its mark.",
    "known mass": "fix the mass there and weigh the robot with it.",
}


def read_experiment(folder: Path) -> tuple[Experiment, int]:
    """Read the manipulations of a plan folder and the number of the experiment."""
    where = Path(folder) / EXPERIMENT_FILE
    if not present(where):
        raise InputError(f"{where}: missing; expected a plan folder that `tulip plan next` wrote")
    document = ExperimentFile.read(where)
    arrangement_of(document.manipulations, f"{where}: key 'manipulations'")
    return document.experiment, document.number
