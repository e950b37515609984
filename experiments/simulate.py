"""A simulated experiment without its truth, and the effects that are hidden in its laboratory."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.effects.random_effects import RANDOM, read_effects
from tulip_testbed.experiments.laboratory import Laboratory, Run
from tulip_testbed.experiments.truth_record import DroppedPosture, usable_postures
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.trajectory import runs
from tulip_testbed.sim.procedure import header_of


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

    @classmethod
    def of(cls, run: Run, folder: str, secret: bool) -> Self:
        """Return the outcome of a run in a folder; secret: without why postures were dropped."""
        dropped = tuple(DroppedPosture(number, None if secret else why) for number, why in run.truth.dropped)
        made_of = (folder, run.plan.postures, len(run.measurements), dropped)
        if run.samples is None:
            return cls(*made_of)
        segments = runs(run.samples.posture)
        return cls(*made_of, len(segments), sum(float(np.ptp(run.samples.time[s])) for s in segments))

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
