"""From the options of a command to a laboratory and a plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.random_effects import RANDOM, read_effects
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.experiments.usable_plan import plan_for
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.procedure import header_of


def laboratory_and_plan(
    robot: Path,
    preset: str,
    plan: Path | None,
    rig: Path | None = None,
    effects: Sequence[str] = (),
    seed: int = 0,
    statics: bool = False,
) -> tuple[Laboratory, PosturePlan]:
    """Set up a laboratory and read a plan that fits it; the shipped plan if `plan` is None.

    Args:
        rig: folder of the effects that the laboratory is known to have.
        effects: to hide in it, or "random". seed: of the draws of these.
        statics: whether it is the static laboratory.

    Raises:
        InputError: what cannot be run.
    """
    described = described_robot(robot)
    made = plan_for(described, plan)
    placements = np.unique(made.placement).tolist()
    laboratory = Laboratory(described, preset)
    if rig is not None:
        laboratory = laboratory.with_known(*read_rig(rig, described))
    contacts = header_of(laboratory.rig).contacts
    hidden = read_effects(effects, described, placements, seed, statics, contacts=contacts)
    for text, instance in zip(effects, hidden, strict=True):
        try:
            laboratory = laboratory.with_effects(instance)
        except InputError:
            if text != RANDOM:
                raise
            raise InputError(
                "--effect random: found a laboratory that cannot be built, expected one that can; give "
                "another --seed"
            ) from None
    return laboratory, made
