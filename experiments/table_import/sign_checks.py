"""Hold the signs of an imported table against the robot where both feet on the ground can tell them."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.numbers import number
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.preflight.stance_checks import CLEARLY, LEVEL, misclosures
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES

BEYOND_RANGE = 0.1  # rad
NEAR_WEIGHT = 0.2  # of the nominal weight
NEAR_CENTER = 0.03  # m, between centre of pressure and nominal centre of mass
BOTH = "double"


@dataclass(frozen=True)
class SignCheck:
    """Confirmations of a table's signs, by column of the contract, and what contradicts signs or units."""

    confirmed: dict[str, str]
    doubtful: list[str]

    def of(self, column: str) -> str | None:
        """Return what confirms the sign of a column, or that of all values of its device."""
        return self.confirmed.get(column) or self.confirmed.get(column.rpartition(".")[0])


Evidence = Iterator[tuple[str, str, str]]  # column, what confirms its sign, what is doubtful; "" for none


def check_signs(measurements: Measurements, nominal: Nominal) -> SignCheck:
    """Turn each sign, one at a time, and see whether the robot fits better or worse."""
    signs = SignCheck({}, [])
    for part in (_by_range, _by_closed_legs, _by_weight, _by_center):
        for column, confirms, doubt in part(measurements, nominal):
            if not doubt:
                signs.confirmed.setdefault(column, confirms)
            # A range may have confirmed it: then another joint of the closed legs has the wrong sign.
            elif column not in signs.confirmed:
                signs.doubtful.append(doubt)
    return signs


def _by_closed_legs(m: Measurements, nominal: Nominal) -> Evidence:
    """Soles lie level on level ground only if all joints between them have the right sign."""
    m = m.take(np.flatnonzero(m.support == BOTH))
    if not len(m):
        return
    base, others = misclosures(m, nominal)
    # Where one turned sign closes the legs, the others are innocent.
    better = LEVEL if min(others) <= LEVEL else base / CLEARLY
    for joint, turned in zip(m.joints, others, strict=True):
        name = f"q.{joint}"
        if base > LEVEL and turned < min(better, base / CLEARLY):
            text = (
                f"the soles would be level within {number(turned, '.2g')} rad with its sign turned, they are"
            )
            yield name, "", f"{name}: {text} within {number(base, '.2g')} rad"
        elif base <= LEVEL and turned > CLEARLY * max(base, LEVEL / CLEARLY):
            yield name, "closed legs", ""
    if base > LEVEL:
        text = f"by the angles the soles are level within {number(base, '.2g')} rad only, expected {LEVEL:g}"
        yield "", "", f"closed legs: {text}: a sign, unit or zero"


def _by_range(m: Measurements, nominal: Nominal) -> Evidence:
    for k, joint in enumerate(m.joints):
        low, high = nominal.parameters.tree.joint_range[k]
        values, name = m.joint_angles[:, k], f"q.{joint}"
        beyond, turned = (
            float(np.maximum(low - angles, angles - high).max()) for angles in (values, -values)
        )
        if beyond > BEYOND_RANGE > turned:
            text = f"leaves its range by {number(beyond, '.2g')} rad, not with its sign turned"
            yield name, "", f"{name}: {text}"
        elif beyond <= BEYOND_RANGE < turned:
            yield name, "range of the joint", ""


def _by_weight(m: Measurements, nominal: Nominal) -> Evidence:
    """Check that the vertical forces carry the robot."""
    if m.contacts is None:
        names, total = [f"cell.{plate}" for plate in PLATES], m.cell_forces.sum(axis=1)
    else:
        assert m.wrenches is not None
        names = [f"wrench.{plate}.fz" for plate in PLATES]
        total = np.nansum(m.wrenches[..., m.contacts.channels.index("fz")], axis=1)
    load, masses = float(np.median(total)), {"the robot's model": nominal.mass}
    if m.weighed_mass is not None:
        masses["the stated mass"] = m.weighed_mass[0]
    for what, mass in masses.items():
        if abs(load / (weight := mass * m.gravity) - 1) < NEAR_WEIGHT:
            yield from ((name, "weight", "") for name in names)
        else:
            text = f"weight: the vertical forces sum to {number(load, '.4g')} N, {what} weighs"
            yield "", "", f"{text} {number(weight, '.4g')} N: a unit, sign or zero"


def _by_center(m: Measurements, nominal: Nominal) -> Evidence:
    """Check the moments' signs: the centre of pressure must lie below the nominal centre of mass."""
    if m.contacts is None or (base := _apart(m, nominal)) is None:
        return
    assert m.wrenches is not None
    for k, channel in enumerate(m.contacts.channels):
        for p, plate in enumerate(PLATES if channel in ("mx", "my") else ()):
            readings = m.wrenches.copy()
            readings[:, p, k] *= -1
            turned = _apart(dataclasses.replace(m, wrenches=readings), nominal)
            if turned is None:
                continue
            name = f"wrench.{plate}.{channel}"
            if base > NEAR_CENTER and turned < base / CLEARLY:
                text = f"fits {base / turned:.1f} times as well with its sign turned"
                yield name, "", f"{name}: the centre of pressure {text}"
            elif base <= NEAR_CENTER and turned > CLEARLY * base:
                yield name, "centre of pressure", ""
    if base > NEAR_CENTER:
        text = f"centre of pressure: {number(1e3 * base, '.0f')} mm from the model's centre of mass (r.m.s.)"
        expected = f"expected {1e3 * NEAR_CENTER:.0f} or less"
        yield "", "", f"{text}, {expected}: a sign, unit, zero or pose"


def _apart(m: Measurements, nominal: Nominal) -> float | None:
    """Return the distance between centre of pressure and nominal centre of mass, r.m.s. [m]."""
    try:
        apart = contact_pressure(observe(m, nominal)).center - nominal.center_of_mass(m.joint_angles)
    except InputError:
        return None
    both = m.support == BOTH
    return float(np.sqrt((apart[both] ** 2).sum(axis=1).mean())) if both.any() else None
