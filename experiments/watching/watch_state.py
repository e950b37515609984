"""The state of a watch between two rows; its size depends on the plan, not on the number of rows.

The state of the day is estimated by a Kalman filter, linear about the present base parameters.

The second estimate is the information of the postures about the base parameters by the data sheets alone. It
is that of generalised least squares on the centre of pressure, with the errors of the plates' recorded poses
common to a placement. It depends on where the robot stood and on the stated noise, not on what the residuals
are: an experimenter who stops when it suffices does not choose the errors, and intervals keep their coverage.

Reference: R. E. Kalman, A new approach to linear filtering and prediction problems, J. Basic Eng. 82, 1960.

A fault that begins at an unknown posture is noticed by generalised likelihood ratios over kinds and onsets. A
fault of size s that begins at posture k adds s g_t to the residuals of every posture t from k on; of that
the filter's innovations keep rho_t = g_t - H_t b_t, since the estimate follows the fault by b_t. With
y = sum rho' S^-1 gamma and w = sum rho' S^-1 rho the likelihood ratio, maximised over s, is y^2 / w,
chi-square of one degree of freedom without a fault. Onsets are those of the last postures and, further back,
every `APART`-th: memory is constant.

Reference: A. S. Willsky and H. L. Jones, A generalized likelihood ratio approach to the detection and
estimation of jumps in linear systems, IEEE Trans. Automatic Control 21, 1976.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.experiments.watching.day_model import PLATES, RAMP, STANCE, DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns
from tulip_testbed.identification.observation import LONG_GAP, STILL
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS

OF_PLACEMENT = PLATES + STANCE  # numbers of the state that begin again with a placement
CENTER = slice(0, 2)  # residuals of the centre of pressure
LEAST_SHARE = 1e-10  # of the largest eigenvalue, below which parameters are not determined yet
RECENT, APART, EARLIER = 12, 6, 10  # onsets: the last ones, and so many further back at that distance
REACH = RECENT + APART * EARLIER  # rows back to the earliest onset
LEAST_SEEN = 1e-4  # information on one plausible size, below which a fault is invisible
OPEN, MEASURED, AGAIN = 0, 1, 2  # of a plan's rows
GAPS, LEAST_GAPS = 20, 3  # times between postures that are remembered; from which one is compared with them


@dataclass(frozen=True, eq=False)
class Innovation:
    """The difference between a posture's residuals and their prediction.

    Attributes:
        value: residuals less their prediction, (11,). covariance: of the prediction, (11, 11).
        precision: its inverse. gain: of the state by the residuals, (n, 11).
        here: the posture's columns about the estimate by which it was predicted.
    """

    value: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    gain: np.ndarray
    here: RowColumns

    @property
    def chi_square(self) -> float:
        """Return the square of the innovation in its own covariance."""
        return float(self.value @ self.precision @ self.value)

    @property
    def evidence(self) -> np.ndarray:
        """Return y and w of every fault that begins here, by this row alone, (2, c)."""
        weighed = self.precision @ self.here.faults
        return np.stack([self.value @ weighed, (self.here.faults * weighed).sum(axis=0)])


@dataclass(frozen=True, eq=False)
class Belief:
    """Mean, (n,), and covariance, (n, n), of the state."""

    mean: np.ndarray
    covariance: np.ndarray

    def later(self, model: DayModel, at: slice, kept: float) -> Belief:
        """Return the belief after errors at these numbers kept this correlation with themselves.

        With none left they begin again.
        """
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[at] *= kept
        covariance[at] *= kept
        covariance[:, at] *= kept
        covariance[at, at] += (1 - kept**2) * model.covariance[at, at]
        return Belief(mean, covariance)

    def predict(self, model: DayModel, row: RowColumns) -> Innovation:
        """Predict a posture and return by how much it is missed."""
        here = row.about(self.mean[: model.parameters])
        across = here.state @ self.covariance
        covariance = across @ here.state.T + here.noise(model.noise.encoder, model.shares[1])
        covariance = (covariance + covariance.T) / 2
        scale = 1 / np.sqrt(np.diag(covariance))
        precision = scale[:, None] * np.linalg.inv(scale[:, None] * covariance * scale) * scale
        return Innovation(
            value=here.residual - here.state @ self.mean,
            covariance=covariance,
            precision=precision,
            gain=across.T @ precision,
            here=here,
        )

    def updated(self, innovation: Innovation) -> Belief:
        mean = self.mean + innovation.gain @ innovation.value
        covariance = self.covariance - innovation.gain @ innovation.covariance @ innovation.gain.T
        return Belief(mean, (covariance + covariance.T) / 2)


@dataclass(frozen=True, eq=False)
class DesignInformation:
    """Information on the base parameters and on the errors of the present placement's plates.

    Attributes:
        joint: both, parameters first, (p + 6, p + 6) [1/m2].
        last: whitened columns of the last row, (2, p + 6); None: it is not correlated with the next one.
    """

    joint: np.ndarray
    last: np.ndarray | None = None

    @classmethod
    def begun(cls, settled: np.ndarray) -> DesignInformation:
        """Return the information as a placement begins, `settled` on the parameters, (p, p) [1/m2]."""
        return cls(block_diag(settled, np.eye(PLATES)))

    @property
    def whole(self) -> np.ndarray:
        """Return the information on the base parameters alone, (p, p)."""
        own, across = np.split(self.joint[:-PLATES], [-PLATES], axis=1)
        return own - across @ np.linalg.solve(self.joint[-PLATES:, -PLATES:], across.T)

    def standard_errors(self) -> np.ndarray:
        """Return the standard errors of the base parameters, (p,) [m]; infinite until all are determined."""
        whole = self.whole
        scale = 1 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
        scaled = scale[:, None] * whole * scale
        values = np.linalg.eigvalsh(scaled)
        if values[0] <= LEAST_SHARE * values[-1]:
            return np.full(len(whole), np.inf)
        return scale * np.sqrt(np.diag(np.linalg.inv(scaled)))

    def with_posture(self, model: DayModel, row: RowColumns, kept: float = 0.0) -> DesignInformation:
        """Return the information with one more posture, by its noise's correlation with the row before."""
        by_angles = row.by_angles[CENTER]
        noise = model.noise.encoder**2 * by_angles @ by_angles.T + row.cells[CENTER, CENTER]
        base, plates = np.arange(model.parameters), np.arange(-OF_PLACEMENT, -STANCE)
        white = np.linalg.solve(np.linalg.cholesky(noise), row.state[CENTER, np.append(base, plates)])
        new = white if self.last is None else (white - kept * self.last) / np.sqrt(1 - kept**2)
        return DesignInformation(self.joint + new.T @ new, white)


