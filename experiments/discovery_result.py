"""The result of a discovery: verdict, effects, evidence, the robot identified before and after."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, computed_field

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import is_folder, read_bytes, read_text, write_text
from tulip_testbed.base.result import RESULT_FILE, Figure, InMemory, Kept, Place
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import Columns, TableFile
from tulip_testbed.calibration.calibration_result import CalibratedFamily
from tulip_testbed.discovery.detectability import Undetectable, WeaklyDetectable
from tulip_testbed.discovery.discover import Discovery, Verdict, clear_of_zero
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.held_out import HeldOut
from tulip_testbed.discovery.next_experiment import NextExperiment
from tulip_testbed.discovery.patterns import Pattern
from tulip_testbed.discovery.pure_error import PureError
from tulip_testbed.effects.instance import EffectInstance, check_instance
from tulip_testbed.effects.laws import LAW, Sentence, sentence_of
from tulip_testbed.experiments import discovery_tables
from tulip_testbed.experiments.family_tables import family_table
from tulip_testbed.experiments.identification_result import EXPERIMENTS, Identification
from tulip_testbed.experiments.proposed_experiment import Proposals, propose_experiments
from tulip_testbed.experiments.rig_folder import RIG
from tulip_testbed.experiments.run_file import MADE, ROBOT, RunFile, SavedRun
from tulip_testbed.identification.residual_noise import Noise
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.robot import Robot

RESIDUAL_FILE = "residuals.csv"
FAMILIES = "Families of ordinary imperfections"  # title of their table
SIDES = ("before", "after")
PARTS = (
    *("cop_x_m", "cop_y_m", "force_N", "twist_right_N", "twist_left_N"),
    *("height_m", "roll_rad", "pitch_rad", "x_m", "y_m", "yaw_rad"),
)


AS_SHOWN = ("yes, these postures show no effect that the model lacks", "`export` writes the identified model")
CORRECTED = "remove the cause, or give the adopted rig to other commands as `corrections`"
# Whether the estimator is right and what to do next, by verdict.
ANSWERS = {
    "none": AS_SHOWN,
    "calibrated": AS_SHOWN,
    "named": ("yes, with the correction: one explanation fits", CORRECTED),
    "described": ("yes, with the correction: a law describes the gap", CORRECTED),
    "ambiguous": ("no, several explanations fit", "`plan next` proposes the experiment that separates them"),
    "unknown": ("no, no explanation is sufficient", "look for a fault where the residuals are largest"),
}


INCOMPLETE = (
    "Usable: nothing before that is settled; all intervals assume that the model is complete, and this "
    "verdict says that it is not."
)


def _write_residuals(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))


def _read_residuals(path: Path, robot: Robot) -> Columns:
    table = TableFile(path, read_bytes(path))
    parts = (f"{side}.{part}" for side in SIDES for part in PARTS)
    return {name: table.numbers(name) for name in ("posture", *parts)}


def _write_rig(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        write_text(folder / name, text)


def _read_rig(folder: Path, robot: Robot) -> dict[str, str]:
    return {path.name: read_text(path) for path in sorted(folder.iterdir())} if is_folder(folder) else {}


@dataclass(frozen=True, eq=False, repr=False)
class Discovered(SavedRun):
    """Effects that the model lacks, their evidence, and how the estimate changes.

    Attributes:
        verdict: "none", "calibrated", "named", "described", "ambiguous" or "unknown".
        adopted: effects that are added to the model; empty unless it is "named" or "described".
        calibrated: ordinary imperfections that are added to the model. families: their spreads.
        explanations: of all gaps, those of one gap together, its best first. runners_up: the next best, by
            their predictions alone.
        undetectable: effects that these postures cannot detect. weakly_detectable: those that would show only
            if larger than plausible.
        where: the clearest pattern of the gap, in words.
        heldout: residuals on placements that took no part in the fit.
        next_experiments: that would settle what is ambiguous, the best first.
        before, after: the robot identified without corrections, and with the adopted effects removed; None:
            there are none. Both by the self-calibrating estimator, which estimates ordinary imperfections.
        repeats: what repeated postures say about the noise. noise: that was assumed.
        alarm_p: probability of as strong an effect among noise alone.
        patterns: the least probable ones in the residuals that are left.
        story: the finding in sentences, the most important first.
        check: the adopted physics in the full dynamics; None: nothing to simulate, or not asked for.
        wall_s: duration of the search [s].
        robot: the nominal robot. measurements: as they were measured.
        residuals: of every row of `searched`, before and after what was found was removed, by column.
        rig_files: of the adopted model's rig folder, as text by name; empty: nothing was adopted that lasts.
        document: how it was made. folder: where it is saved; None: in memory alone.
        discovery: the search itself; None in a result that was read.
    """

    kind = "discovery"

    verdict: Verdict
    adopted: tuple[EffectInstance, ...]
    calibrated: tuple[EffectInstance, ...]
    families: tuple[CalibratedFamily, ...]
    explanations: tuple[Explanation, ...]
    runners_up: tuple[Explanation, ...]
    undetectable: tuple[Undetectable, ...]
    weakly_detectable: tuple[WeaklyDetectable, ...]
    where: str
    heldout: HeldOut
    next_experiments: tuple[NextExperiment, ...]
    before: Identification
    after: Identification | None
    repeats: PureError
    noise: Noise
    alarm_p: Figure
    patterns: tuple[Pattern, ...]
    story: Annotated[tuple[str, ...], Field(min_length=1)]
    check: DynamicsCheck | None
    wall_s: float
    robot: Annotated[Robot, ROBOT, Field(exclude=True)]
    measurements: Annotated[Measurements, EXPERIMENTS]
    residuals: Annotated[Columns, Kept(RESIDUAL_FILE, _write_residuals, _read_residuals)]
    rig_files: Annotated[dict[str, str], Kept(RIG, _write_rig, _read_rig)]
    document: Annotated[RunFile, MADE]
    folder: Place = None
    discovery: InMemory[Discovery | None] = None

    def placed_in(self, folder: Path) -> Self:
        result, robot, measured = folder / RESULT_FILE, self.robot, self.measurements
        placements = np.unique(measured.placement).tolist()
        for one in (*self.adopted, *self.calibrated, *(e.instance for e in self.explanations)):
            check_instance(one, robot, placements, str(result))
        postures, rows = self.residuals["posture"], len(self.searched)
        if not np.array_equal(postures, self.searched.posture):
            raise InputError(
                f"{folder / RESIDUAL_FILE}: found {len(postures)} rows, expected {rows}, with the "
                "postures of the measurements in their order"
            )
        before = self.before.placed(robot, measured, str(result), "before.")
        after = self.after
        after = None if after is None else after.placed(robot, measured, str(result), "after.")
        return replace(self, before=before, after=after)

    @computed_field
    @property
    def rig(self) -> str | None:
        """Return the folder of the adopted model, for corrections; None: there is none."""
        return str(self.folder / RIG) if self.folder is not None and self.rig_files else None

    @property
    def corrections(self) -> tuple[EffectInstance, ...]:
        """Return what the new nominal laboratory has: effects, and imperfections that are not zero."""
        return self.adopted + tuple(member for member in self.calibrated if clear_of_zero(member))

    @property
    def laws(self) -> Iterator[tuple[EffectInstance, list[Sentence]]]:
        """Yield the adopted laws, each with the other laws that do as well."""
        for law in self.adopted:
            if law.effect.name == LAW:
                gaps = {one.gap for one in self.explanations if one.instance.label == law.label}
                same = [one.instance for one in self.explanations if one.gap in gaps]
                others = [one for one in same if one.effect.name == LAW and one.label != law.label]
                yield law, [sentence_of(one.target) for one in others]

    @property
    def searched(self) -> Measurements:
        """Return the rows of the measurements that the search used: of a motion not all, see `discover`."""
        measured = self.measurements
        if measured.joint_rates is None:
            return measured
        return measured.take(np.flatnonzero(np.isin(measured.posture, self.residuals["posture"])))

    def residual(self, side: str) -> np.ndarray:
        """Return the residuals "before" or "after" what was found was removed, (m, 11), by channel.

        `identification.residual_channels` tells their parts.
        """
        return np.column_stack([self.residuals[f"{side}.{part}"] for part in PARTS])

    def propose(self, plan: PosturePlan | None = None, seed: int = 0) -> Proposals:
        """Rank the experiments that would settle what is ambiguous, see `propose_experiments`."""
        return propose_experiments(self.measurements, self.robot, self.verdict, self.explanations, plan, seed)

    @property
    def answers(self) -> tuple[str, str, str]:
        """Say whether the estimator is right, what of the estimate can be used, and what to do next."""
        right, following = ANSWERS[self.verdict]
        safe = self.verdict not in ("ambiguous", "unknown")
        usable = (self.after or self.before).usable if safe else INCOMPLETE
        return f"Is it right? {right}.", usable, f"Next: {following}."

    def tables(self) -> list[Table | str]:
        parts: list[Table | str] = [f"Verdict: {self.verdict}", *self.story, "", *self.answers, ""]
        if self.verdict == "none" and (weak := discovery_tables.weak_table(self.weakly_detectable)).rows:
            parts.append(weak)
        parts.append(discovery_tables.gap_table(self.heldout))
        if self.explanations:
            parts.append(discovery_tables.explanation_table(self.explanations))
        if self.families:
            parts.append(family_table(self.families, FAMILIES))
        moved = discovery_tables.moved_table(self.before, self.after, self.adopted, all_of_them=False)
        parts.append(
            moved if moved.rows else discovery_tables.moved_words(self.before, self.after, self.adopted)
        )
        if self.check:
            parts.append(discovery_tables.dynamics_line(self.check))
        return [*parts, *([] if self.folder is None else [f"Run folder: {self.folder}"])]

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter, before and after."""
        before = self.before.to_frame()
        kept = [name for name in before if name.startswith(("estimate", "s.e."))]
        if self.after is None:
            return before[kept]
        return before[kept].join(self.after.to_frame()[kept], lsuffix=", before", rsuffix=", after")
