"""Notice a fault that begins at an unknown posture: generalised likelihood ratios over kinds and onsets.

A fault of size s that begins at posture k adds s g_t to the residuals of every posture t from k on; of that
the filter's innovations keep rho_t = g_t - H_t b_t, since the estimate follows the fault by b_t. With
y = sum rho' S^-1 gamma and w = sum rho' S^-1 rho the likelihood ratio, maximised over s, is y^2 / w,
chi-square of one degree of freedom without a fault. Onsets are those of the last postures and, further back,
every `APART`-th: memory is constant.

Reference: A. S. Willsky and H. L. Jones, A generalized likelihood ratio approach to the detection and
estimation of jumps in linear systems, IEEE Trans. Automatic Control 21, 1976.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.experiments.watching.day_model import RAMP
from tulip_testbed.experiments.watching.recursive_estimate import Innovation

RECENT, APART, EARLIER = 12, 6, 10  # onsets: the last ones, and so many further back at that distance
LEAST_SEEN = 1e-4  # information on one plausible size, below which a fault is invisible


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

    @property
    def ratio(self) -> np.ndarray:
        """Return twice the logarithm of the likelihood ratio of every fault from every onset, (o, c)."""
        seen = (self.information > LEAST_SEEN) & (self.onset >= 0)[:, None]
        return np.where(seen, self.pull**2 / np.where(seen, self.information, 1.0), 0.0)


def newest(changes: Changes) -> int:
    """Return the place of the last onset: the evidence of one row alone."""
    return int(changes.onset.argmax())


def no_changes(numbers: int, directions: int) -> Changes:
    """Return the evidence before the first row."""
    slots = RECENT + EARLIER
    return Changes(
        onset=np.full(slots, -1),
        bias=np.zeros((slots, numbers, directions)),
        pull=np.zeros((slots, directions)),
        information=np.zeros((slots, directions)),
    )


def changes_begun(changes: Changes, numbers: int) -> Changes:
    """Return the evidence in a new placement or stance: its last numbers are not biased yet."""
    bias = changes.bias.copy()
    bias[:, -numbers:] = 0.0
    return replace(changes, bias=bias)


def with_row(changes: Changes, found: Innovation, count: int, ramps: np.ndarray) -> Changes:
    """Return the evidence with one more row that the filter takes in.

    Args:
        count: number of the row, from 0. ramps: which directions grow with every row, (c,) bool.
    """
    changes = _with_onset(changes, count)
    grown = np.where(ramps, (count - changes.onset[:, None] + 1) / RAMP, 1.0)
    seen = found.faults * grown[:, None] - found.state @ changes.bias
    weighed = found.precision @ seen
    return Changes(
        onset=changes.onset,
        bias=changes.bias + found.gain @ seen,
        pull=changes.pull + found.value @ weighed,
        information=changes.information + (seen * weighed).sum(axis=1),
    )


def _with_onset(changes: Changes, count: int) -> Changes:
    """Return the evidence with an onset at this row, in the place of one that is no longer looked at.

    Recent onsets are in the first `RECENT` places, by their number; one that leaves them is kept if its
    number is a multiple of `APART`.
    """
    onset, bias = changes.onset.copy(), changes.bias.copy()
    pull, information = changes.pull.copy(), changes.information.copy()
    at = count % RECENT
    if onset[at] >= 0 and onset[at] % APART == 0:
        kept = RECENT + (onset[at] // APART) % EARLIER
        onset[kept], bias[kept] = onset[at], bias[at]
        pull[kept], information[kept] = pull[at], information[at]
    onset[at], bias[at], pull[at], information[at] = count, 0.0, 0.0, 0.0
    return Changes(onset, bias, pull, information)
