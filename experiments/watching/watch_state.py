"""The state of a watch between two rows; its size depends on the plan, not on the number of rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tulip_testbed.experiments.watching.change_detection import Changes, no_changes
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.design_information import DesignInformation, no_information
from tulip_testbed.experiments.watching.recursive_estimate import Belief, first_belief
from tulip_testbed.identification.residual_channels import SIZE

OPEN, MEASURED, AGAIN = 0, 1, 2  # of a plan's rows
GAPS = 20  # times between postures that are remembered


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
class Before:
    """The state before a row, to which a watch returns if a change began there.

    Attributes:
        count: of the row. placement: its number. stance: its number.
    """

    count: int
    placement: int
    stance: int
    belief: Belief
    information: DesignInformation


@dataclass(frozen=True, eq=False)
class Earlier:
    """The result of a posture when it was measured last, by the plan's rows.

    Attributes:
        there: whether it was measured, (m,) bool. residual: (m, 11). state: derivative by the state,
            (m, 11, n) of float32. noise: covariance of what postures do not share, (m, 11, 11).
        used: (m, 11) bool. stance: in which stance, (m,).
    """

    there: np.ndarray
    stance: np.ndarray
    residual: np.ndarray
    state: np.ndarray
    noise: np.ndarray
    used: np.ndarray


@dataclass(frozen=True, eq=False)
class WatchState:
    """State of a watch.

    Attributes:
        belief: about the day's state. changes: evidence for faults. information: about the base parameters.
        history: what was known before the rows at which a change may have begun.
        taken: plan's rows of the last rows that were taken in.
        earlier: what the plan's postures showed.
        count: rows that were taken in. seen: rows that arrived.
        row: of the plan, that was measured last; -1: none. placement: its number. stance: count of the
            placements and stances so far. support: its support.
        time: of the last row [s]. gaps: between the last postures of a placement [s].
        done: of the plan's rows, one of OPEN, MEASURED and AGAIN, (m,).
        spreads: s.d. within the last windows, (k, n_joints + 9).
        odd: count of rows in succession that did not fit. odd_pull, odd_information: evidence of these rows
            for every fault, (c,). odd_posture: the first one's posture.
        fault: that is there; None: none.
    """

    belief: Belief
    changes: Changes
    information: DesignInformation
    earlier: Earlier
    done: np.ndarray
    odd_pull: np.ndarray
    odd_information: np.ndarray
    history: tuple[Before, ...] = ()
    taken: tuple[int, ...] = ()
    spreads: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gaps: tuple[float, ...] = ()
    count: int = 0
    seen: int = 0
    row: int = -1
    placement: int = -1
    stance: int = 0
    support: str = ""
    time: float = float("nan")
    odd: int = 0
    odd_posture: int = -1
    fault: Fault | None = None


def first_state(model: DayModel) -> WatchState:
    """Return the state before the first row."""
    n, c, m = len(model.covariance), len(model.directions), len(model.plan)
    return WatchState(
        belief=first_belief(model),
        changes=no_changes(n, c),
        information=no_information(model.parameters),
        earlier=Earlier(
            there=np.zeros(m, bool),
            stance=np.full(m, -1),
            residual=np.zeros((m, SIZE)),
            state=np.zeros((m, SIZE, n), np.float32),
            noise=np.zeros((m, SIZE, SIZE)),
            used=np.zeros((m, SIZE), bool),
        ),
        done=np.full(m, OPEN, np.int8),
        odd_pull=np.zeros(c),
        odd_information=np.zeros(c),
    )
