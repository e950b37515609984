"""Readings freed of effects, in the form in which the identification takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.discovery.channels import carried, center
from experiments.effects.occurrence import Occurrence, freed
from experiments.effects.seen import Seen, see
from identification.nominal import Nominal
from sim.measurements import Measurements


def corrected(seen: Seen) -> Measurements:
    """The measurements of the nominal laboratory that would show what was `seen`.

    What moves the centre of pressure beside the cells (`shift`, a tilted stance foot) becomes a shift of
    both plates, which moves it just so; what presses on the cells beside the weight (`lift`) is taken off
    all of them in proportion, which leaves it where it is. Lengths that are believed stay with `seen.tree`.
    """
    forces = carried(seen)
    total = forces.sum(axis=1)
    plain = (forces[..., None] * seen.cell_places).sum(axis=1) / total[:, None]
    poses = seen.plate_poses.copy()
    poses[:, :, :2] += (center(seen) - plain)[:, None]
    share = np.where(forces != 0, (1 - seen.lift / total)[:, None], 1.0)
    return replace(
        seen.measurements,
        joint_angles=seen.joint_angles,
        cell_forces=seen.cell_forces * share,
        plate_poses=poses,
        cells=seen.cells,
    )


def without(
    measurements: Measurements, nominal: Nominal, occurrences: Sequence[Occurrence]
) -> tuple[Measurements, Seen]:
    """Measurements freed of these effects, and all that was seen then."""
    seen = freed(see(measurements, nominal), occurrences)
    return corrected(seen), seen
