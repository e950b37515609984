"""Readings freed of effects, in the form in which the identification takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import carried, center
from tulip_testbed.sim.measurements import Measurements


def corrected(observed: Observation) -> Measurements:
    """The measurements of the nominal laboratory that would show what was `observed`.

    What moves the centre of pressure beside the cells (`shift`, a tilted stance foot) becomes a shift of
    both plates, which moves it just so; what presses on the cells beside the weight (`lift`) is taken off
    all of them in proportion, which leaves it where it is. Believed lengths stay with
    `observed.tree`.
    """
    forces = carried(observed)
    total = forces.sum(axis=1)
    plain = (forces[..., None] * observed.cell_places).sum(axis=1) / total[:, None]
    poses = observed.plate_poses.copy()
    poses[:, :, :2] += (center(observed) - plain)[:, None]
    share = np.where(forces != 0, (1 - observed.lift / total)[:, None], 1.0)
    return replace(
        observed.measurements,
        joint_angles=observed.joint_angles,
        cell_forces=observed.cell_forces * share,
        plate_poses=poses,
        cells=observed.cells,
    )


def without(
    measurements: Measurements, nominal: Nominal, instances: Sequence[EffectInstance]
) -> tuple[Measurements, Observation]:
    """Measurements freed of these effects, and all that was observed then."""
    observed = removed(observe(measurements, nominal), instances)
    return corrected(observed), observed
