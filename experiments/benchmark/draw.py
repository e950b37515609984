"""Draw the effects hidden in a case: target, sign and direction by chance, size near the detection limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.evidence import DETECTABLE
from tulip_testbed.effects.injection import check_built
from tulip_testbed.effects.instance import EffectInstance, injected
from tulip_testbed.experiments.benchmark.scoreboard import Board
from tulip_testbed.sim.rig import Rig

MOST_PRIORS = 8.0  # s.d.: no larger effect is hidden
TRIES = 1000


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Attributes:
        signal: what it shows, whitened and projected, to first order, (r + 1,).
        multiple: of the minimum detectable size.
    """

    instance: EffectInstance
    signal: np.ndarray
    multiple: float

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return self.instance.label


def _of_kind(board: Board, kind: str) -> list[tuple[Candidate, list[np.ndarray]]]:
    every = zip(board.candidates, board.projected, strict=True)
    return [(c, points) for c, points in every if c.effect.name == kind]


def _strength(candidate: Candidate, columns: np.ndarray) -> float:
    """Longest signal of a size of one prior s.d.; of an effect without a size, its signal's length."""
    scaled = columns * candidate.prior if candidate.effect.sizes else columns
    return float(np.linalg.svd(scaled, compute_uv=False).max(initial=0.0))


def testable(board: Board, kind: str, multiple: float) -> list[tuple[Candidate, list[int]]]:
    """Candidates of a kind, with their grid points, of which this multiple of what is found is plausible."""
    out = []
    for candidate, points in _of_kind(board, kind):
        most = MOST_PRIORS / multiple if candidate.effect.sizes else 1.0
        wanted = board.wanted(candidate)
        clear = [
            k
            for k, columns in enumerate(points)
            if most * _strength(candidate, columns) >= wanted and _distinct(candidate, k)
        ]
        if clear:
            out.append((candidate, clear))
    return out


def absorbed(board: Board, kind: str) -> list[Candidate]:
    """Candidates of a kind that leave no residual with this plan."""
    return [
        candidate
        for candidate, points in _of_kind(board, kind)
        if all(_strength(candidate, columns) <= DETECTABLE for columns in points)
    ]


def _distinct(candidate: Candidate, point: int) -> bool:
    chosen = [
        v for v, p in zip(candidate.settings[point], candidate.effect.parameters, strict=True) if p.choices
    ]
    return len(chosen) == len(set(chosen))


def draw_visible(board: Board, kind: str, multiple: float, rng: np.random.Generator) -> Hidden:
    """Return an effect of a kind at a multiple of its minimum detectable size (unchanged without a size)."""
    possible = testable(board, kind, multiple)
    for _ in range(TRIES):
        candidate, points = possible[rng.integers(len(possible))]
        point = points[rng.integers(len(points))]
        columns = board.projected[board.candidates.index(candidate)][point]
        if not candidate.effect.sizes:
            at = float(np.linalg.norm(columns)) / board.wanted(candidate)
            return _hidden(candidate, np.zeros(0), point, columns[:, 0], at)
        along = candidate.prior * rng.standard_normal(len(candidate.prior))
        along = np.where(candidate.positive, np.abs(along), along)
        length = max(float(np.linalg.norm(columns @ along)), 1e-300)
        sizes = multiple * board.wanted(candidate) * along / length
        hidden = _hidden(candidate, sizes, point, columns @ sizes, multiple)
        if (np.abs(sizes) <= MOST_PRIORS * candidate.prior).all() and _can_be_built(board.rig, hidden):
            return hidden
    raise AssertionError(f"{kind}: no direction that can be found at a plausible size")


def _can_be_built(rig: Rig, hidden: Hidden) -> bool:
    try:
        check_built(injected(rig, [hidden.instance]))
    except InputError:
        return False
    return True


def draw_absorbed(board: Board, kind: str, rng: np.random.Generator) -> Hidden:
    """Return an effect that leaves no residual, its sizes from their priors."""
    possible = absorbed(board, kind)
    candidate = possible[rng.integers(len(possible))]
    point = int(rng.integers(len(candidate.settings)))
    sizes = candidate.prior * rng.standard_normal(len(candidate.prior))
    sizes = np.where(candidate.positive, np.abs(sizes), sizes)
    return _hidden(candidate, sizes, point, np.zeros(len(board.linear.residual)), 0.0)


def _hidden(
    candidate: Candidate, sizes: np.ndarray, point: int, signal: np.ndarray, multiple: float
) -> Hidden:
    found = EffectInstance(candidate.effect, candidate.target, candidate.values(sizes, point))
    return Hidden(found, signal, multiple)
