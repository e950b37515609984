"""Outcome of a simulated experiment: the measurements and, separate from them, the truth."""

from dataclasses import dataclass

from tulip_testbed.base.result import Array
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.dynamics.hold import Held


@dataclass(frozen=True)
class Attempt:
    """One attempt at one posture in the full dynamics.

    Attributes:
        held: the held posture, or None if the attempt failed.
        reason: why it failed, or "".
        reading: sensor readings by column prefix.
        plates, true_plates: recorded and true plate poses in the base frame, (2, 3) [m, m, rad].
    """

    posture: int
    placement: int
    repeat: bool
    held: Held | None
    reason: str
    reading: dict[str, Array]
    plates: Array
    true_plates: Array


@dataclass(frozen=True, eq=False)
class Truth:
    """True values, which only a simulation knows.

    Attributes:
        mass: mass of the robot on the plates [kg].
        standard: its standard parameters (eq. 5), links in MJCF order, (n_links, 4) [kg, kg m].
        dropped: number of every posture without a successful attempt, and why its first attempt failed.
        attempts: all attempts in order; empty after a run by statics.
        wrenches: true wrenches in the frames of the wrench sensors behind the rows of the measurements,
            without zeros, (m, 2, 6) [N, Nm]; None: no such sensors.
        zeros: their true zeros, (2, c) [N, Nm].
    """

    mass: float
    standard: Array
    dropped: tuple[tuple[int, str], ...]
    attempts: tuple[Attempt, ...] = ()
    wrenches: Array | None = None
    zeros: Array | None = None

    def __repr__(self) -> str:
        links, postures = len(self.standard), len(self.dropped)
        return f"Truth: {self.mass:.3f} kg on the plates, {links} links, {postures} postures dropped"

    @property
    def measured(self) -> list[Attempt]:
        """Return the attempts behind the rows of the measurements, in the same order."""
        return [a for a in self.attempts if a.held is not None]

    @property
    def held(self) -> list[Held]:
        """Return the true states behind the rows of the measurements, in the same order."""
        return [a.held for a in self.attempts if a.held is not None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The measurements of one experiment, and its truth, which no estimator sees."""

    measurements: Measurements
    truth: Truth

    def __repr__(self) -> str:
        return f"Outcome: {self.measurements}; {self.truth}"


@dataclass(frozen=True, eq=False, repr=False)
class MovingOutcome(Outcome):
    """Outcome of a motion, with its samples, one each 10 ms, whose `posture` is the segment's number."""

    samples: Measurements


def dropped_postures(attempts: tuple[Attempt, ...]) -> tuple[tuple[int, str], ...]:
    """List the postures without a successful attempt, with the reason of the first attempt."""
    used = {a.posture for a in attempts if a.held is not None}
    first: dict[int, str] = {}
    for attempt in attempts:
        first.setdefault(attempt.posture, attempt.reason)
    return tuple((posture, reason) for posture, reason in first.items() if posture not in used)
