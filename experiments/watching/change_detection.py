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

    @classmethod
    def none(cls, numbers: int, directions: int) -> Changes:
        """Return the evidence before the first row."""
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

    @property
    def newest(self) -> int:
        """Return the place of the last onset: the evidence of one row alone."""
        return int(self.onset.argmax())

    def begun(self, numbers: int) -> Changes:
        """Return the evidence in a new placement or stance: its last numbers are not biased yet."""
        bias = self.bias.copy()
        bias[:, -numbers:] = 0.0
        return replace(self, bias=bias)

    def with_row(self, innovation: Innovation, count: int, ramps: np.ndarray) -> Changes:
        """Return the evidence with one more row that the filter takes in.

        Args:
            count: number of the row, from 0. ramps: which directions grow with every row, (c,) bool.
        """
        changes = self._with_onset(count)
        grown = np.where(ramps, (count - changes.onset[:, None] + 1) / RAMP, 1.0)
        seen = innovation.faults * grown[:, None] - innovation.state @ changes.bias
        weighed = innovation.precision @ seen
        return Changes(
            onset=changes.onset,
            bias=changes.bias + innovation.gain @ seen,
            pull=changes.pull + innovation.value @ weighed,
            information=changes.information + (seen * weighed).sum(axis=1),
        )

    def _with_onset(self, count: int) -> Changes:
        """Return the evidence with an onset at this row, in the place of one that is no longer looked at.

        Recent onsets are in the first `RECENT` places, by their number; one that leaves them is kept if its
        number is a multiple of `APART`.
        """
        parts = {name: values.copy() for name, values in vars(self).items()}
        at, onset = count % RECENT, self.onset
        if onset[at] >= 0 and onset[at] % APART == 0:
            kept = RECENT + (onset[at] // APART) % EARLIER
            for values in parts.values():
                values[kept] = values[at]
        for values in parts.values():
            values[at] = 0
        parts["onset"][at] = count
        return Changes(**parts)


def is_onset(onset: int, count: int) -> bool:
    """Return whether an onset is still looked at when row `count` comes."""
    back = count - onset
    return back < RECENT or (onset % APART == 0 and back < RECENT + APART * EARLIER + APART)
