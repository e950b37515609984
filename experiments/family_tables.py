"""A self-calibration as JSON and as tables: families, members, and what limits the base parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.table import Cell, Column, Table
from tulip_testbed.calibration.calibration_result import CalibratedFamily, SelfCalibration
from tulip_testbed.calibration.families import TOLERANCES
from tulip_testbed.effects.catalogue import acts_on, catalogue
from tulip_testbed.measurements.contacts import Contacts

SPREAD = "Spread: estimated s.d. of the members, with its 95 % interval; 1 is usual."
LARGEST_PARTS = 4
MOST_NAMED = 3  # members of a family
LEAST_SHARE = 0.01


def calibration_report(
    found: SelfCalibration, names: tuple[str, ...], contacts: Contacts | None
) -> list[Table | str]:
    """Return the tables of families, of members that the data know, and the budget.

    Args:
        names: of the base parameters, (p,). contacts: the sensors of the measurements.
    """
    members = member_table(found)
    return [
        family_table(found.families, "Ordinary imperfections", singly=True),
        *([members] if members.rows else []),
        *filter(None, (_near_zero(found), _small(found), _unseen(found), _exact(found, contacts))),
        budget_table(found, names, contacts),
        f"{first_to_improve(found).capitalize()}.",
        f"Tolerances: {found.assumed}.",
    ]


def _near_zero(found: SelfCalibration) -> str:
    """Count the members that the data determine and do not tell from zero."""
    count = sum(int((one.determined & ~_clear(one)).sum()) for one in found.families)
    return f"{count} members are determined by the data, and zero within their intervals." if count else ""


def _small(found: SelfCalibration) -> str:
    """Name the families whose members are small, though none of them differs significantly from zero."""
    names = [one.family.name for one in found.families if one.spread95[1] < 1 and not one.determined.any()]
    return f"Small by what the data say of the family as a whole: {', '.join(names)}." if names else ""


def _unseen(found: SelfCalibration) -> str:
    """Name the members that only their tolerance knows; the family's name alone if it is all of them."""
    names = []
    for one in found.families:
        if not one.determined.any():
            names += [one.family.name] if one.spread95[1] >= 1 else []
        else:
            unknown = [
                label for label, known in zip(one.family.labels, one.determined, strict=True) if not known
            ]
            count = f"{len(unknown)} of {len(one.determined)} members of {one.family.name}"
            names += unknown if len(unknown) <= MOST_NAMED else [count]
    return f"Known by their tolerance only: {', '.join(names)}." if names else ""


def first_to_improve(found: SelfCalibration) -> str:
    """Say which source gives most of the variance, on average over the base parameters."""
    share = found.shares.mean(axis=1)
    first = int(np.argmax(share))
    part = f"{100 * share[first]:.0f} % of the variance"
    return f"to improve first: {found.sources[first]}, {part} on average over the parameters"


def _clear(one: CalibratedFamily) -> np.ndarray:
    """Whether each member's interval is clear of zero, (m,)."""
    return (one.interval95[:, 0] > 0) | (one.interval95[:, 1] < 0)


def _exact(found: SelfCalibration, contacts: Contacts | None) -> str:
    """Name the families that the tolerances leave out."""
    there = {one.family.name for one in found.families}
    usual = [name for name, tolerances in TOLERANCES.items() if any(tolerances)]
    names = [name for name in usual if name not in there and acts_on(catalogue()[name], contacts)]
    return f"Taken as exact: {', '.join(names)}." if names else ""


def family_table(families: Sequence[CalibratedFamily], title: str, singly: bool = False) -> Table:
    """Return the families with their spreads.

    Args:
        singly: whether to count the members that the data determine one by one.
    """
    rows = []
    for k, one in enumerate(families):
        tolerance = one.family.effect.parameters[0].text(one.family.tolerance)
        spread = Cell(one.spread, f"families.{k}.spread")
        ends = (Cell(end, f"families.{k}.spread95.{side}") for side, end in enumerate(one.spread95))
        count = [f"{int(one.determined.sum())} of {len(one.determined)}"] if singly else []
        rows.append([one.family.name, tolerance, spread, *ends, *count])
    columns = (
        Column("family"),
        Column("tolerance"),
        Column("spread", "tolerances", ".2f"),
        Column("low", "", ".2f"),
        Column("high", "", ".2f"),
        *([Column("determined singly")] if singly else []),
    )
    return Table(title, columns, rows, SPREAD)


def member_table(found: SelfCalibration) -> Table:
    """Return the members that the data determine and tell from zero."""
    rows = []
    for one in found.families:
        effect, shown = one.family.effect, one.determined & _clear(one)
        for k, label in enumerate(one.family.labels):
            if shown[k]:
                low, high = one.interval95[k].tolist()
                parameters = effect.parameters_on(label.partition(":")[2])
                rows.append([label, parameters[k % len(parameters)].text(float(one.value[k]), (low, high))])
    return Table("Calibrated", (Column("imperfection"), Column("value ± half of the 95 % interval")), rows)


def budget_table(found: SelfCalibration, names: tuple[str, ...], contacts: Contacts | None) -> Table:
    """Return the largest parts of the variance of every base parameter."""
    rows = []
    for k, name in enumerate(names):
        order = np.argsort(-found.shares[:, k])[:LARGEST_PARTS]
        parts = [
            f"{found.sources[j]} {100 * found.shares[j, k]:.0f} %"
            for j in order
            if found.shares[j, k] >= LEAST_SHARE
        ]
        rows.append([name, float(np.sqrt(found.covariance[k, k])), ", ".join(parts)])
    columns = (Column("parameter"), Column("s.e.", "mm", ".2f", 1e3), Column("largest parts of its variance"))
    return Table("Budget of the standard errors", columns, rows, _sources_explained(contacts))


def _sources_explained(contacts: Contacts | None) -> str:
    """Say what the sources are, in words that fit the contact sensors."""
    sensors, one = ("cells", "cell") if contacts is None else ("contact sensors", "sensor")
    in_feet = contacts is not None and contacts.mount == "foot"
    plates = "right, left plate: errors of their recorded places; "
    return (
        f"{sensors}, encoders: their noise; {'' if in_feet else plates}internal forces: "
        f"between the feet, which no {one} shows; spreads: how well spreads and scales are known; a family: "
        "its members."
    )
