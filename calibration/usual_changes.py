"""Changes that ordinary imperfections of usual size make to readings that noise alone should change."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.families import Family, families_in
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.calibration.linearisation import joint_compliance, unseen_wrench
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.preflight.usual import Usual
from tulip_testbed.identification.residual_channels import ROWS, fields, sensitivity
from tulip_testbed.identification.residual_noise import noise_of, with_cell_noise
from tulip_testbed.measurements import Measurements

LEVEL = slice(ROWS["C"].start, ROWS["C"].start + 3)  # height, roll and pitch of the swing foot


def usual_changes(
    measurements: Measurements, nominal: Nominal, tolerances: Mapping[str, float] | None = None
) -> Usual:
    """Differentiate centre of pressure, total force and closure of the legs by the members, in tolerances.

    Args:
        measurements: of the nominal robot.
        tolerances: of families, in place of those of the measurements and those that fit the sensors [SI].

    Raises:
        InputError: an unknown family or an impossible tolerance.
    """
    observed = with_cell_noise(observe(measurements, nominal))
    # Without the noise that the residuals show, which columns at the readings would hold and so explain. Of a
    # moving record each stance shows it: a covariance of all rows of a placement would be large.
    whole = observed.measurements
    parts = replace(whole, placement=observed.stance) if observed.moves else whole
    smoothed = linear_model(observed.changed(measurements=parts), noise_of(observed)).smoothed
    observed = smoothed.changed(measurements=whole)
    families = families_in(observed, usual_tolerances(observed, tolerances))
    slope = sensitivity(observed, nominal.value)
    empty = np.zeros((len(measurements), 6, 0))
    rows = [0, 1, ROWS["F"].start, *range(LEVEL.start, LEVEL.stop)]
    columns = [
        member_columns(observed, nominal.value, slope, family)[:, rows] @ np.concatenate(family.parts, axis=1)
        for family in families
    ]
    every = np.concatenate([empty, *columns], axis=2)
    used = np.abs(every).max(axis=(0, 1)) > 0
    names = [name for family in families for part in family.parts for name in _names(family, part)]
    known = tuple(name for name, use in zip(names, used, strict=True) if use)
    every = every[..., used]
    sizes = np.concatenate([np.zeros(0), *(np.full(len(family), family.tolerance) for family in families)])
    compliance = joint_compliance(families, sizes, observed.tree.joints)
    by_angles = slope[:, LEVEL, fields(observed)["angles"]]
    unseen = by_angles @ (compliance[:, None] * observed.loads.levers) * unseen_wrench(observed)
    return Usual(known, every[:, :2], every[:, 2], every[:, 3:], unseen)


def _names(family: Family, part: np.ndarray) -> tuple[str, ...]:
    """Name the columns of a part of a family: its members, or all of them together."""
    return family.labels if part.shape[1] == len(family) else (family.name,) * part.shape[1]
