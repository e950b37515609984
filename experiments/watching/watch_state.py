"""The state of a watch between two rows. Its size depends on the plan, not on the number of rows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.recursive_estimate import (
    APART,
    EARLIER,
    RECENT,
    Belief,
    Changes,
    DesignInformation,
    Innovation,
    is_onset,
)
from tulip_testbed.experiments.watching.row_columns import RowColumns

OPEN, MEASURED, AGAIN = 0, 1, 2  # of a plan's rows
GAPS = 20  # times between postures that are remembered
REACH = RECENT + APART * EARLIER + APART  # rows back to the earliest onset


@dataclass(frozen=True, eq=False)
class Fault:
    """A change that was noticed and is there.

    Attributes:
        direction: its number among the model's. onset: count of the row at which it began.
        posture: that row's. size: in plausible sizes.
        gone: evidence that it has gone, ln of a likelihood ratio.
    """

    direction: int
    onset: int
    posture: int
    size: float
    gone: float = 0.0


@dataclass(frozen=True, eq=False)
class WatchState:
    """State of a watch.

    Attributes:
        belief: about the day's state. changes: evidence for faults. information: about the base parameters.
        done: of the plan's rows, one of OPEN, MEASURED and AGAIN, (m,).
        earlier: by posture, the stance in which it was measured last and its columns there.
        odd: postures in succession that did not fit, with their innovations.
        history: the states before the rows at which a change may have begun, without history and evidence.
        taken: plan's rows of the last rows that were taken in.
        spreads: s.d. within the last windows, (k, n_joints + 9).
        gaps: between the last postures of a placement [s].
        count: rows that were taken in.
        row: of the plan, that was measured last; -1: none. placement: its number. stance: count of the
            placements and stances so far. support: its support. time: of the last row [s].
        fault: that is there; None: none.
    """

    belief: Belief
    changes: Changes
    information: DesignInformation
    done: np.ndarray
    earlier: dict[int, tuple[int, RowColumns]] = field(default_factory=dict)
    odd: tuple[tuple[int, Innovation], ...] = ()
    history: tuple[WatchState, ...] = ()
    taken: tuple[int, ...] = ()
    spreads: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gaps: tuple[float, ...] = ()
    count: int = 0
    row: int = -1
    placement: int = -1
    stance: int = 0
    support: str = ""
    time: float = float("nan")
    fault: Fault | None = None

    def marked(self, rows: int | list[int], mark: int) -> WatchState:
        """Return the state with rows of the plan open, measured or to be measured again."""
        done = self.done.copy()
        done[rows] = mark
        return replace(self, done=done)

    def remembered(self, planned: int) -> WatchState:
        """Return the state that also remembers what is known before the row that comes now."""
        kept = tuple(before for before in self.history if is_onset(before.count, self.count))
        now = replace(self, history=(), changes=Changes.none(0, 0))
        return replace(self, history=(*kept, now), taken=(*self.taken, planned)[-REACH:])


def first_state(model: DayModel) -> WatchState:
    """Return the state before the first row."""
    n = len(model.covariance)
    return WatchState(
        belief=Belief(np.zeros(n), model.covariance),
        changes=Changes.none(n, len(model.directions)),
        information=DesignInformation.begun(np.zeros((model.parameters,) * 2)),
        done=np.full(len(model.plan), OPEN, np.int8),
    )
