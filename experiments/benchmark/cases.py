"""Which cases the benchmark holds: arms, kinds, sizes. The details are drawn case by case."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tulip_testbed.effects.catalogue import effects_on
from tulip_testbed.experiments.benchmark.draw import absorbed, testable
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.scoreboard import Board

EXACT, ORDINARY = WORLDS = ("exact", "ordinary")
MULTIPLES = (0.5, 1.0, 2.0, 3.0, 4.0)  # of the minimum detectable size
CLEAR = (2.0, 3.0, 4.0)
OUTSIDE_MULTIPLES = (4.0, 8.0, 16.0)
NULL, ROBOTS, SINGLE, SEVERAL = "null", "other robots", "single", "several"
LEFT_OUT, OUTSIDE_ARM, ABSORBED = "left out", "outside", "absorbed"
# Numbers of cases at size 1; of single effects by kind and multiple.
FULL = {
    NULL: 500,
    ROBOTS: 60,
    SINGLE: 5,
    "pairs": 60,
    "triples": 30,
    LEFT_OUT: 75,
    OUTSIDE_ARM: 60,
    ABSORBED: 30,
    "dynamics": 100,
}
ONLY_DYNAMICS = ("lifted-corner", "unsettled")


@dataclass(frozen=True)
class Settings:
    """All settings except the plan that the results depend on.

    Attributes:
        size: of every arm, 1 the full one.
        world: "exact": the nominal robot and instruments that are exact but for what is hidden; "ordinary":
            random robots and ordinary imperfections.
    """

    preset: str
    seed: int
    size: float
    world: str = EXACT

    def count(self, full: int) -> int:
        """Return how many cases to make where the full benchmark has `full`."""
        return max(1, round(self.size * full))

    def document(self) -> dict[str, Any]:
        """For run.json."""
        return asdict(self)


@dataclass(frozen=True)
class Case:
    """One data set to be made.

    Attributes:
        kinds: of the hidden effects. multiple: of their minimum detectable size.
        dynamics: whether it is held in the full dynamics.
        imperfect: whether ordinary imperfections of all families are added.
    """

    arm: str
    kinds: tuple[str, ...] = ()
    multiple: float = 0.0
    dynamics: bool = False
    imperfect: bool = False


def cases(settings: Settings, board: Board) -> list[Case]:
    """All cases, in an order in which every arm is spread evenly."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(0,)))
    statics = [effect.name for effect in effects_on(None, statics=True)]
    visible = {m: [name for name in statics if testable(board, name, m)] for m in MULTIPLES}
    hidden = [name for name in statics if absorbed(board, name)]
    out = [Case(NULL)] * settings.count(FULL[NULL]) + [Case(ROBOTS)] * settings.count(FULL[ROBOTS])
    out += [
        Case(SINGLE, (name,), multiple)
        for multiple in MULTIPLES
        for name in visible[multiple]
        for _ in range(settings.count(FULL[SINGLE]))
    ]
    for arm, together in (("pairs", 2), ("triples", 3)):
        for multiple in _clear(settings.count(FULL[arm]), rng):
            chosen = rng.choice(visible[multiple], together, replace=False).tolist()
            out.append(Case(SEVERAL, tuple(chosen), multiple))
    out += _one_each(LEFT_OUT, visible, settings.count(FULL[LEFT_OUT]), rng)
    out += [
        Case(OUTSIDE_ARM, (name,), float(rng.choice(OUTSIDE_MULTIPLES)))
        for name in in_turn([o.name for o in OUTSIDE], settings.count(FULL[OUTSIDE_ARM]), rng)
    ]
    out += [Case(ABSORBED, (name,)) for name in in_turn(hidden, settings.count(FULL[ABSORBED]), rng)]
    out += _dynamic(settings, visible, board, rng)
    return [out[k] for k in rng.permutation(len(out))]


def _dynamic(
    settings: Settings, visible: dict[float, list[str]], board: Board, rng: np.random.Generator
) -> list[Case]:
    """Two fifths nulls, a fifth of what only the dynamics knows, two fifths of the rest."""
    fifth = max(1, settings.count(FULL["dynamics"]) // 5)
    out = [Case(NULL, dynamics=True)] * (2 * fifth)
    for name in in_turn(list(ONLY_DYNAMICS), fifth, rng):
        (multiple,) = _clear(1, rng)
        observed = bool(testable(board, name, multiple))
        out.append(Case(SINGLE, (name,), multiple, True) if observed else Case(ABSORBED, (name,), 0.0, True))
    return out + _one_each(SINGLE, visible, max(1, settings.count(FULL["dynamics"]) - len(out)), rng, True)


def _one_each(
    arm: str, visible: dict[float, list[str]], count: int, rng: np.random.Generator, dynamics: bool = False
) -> list[Case]:
    """All kinds in turn, each clearly visible."""
    names = in_turn(visible[CLEAR[0]], count, rng)
    out = []
    for name, multiple in zip(names, _clear(count, rng), strict=True):
        at = multiple if name in visible[multiple] else CLEAR[0]
        out.append(Case(arm, (name,), at, dynamics))
    return out


def _clear(count: int, rng: np.random.Generator) -> list[float]:
    return rng.choice(CLEAR, count).tolist()


def in_turn(names: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Names, each as often as the others, in random order within a turn."""
    turns = [rng.permutation(len(names)) for _ in range(-(-count // len(names)))] if names else []
    return [names[k] for turn in turns for k in turn][: count if names else 0]
