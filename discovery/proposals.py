"""Experiments that would separate equivalent explanations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import effect_columns, presence_column
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES

LEAST_SEPARATION = 0.5  # ln of the Bayes factor, from which an experiment is proposed
# Effects of the room rather than of the robot or the plates: for a robot that is turned they turn.
OF_THE_ROOM = ("tilt", "tether")


@dataclass(frozen=True)
class Proposal:
    """An experiment, and how well it would separate the explanations.

    Attributes:
        words: what to do.
        separation: expected ln of the Bayes factor between the two explanations that are hardest to
            distinguish, if the first of them is true.
        gain: ratio to the separation by the experiment as it is.
    """

    words: str
    separation: float
    gain: float


def proposals(linear: LinearModel, explanations: Sequence[Fitted]) -> list[Proposal]:
    """Propose experiments that separate explanations, the best first.

    In each of them half of the placements are measured in another way, in the same postures.
    """
    now = _separation(linear, explanations, lambda candidate: (candidate, 1.0))
    ways: list[tuple[str, Callable[[Candidate], tuple[Candidate, float]]]] = [
        ("Turn the robot by 180 deg on the plates for half of the placements.", _turned),
        ("Exchange the two plates for half of the placements.", lambda c: (_on_other_plate(c), 1.0)),
        (
            "Turn each plate by 180 deg about its middle for half of the placements.",
            lambda c: (_opposite(c), 1.0),
        ),
    ]
    found = [(words, _separation(linear, explanations, way)) for words, way in ways]
    found.append(("Measure twice as many placements.", 2 * now))
    least = max(1.05 * now, LEAST_SEPARATION)
    out = [Proposal(words, size, size / max(now, 1e-9)) for words, size in found if size > least]
    return sorted(out, key=lambda p: -p.separation)


def _separation(
    linear: LinearModel, explanations: Sequence[Fitted], way: Callable[[Candidate], tuple[Candidate, float]]
) -> float:
    """Compute the least expected ln Bayes factor between two explanations."""
    numbers = np.unique(linear.observed.measurements.placement)
    other = np.isin(linear.observed.measurements.placement, numbers[1::2])
    rows = np.repeat(other, 11)[linear.whitening.rows]
    columns_of = []
    for term in explanations:
        candidate, sign = way(term.candidate)
        own = _columns(linear, term.candidate, term)
        own[rows] = sign * _columns(linear, candidate, term)[rows]
        columns_of.append(linear.project(own))
    least = np.inf
    for i, j in permutations(range(len(explanations)), 2):
        sizes = explanations[i].sizes if explanations[i].sizes.size else np.ones(1)
        signal = columns_of[i] @ sizes
        basis = np.linalg.qr(columns_of[j])[0]
        least = min(least, 0.5 * float(((signal - basis @ (basis.T @ signal)) ** 2).sum()))
    return float(least)


def _columns(linear: LinearModel, candidate: Candidate, term: Fitted) -> np.ndarray:
    if not candidate.effect.sizes:
        return presence_column(linear, candidate, term.point)
    return effect_columns(linear, candidate, term.point)


def _turned(candidate: Candidate) -> tuple[Candidate, float]:
    """Return the candidate as seen by a robot turned by 180 deg: it stands on exchanged, turned plates."""
    if candidate.effect.name in OF_THE_ROOM:
        return candidate, -1.0
    return _opposite(_on_other_plate(candidate)), 1.0


def _on_other_plate(candidate: Candidate) -> Candidate:
    if candidate.effect.targets is not CELL_NAMES:
        return candidate
    plate, corner = candidate.target.split(".")
    return replace(candidate, target=f"{PLATES[1 - PLATES.index(plate)]}.{corner}")


def _opposite(candidate: Candidate) -> Candidate:
    if candidate.effect.targets is not CELL_NAMES:
        return candidate
    plate, corner = candidate.target.split(".")
    turned = f"{plate}.{CORNERS[(CORNERS.index(corner) + 2) % len(CORNERS)]}"
    return replace(candidate, target=turned if turned in CELLS else candidate.target)
