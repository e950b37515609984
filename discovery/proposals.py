"""The experiment that would separate explanations that are alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from tulip_testbed.discovery.candidates import Candidate, columns, whole_change
from tulip_testbed.discovery.fit import Term
from tulip_testbed.discovery.linear_model import Linear
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.sim.robot import CELLS, CORNERS, PLATES

WORTH = 0.5  # ln of the Bayes factor, from which an experiment is worth proposing
# Effects of the room, not of the robot or the plates: observed from a robot that is turned, they turn.
OF_THE_ROOM = ("tilt", "tether")


@dataclass(frozen=True)
class Proposal:
    """What to do, and how well it would tell the explanations apart.

    Attributes:
        separation: ln of the Bayes factor that is to be expected between the two that are hardest to
            tell apart, were the foremost one true.
        gain: over that of the experiment as it is.
    """

    words: str
    separation: float
    gain: float


def proposals(linear: Linear, rivals: Sequence[Term]) -> list[Proposal]:
    """Experiments that separate explanations, the best first.

    Half of the placements are taken to be measured in another way; the postures stay.
    """
    now = _separation(linear, rivals, lambda candidate: (candidate, 1.0))
    ways: list[tuple[str, Callable[[Candidate], tuple[Candidate, float]]]] = [
        ("Turn the robot by 180 deg on the plates for half of the placements.", _turned),
        ("Exchange the two plates for half of the placements.", lambda c: (_on_other_plate(c), 1.0)),
        (
            "Turn each plate by 180 deg about its middle for half of the placements.",
            lambda c: (_opposite(c), 1.0),
        ),
    ]
    found = [(words, _separation(linear, rivals, way)) for words, way in ways]
    found.append(("Measure twice as many placements.", 2 * now))
    out = [
        Proposal(words, size, size / max(now, 1e-9)) for words, size in found if size > max(1.05 * now, WORTH)
    ]
    return sorted(out, key=lambda p: -p.separation)


def _separation(
    linear: Linear, rivals: Sequence[Term], way: Callable[[Candidate], tuple[Candidate, float]]
) -> float:
    """Least expected ln Bayes factor between two explanations."""
    numbers = np.unique(linear.observed.measurements.placement)
    other = np.isin(linear.observed.measurements.placement, numbers[1::2])
    rows = np.repeat(other, 11)[linear.white.rows]
    columns_of = []
    for term in rivals:
        candidate, sign = way(term.candidate)
        own = _columns(linear, term.candidate, term)
        own[rows] = sign * _columns(linear, candidate, term)[rows]
        columns_of.append(linear.project(own))
    least = np.inf
    for i, j in permutations(range(len(rivals)), 2):
        size = rivals[i].sizes if rivals[i].sizes.size else np.ones(1)
        signal = columns_of[i] @ size
        basis = np.linalg.qr(columns_of[j])[0]
        least = min(least, 0.5 * float(((signal - basis @ (basis.T @ signal)) ** 2).sum()))
    return float(least)


def _columns(linear: Linear, candidate: Candidate, term: Term) -> np.ndarray:
    if not candidate.effect.sizes:
        return whole_change(linear, candidate, term.point)
    return columns(linear, candidate, term.point)


def _turned(candidate: Candidate) -> tuple[Candidate, float]:
    """Seen from a robot turned by 180 deg: its right foot stands on the left plate, which is turned too."""
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
