"""What an experiment in a laboratory comes to: measurements and, kept apart from them, the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.sim.dynamics.hold import Held
from tulip_testbed.sim.measurements import Measurements


@dataclass(frozen=True)
class Attempt:
    """One try at one posture in the full dynamics.

    Attributes:
        held: the posture, or None if it was dropped; reason: why, else "".
        reading: what the sensors said, by column prefix.
        plates, true_plates: recorded and true poses in the base frame, (2, 3) [m, m, rad].
    """

    posture: int
    placement: int
    repeat: bool
    held: Held | None
    reason: str
    reading: dict[str, np.ndarray]
    plates: np.ndarray
    true_plates: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What only a simulation knows.

    Attributes:
        mass: of the robot on the plates [kg].
        standard: its standard parameters (eq. 5), links in MJCF order, (n_links, 4) [kg, kg m].
        dropped: number of every posture of which no try could be used, and why its first one could not.
        attempts: every try in order; statics keeps no account of them.
    """

    mass: float
    standard: np.ndarray
    dropped: tuple[tuple[int, str], ...]
    attempts: tuple[Attempt, ...] = ()

    @property
    def measured(self) -> list[Attempt]:
        """The tries behind the rows of the measurements, in the same order."""
        return [a for a in self.attempts if a.held is not None]

    @property
    def held(self) -> list[Held]:
        """The true states behind the rows of the measurements, in the same order."""
        return [a.held for a in self.attempts if a.held is not None]


@dataclass(frozen=True)
class Outcome:
    """What an experiment hands over, and what really happened.

    Attributes:
        measurements: the data contract. truth: what an estimator never sees.
    """

    measurements: Measurements
    truth: Truth


def dropped_postures(attempts: tuple[Attempt, ...]) -> tuple[tuple[int, str], ...]:
    """List the postures of which no try could be used, with the reason of the first try."""
    used = {a.posture for a in attempts if a.held is not None}
    first: dict[int, str] = {}
    for attempt in attempts:
        first.setdefault(attempt.posture, attempt.reason)
    return tuple((posture, reason) for posture, reason in first.items() if posture not in used)
