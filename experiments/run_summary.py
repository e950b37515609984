"""A run in sentences: how many postures could be used, how the servos sagged, how the forces balanced."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.calibration.ordinary_laboratory import SPREADS
from tulip_testbed.sim.outcome import Truth

EXACT = (
    "Exact laboratory: the default estimator allows for imperfections that are not there, so its standard "
    "errors are too large."
)


def usable_postures(
    planned: int, rows: int, dropped: Sequence[str | None], paper: Mapping[str, Any] | None = None
) -> list[str]:
    """Describe how many postures could be used.

    Args:
        planned: how many there were. rows: of the measurements.
        dropped: why each of the others could not be used; None is not told.
        paper: the part `paper` of the robot's description.
    """
    beside = f" (paper {paper['postures_used']} of {paper['postures_planned']})" if paper else ""
    tally: dict[str, int] = {}
    for reason in filter(None, dropped):
        key = reason.rsplit(" ", 1)[0] if reason.startswith(("lost", "lifted")) else reason
        key = "slipped" if reason.startswith("slipped") else key
        tally[key] = tally.get(key, 0) + 1
    return [
        f"Usable postures: {planned - len(dropped)} of {planned}{beside}; {rows} rows with repeats.",
        *(
            f"  dropped {count}: {reason}"
            for reason, count in sorted(tally.items(), key=lambda item: -item[1])
        ),
    ]


def imperfections_line(scale: float, several: bool = False) -> str:
    """Describe the imperfections that were drawn.

    Args:
        scale: 0: there were none. several: whether every run drew its own.
    """
    if not scale:
        return EXACT
    low, high = (number(scale * spread, "g") for spread in SPREADS)
    whose = "laboratories, drawn again in every run" if several else "laboratory"
    return f"Ordinary {whose}: imperfections of all families, with spreads of {low} to {high} tolerances."


def sag_line(truth: Truth) -> str:
    """Describe how far the joints stay behind their commands."""
    sag = 1e3 * np.abs([held.joint_angles - held.commanded for held in truth.held])
    torque = np.abs([held.torques for held in truth.held]).max()
    return (
        f"Difference between joint angles and commands: median {np.median(sag):.1f} mrad, largest "
        f"{sag.max():.1f} mrad; largest torque {torque:.1f} Nm."
    )


def worst_balance(truth: Truth) -> dict[str, float] | None:
    """Find the worst of every balance kept in the dynamics, over all held postures; None in statics."""
    books = [dataclasses.asdict(held.balance) for held in truth.held]
    if not books:
        return None
    worst = {
        name: max(abs(b[name]) for b in books)
        for name in ("weight", "moments", "torques", "centre", "kinetic")
    }
    return worst | {"least_dissipated": min(b["dissipated"] for b in books)}


def balance_line(books: dict[str, float]) -> str:
    """Describe the largest imbalance of forces in any hold.

    Args:
        books: of a report, see `worst_balance`.
    """
    shown = {name: number(value, ".2g") for name, value in books.items()}
    return (
        f"Largest imbalance in any hold: cells against weight {shown['weight']} N, plates' moments against "
        f"the feet's wrench {shown['moments']} Nm, torques against statics {shown['torques']} Nm, CoP "
        f"against CoM {number(1e3 * books['centre'], '.2g')} mm, energy left in motion {shown['kinetic']} J."
    )