@dataclass(frozen=True, eq=False)
class Changes:
    """Evidence for every fault from every onset.

    Attributes:
        onset: counts of the rows at which faults may have begun, (o,), -1: none.
        bias: of the estimate by one plausible size of each fault, (o, n, c).
        pull, information: y and w, (o, c).
    """

    onset: np.ndarray
    bias: np.ndarray
    pull: np.ndarray
    information: np.ndarray

    @classmethod
    def none(cls, numbers: int, directions: int) -> Changes:
        onsets = RECENT + EARLIER
        return cls(
            onset=np.full(onsets, -1),
            bias=np.zeros((onsets, numbers, directions)),
            pull=np.zeros((onsets, directions)),
            information=np.zeros((onsets, directions)),
        )

    @property
    def ratio(self) -> np.ndarray:
        """Return twice the logarithm of the likelihood ratio of every fault from every onset, (o, c)."""
        seen = (self.information > LEAST_SEEN) & (self.onset >= 0)[:, None]
        return np.where(seen, self.pull**2 / np.where(seen, self.information, 1.0), 0.0)

    def later(self, at: slice, kept: float) -> Changes:
        """Return the evidence after errors at these numbers kept so much, as in `Belief.later`."""
        bias = self.bias.copy()
        bias[:, at] *= kept
        return replace(self, bias=bias)

    def with_row(self, innovation: Innovation, count: int, ramps: np.ndarray) -> Changes:
        """Return the evidence with one more row that the filter takes in.

        Its onset takes the place of one that is no longer looked at: recent ones are in the first `RECENT`
        places, by their number; one that leaves them is kept if its number is a multiple of `APART`.

        Args:
            count: number of the row, from 0. ramps: which directions grow with every row, (c,) bool.
        """
        onset, bias, pull, information = every = [values.copy() for values in vars(self).values()]
        at = count % RECENT
        if onset[at] >= 0 and onset[at] % APART == 0:
            kept = RECENT + (onset[at] // APART) % EARLIER
            for values in every:
                values[kept] = values[at]
        for values in every:
            values[at] = 0
        onset[at] = count
        grown = np.where(ramps, (count - onset[:, None] + 1) / RAMP, 1.0)
        seen = innovation.here.faults * grown[:, None] - innovation.here.state @ bias
        weighed = innovation.precision @ seen
        return Changes(
            onset=onset,
            bias=bias + innovation.gain @ seen,
            pull=pull + innovation.value @ weighed,
            information=information + (seen * weighed).sum(axis=1),
        )


@dataclass(frozen=True)
class Fault:
    """A change that was noticed and is there.

    Attributes:
        direction: its number among the model's. posture: at which it began. size: in plausible sizes.
        gone: evidence that it has gone, ln of a likelihood ratio.
    """

    direction: int
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
        odd: the last posture and its innovation, if it did not fit.
        history: the states before the rows at which a change may have begun, without history and evidence.
        taken: plan's rows of the last rows that were taken in; of a motion, their own numbers.
        spreads: s.d. within the last windows, (k, n_joints + 9).
        gaps: between the last postures of a placement [s].
        count: rows that were taken in.
        row: of the plan, that was measured last; -1: none. placement: its number. stance: count of the
            placements and stances so far. support: its support. time: of the last row, stood: of the
            stance's first one [s].
        fault: that is there; None: none.
    """

    belief: Belief
    changes: Changes
    information: DesignInformation
    done: np.ndarray
    spreads: np.ndarray
    earlier: dict[int, tuple[int, RowColumns]] = field(default_factory=dict)
    odd: tuple[int, Innovation] | None = None
    history: tuple[WatchState, ...] = ()
    taken: tuple[int, ...] = ()
    gaps: tuple[float, ...] = ()
    count: int = 0
    row: int = -1
    placement: int = -1
    stance: int = 0
    support: str = ""
    time: float = float("nan")
    stood: float = float("nan")
    fault: Fault | None = None

    def marked(self, rows: int | list[int], mark: int) -> WatchState:
        """Return the state with rows of the plan open, measured or to be measured again; none in a motion."""
        if not len(self.done):
            return self
        done = self.done.copy()
        done[rows] = mark
        return replace(self, done=done)


def first_state(model: DayModel) -> WatchState:
    n = len(model.covariance)
    return WatchState(
        belief=Belief(np.zeros(n), model.covariance),
        changes=Changes.none(n, len(model.directions)),
        information=DesignInformation.begun(np.zeros((model.parameters,) * 2)),
        done=np.full(len(model.plan) if model.held else 0, OPEN, np.int8),
        spreads=np.zeros((0, len(model.unseen) + len(CELLS) + 1)),
    )


def begin_row(model: DayModel, state: WatchState, row: Measurements, planned: int) -> WatchState:
    """Return the state at a row before its readings are looked at: a new placement or stance may begin."""
    placement, support, time = int(row.placement[0]), str(row.support[0]), float(row.time[0])
    moved = placement != state.placement
    anew = moved or support != state.support
    gap, gaps, stood = time - state.time, state.gaps, state.stood
    usual = float(np.median(gaps)) if len(gaps) >= LEAST_GAPS else np.inf
    # Within a placement the robot may have been put down again, see `Observation.stance`.
    put_down, fading = planned != state.row + 1, []
    if model.window is not None:  # feet creep below moving legs, see `Observation.stance`
        put_down = not 0 < gap <= LONG_GAP * model.window or time - stood >= STILL
        fading = [(model.lasting, model.kept(gap))]
    elif np.isfinite(gap):
        put_down = gap <= 0 or gap > LONG_GAP * usual or (usual == np.inf and planned > state.row + 1)
    if anew or put_down:
        fading.append((slice(-OF_PLACEMENT if anew else -STANCE, None), 0.0))
        stood = time
    belief, changes, information = state.belief, state.changes, state.information
    for at, kept in fading:
        belief, changes = belief.later(model, at, kept), changes.later(at, kept)
    return replace(
        state,
        belief=belief,
        changes=changes,
        information=DesignInformation.begun(information.whole) if moved else information,
        gaps=(*gaps, gap)[-GAPS:] if not anew and 0 < gap < np.inf else gaps,
        row=planned,
        placement=placement,
        stance=state.stance + (anew or put_down),
        support=support,
        time=time,
        stood=stood,
    )
