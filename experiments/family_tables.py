"""A self-calibration as JSON and as tables: families, members, and what limits the base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tulip_testbed.calibration.calibration_result import CalibratedFamily, SelfCalibration
from tulip_testbed.sim.table import Column, Table

LARGEST_PARTS = 4
LEAST_SHARE = 0.01


def calibration_document(found: SelfCalibration, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the keys that the self-calibrating estimator adds to the document of an identification.

    Args:
        names: of the base parameters, (p,).
    """
    return {
        "budget": [
            {"parameter": name, "source": source, "share": float(found.shares[row, k])}
            for k, name in enumerate(names)
            for row, source in enumerate(found.sources)
        ],
        "families": family_documents(found.families),
        "calibrated": [i.document() for one in found.families for i in one.instances],
    }


def family_documents(families: Sequence[CalibratedFamily]) -> list[dict[str, Any]]:
    """Return the families with their spreads for JSON."""
    return [
        {
            "name": one.family.name,
            "tolerance": one.family.tolerance,
            "spread": one.spread,
            "low95": one.spread95[0],
            "high95": one.spread95[1],
        }
        for one in families
    ]


def calibration_report(found: SelfCalibration, names: tuple[str, ...]) -> list[Table | str]:
    """Return the tables of families, of members that the data know, and the budget."""
    unseen = [text for one in found.families if (text := _unseen(one))]
    sentence = f"Known by their prior only: {', '.join(unseen)}." if unseen else ""
    members = member_table(found)
    return [
        family_table(found),
        *([members] if members.rows else []),
        *filter(None, (_near_zero(found), sentence)),
        budget_table(found, names),
        _first_to_improve(found),
        f"Tolerances: {found.assumed}.",
    ]


def _near_zero(found: SelfCalibration) -> str:
    """Count the members that the data know and do not tell from zero."""
    count = sum(int((one.determined & ~_clear(one)).sum()) for one in found.families)
    return f"{count} members are known by the data and zero within their intervals." if count else ""


def _first_to_improve(found: SelfCalibration) -> str:
    """Say which source gives most of the variance, on average over the base parameters."""
    share = found.shares.mean(axis=1)
    first = int(np.argmax(share))
    part = f"{100 * share[first]:.0f} % of the variance"
    return f"To improve first: {found.sources[first]}, {part} on average over the parameters."


def _clear(one: CalibratedFamily) -> np.ndarray:
    """Whether each member's interval is clear of zero, (m,)."""
    return (one.interval95[:, 0] > 0) | (one.interval95[:, 1] < 0)


def _unseen(one: CalibratedFamily) -> str:
    """Name the members that only their prior knows; the family's name alone if it is all of them."""
    if not one.determined.any():
        return one.family.name
    labels = zip(one.family.labels, one.determined, strict=True)
    return ", ".join(label for label, known in labels if not known)


def family_table(found: SelfCalibration) -> Table:
    """Return the families with their spreads."""
    rows = []
    for one in found.families:
        parameter = one.family.effect.parameters[0]
        rows.append(
            [
                one.family.name,
                parameter.text(one.family.tolerance),
                one.spread,
                *one.spread95,
                f"{int(one.determined.sum())} of {len(one.determined)}",
            ]
        )
    columns = (
        Column("family"),
        Column("tolerance"),
        Column("spread", "tolerances", ".2f"),
        Column("low", "", ".2f"),
        Column("high", "", ".2f"),
        Column("known by the data"),
    )
    return Table("Ordinary imperfections", columns, rows)


def member_table(found: SelfCalibration) -> Table:
    """Return the members that the data determine and tell from zero."""
    rows = []
    for one in found.families:
        parameters, shown = one.family.effect.parameters, one.determined & _clear(one)
        for k, label in enumerate(one.family.labels):
            if shown[k]:
                low, high = one.interval95[k].tolist()
                rows.append([label, parameters[k % len(parameters)].text(float(one.value[k]), (low, high))])
    return Table("Calibrated", (Column("imperfection"), Column("value ± half of the 95 % interval")), rows)


def budget_table(found: SelfCalibration, names: tuple[str, ...]) -> Table:
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
    return Table("Budget of the standard errors", columns, rows)
