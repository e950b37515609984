"""Unnamed rivals: patterns in the residuals that show whether anything is left, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from experiments.discovery.channels import SIZE
from experiments.discovery.linear import Linear

# Rows of the residuals with their channel and a word for a person.
PARTS = (
    ("A", slice(0, 2), "the centre of pressure"),
    ("F", slice(2, 3), "the sum of the cells"),
    ("T", slice(3, 4), "the twist of the right plate"),
    ("T", slice(4, 5), "the twist of the left plate"),
    ("C", slice(5, 6), "the swing foot's height"),
    ("C", slice(6, 8), "the swing foot's tilt"),
    ("C", slice(8, 11), "the swing foot's place"),
)
DISTINCT = 0.05


@dataclass(frozen=True)
class Pattern:
    """A pattern in the residuals.

    Attributes:
        channel: A, F, T or C. words: "the twist of the left plate depends on the right knee's angle".
        gain: of chi-square. freedom: number of its columns. p: among all patterns (Bonferroni).
    """

    channel: str
    words: str
    gain: float
    freedom: int
    p: float


def patterns(linear: Linear, residual: np.ndarray, taken: np.ndarray) -> list[Pattern]:
    """All patterns, the least probable first.

    Args:
        residual: whitened and projected, (r + 1,).
        taken: columns that are fitted already, whitened and projected, (r + 1, s).
    """
    seen = linear.seen
    basis = np.linalg.qr(taken)[0] if taken.shape[1] else taken
    out = []
    for channel, part, what in PARTS:
        if not np.isin(np.arange(len(seen))[:, None] * SIZE + np.arange(SIZE)[part], linear.white.rows).any():
            continue
        for how, functions in _functions(linear):
            raw = np.zeros((len(seen), SIZE, functions.shape[1] * (part.stop - part.start)))
            for k in range(part.stop - part.start):
                raw[:, part.start + k, k :: part.stop - part.start] = functions
            whole = linear.white(raw)
            columns = linear.project(whole)
            columns = columns - basis @ (basis.T @ columns)
            left, size, _ = np.linalg.svd(columns, full_matrices=False)
            # What the model takes up all but for a little is no pattern of its own.
            left = left[:, size > DISTINCT * max(float(np.linalg.norm(whole, 2)), 1e-12)]
            gain = float(((left.T @ residual) ** 2).sum())
            out.append(Pattern(channel, f"{what} {how}", gain, left.shape[1], 0.0))
    count = len(out)
    found = [
        Pattern(p.channel, p.words, p.gain, p.freedom, min(1.0, count * float(chi2.sf(p.gain, p.freedom))))
        for p in out
        if p.freedom
    ]
    return sorted(found, key=lambda p: p.p)


def _functions(linear: Linear) -> list[tuple[str, np.ndarray]]:
    """What residuals might depend on, with its columns, (m, k)."""
    seen = linear.seen
    out = []
    for k, joint in enumerate(seen.tree.joints):
        angle = seen.joint_angles[:, k] - seen.joint_angles[:, k].mean()
        out.append((f"depends on {joint}", np.column_stack([angle, angle**2 - (angle**2).mean()])))
    out.append(("drifts in time", np.column_stack([seen.part - 0.5, (seen.part - 0.5) ** 2])))
    numbers = np.unique(seen.measurements.placement)
    out.append(
        ("differs between placements", (seen.measurements.placement[:, None] == numbers).astype(float))
    )
    out.append(("is not zero", np.ones((len(seen), 1))))
    share = seen.foot_loads[0][:, :1] / seen.cell_forces.sum(axis=1, keepdims=True)
    out.append(("depends on the load share", np.column_stack([share - 0.5, (share - 0.5) ** 2])))
    return out
