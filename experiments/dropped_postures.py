"""Postures that could not be measured, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class DroppedPosture:
    """A posture that could not be measured; the reason is None where it could hint at a random effect."""

    posture: int
    reason: str | None


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
