"""Count how often discovery finds what is hidden (docs/studies/discovery-benchmark.md; hours, resumable).

Every case is a laboratory of its own in which something is hidden: nothing, an effect as large as its `prior`
says, a `single` effect or `two` that can be seen, one that is `left out` of the catalogue, a fault `outside` of
it, or plates that `scatter` unlike their data sheet. `--imperfections` scales the robots' spread and the
ordinary imperfections; 0 is the perfect laboratory with the nominal robot. After Ctrl-C the study reports on
the cases so far, a fair sample because their order is random; the same command carries out the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter

from studies.hidden_effects.hiding import (
    CLEAR,
    LEFT_OUT,
    NOTHING,
    OUTSIDE,
    PRIOR,
    SCATTER,
    SINGLE,
    TWO,
    Case,
    World,
)
from studies.hidden_effects.judging import Outcome, carry_out
from studies.hidden_effects.outside_faults import FAULTS
from studies.runner import Settings, header, row, share, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import write_text
from tulip_testbed.effects.catalogue import effects_on
from tulip_testbed.sim.robot import load_robot

ARMS = {
    NOTHING: "nothing",
    SCATTER: "nothing, plates scatter unlike their data sheet",
    PRIOR: "one effect, its size from the prior",
    SINGLE: "one effect, by its detectable size",
    TWO: "two effects",
    LEFT_OUT: "an effect that the catalogue lacks",
    OUTSIDE: "a fault outside the catalogue",
}
FULL = {NOTHING: 200, SCATTER: 40, PRIOR: 120, SINGLE: 200, TWO: 60, LEFT_OUT: 60, OUTSIDE: 60}
DYNAMIC = {NOTHING: 20, PRIOR: 80}  # cases in the full dynamics
MULTIPLES = (0.5, 1.0, 2.0, 3.0, 4.0)  # of the minimum detectable size (MDE)
VERDICTS = ("none", "calibrated", "named", "described", "ambiguous", "unknown")
SURE = VERDICTS[:4]  # the model is complete
DOCUMENT = TypeAdapter(Outcome)


@dataclass(frozen=True)
class HiddenEffects(Settings):
    """How the study is run."""

    preset: str = "force-plate"
    """sensors"""
    imperfections: float = 1.0
    """scale of the ordinary imperfections and of the robots' spread; 0: perfect"""


SETTINGS = HiddenEffects(seed=0, only=tuple(ARMS))


def study(settings: HiddenEffects) -> Iterator[str]:
    """Yield the tables of all cases that were carried out."""
    if not 0 <= settings.imperfections < np.inf:
        raise InputError(f"--imperfections: found {settings.imperfections:g}, expected a number from 0 on")
    folder = settings.folder("hidden-effects") / f"{settings.preset}-{settings.imperfections:g}"
    folder.mkdir(exist_ok=True)
    robot = load_robot()
    world = World(robot, shipped_plan(robot), settings.preset, settings.imperfections)
    every = cases(settings)
    chosen = [k for k, case in enumerate(every) if case.arm in settings.only]
    try:
        settings.parallel("cases", kept, ((folder, every[k], k, settings.seed, world) for k in chosen))
    except KeyboardInterrupt:
        yield "Stopped.\n"
    done = [DOCUMENT.validate_json(path.read_bytes()) for path in sorted(folder.glob("*.json"))]
    outcomes = [one for one in done if one.case.arm in settings.only]
    yield f"{len(outcomes)} cases, {settings.preset}, imperfections {settings.imperfections:g}"
    for where, dynamics in (("static laboratory", False), ("full dynamics", True)):
        yield from tables(where, [one for one in outcomes if one.case.dynamics == dynamics])
    yield from miss_lines(outcomes)


def kept(folder: Path, case: Case, run: int, seed: int, world: World) -> None:
    """Carry out a case whose file is not there yet."""
    path = folder / f"{run:05}.json"
    if not path.exists():
        write_text(path, DOCUMENT.dump_json(carry_out(case, run, seed, world)).decode())


def cases(settings: HiddenEffects) -> list[Case]:
    """Return all cases, in an order in which every arm is spread evenly."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    kinds = [effect.name for effect in effects_on(None, statics=True) if effect.searched]
    out = [Case(arm) for arm in (NOTHING, SCATTER) for _ in range(settings.count(FULL[arm]))]
    out += [Case(PRIOR, (kind,)) for kind in _in_turn(kinds, settings.count(FULL[PRIOR]), rng)]
    for arm, multiples in ((SINGLE, MULTIPLES), (LEFT_OUT, CLEAR)):
        names = _in_turn(kinds, settings.count(FULL[arm]), rng)
        out += [Case(arm, (kind,), float(rng.choice(multiples))) for kind in names]
    for k, kind in enumerate(_in_turn(kinds, settings.count(FULL[TWO]), rng)):
        other = kind if k % 2 else str(rng.choice(kinds))
        out.append(Case(TWO, (kind, other), float(rng.choice(CLEAR))))
    names = _in_turn([fault.name for fault in FAULTS], settings.count(FULL[OUTSIDE]), rng)
    out += [Case(OUTSIDE, (name,)) for name in names]
    out += [Case(NOTHING, dynamics=True)] * settings.count(DYNAMIC[NOTHING])
    names = _in_turn(kinds, settings.count(DYNAMIC[PRIOR]), rng)
    out += [Case(PRIOR, (kind,), dynamics=True) for kind in names]
    return [out[k] for k in rng.permutation(len(out))]


def _in_turn(names: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Names, each as often as the others, in random order within a turn."""
    turns = [rng.permutation(len(names)) for _ in range(-(-count // len(names)))]
    return [names[k] for turn in turns for k in turn][:count]


class Figure(NamedTuple):
    """A share of the cases, or of the intervals, with what it must be."""

    name: str
    hits: list[bool]
    least: float = 0.0
    most: float = 1.0

    @property
    def line(self) -> str:
        """Return its line of the table."""
        low = f"at least {self.least:g}" if self.least > 0 else ""
        demand = ", ".join(filter(None, (low, f"at most {self.most:g}" if self.most < 1 else "")))
        met = "met" if self.least <= float(np.mean(self.hits)) <= self.most else "**missed**"
        return row(self.name, share(sum(self.hits), len(self.hits)), demand, met if demand else "")


def figures(outcomes: Sequence[Outcome]) -> list[Figure]:
    """Return all figures that have a case."""
    done = [one for one in outcomes if not one.failed]

    def of(arm: str) -> list[Outcome]:
        return [one for one in done if one.case.arm == arm]

    clear = [one for one in of(SINGLE) if one.case.multiple in CLEAR]
    shown = [one for one in of(PRIOR) if one.shows]
    of_base = [c for o in done if o.verdict in SURE for c in o.base]
    made = [
        Figure("nothing hidden: wrongly named", [o.wrong for o in of(NOTHING)], most=0.03),
        Figure("scattering plates: a gap is seen", [o.flagged for o in of(SCATTER)], most=0.02),
        Figure(
            "at 1 MDE: a gap is seen", [o.flagged for o in of(SINGLE) if o.case.multiple == 1], 0.85, 0.95
        ),
        Figure("from 2 MDE on, isolable: right first", [o.right_first for o in clear if o.isolable], 0.95),
        Figure("from 2 MDE on: right first", [o.right_first for o in clear]),
        Figure("from 2 MDE on: in the set", [o.in_set for o in clear], 0.95),
        Figure("size from the prior: right first, of those that show", [o.right_first for o in shown], 0.9),
        Figure("two effects: both found, nothing else", [o.exact for o in of(TWO)]),
        Figure("left out: `unknown`, a law or a twin", [o.open for o in of(LEFT_OUT)], 0.9),
        Figure("outside: `unknown` or a law", [o.open for o in of(OUTSIDE)], 0.9),
        Figure("outside: the right law first", [o.law_right for o in of(OUTSIDE)]),
        Figure("wrong and confident, all cases", [o.wrong for o in done], most=0.03),
        Figure("95 % intervals of the effects' sizes hold", [c for o in done for c in o.sizes], 0.9, 0.98),
        Figure("95 % intervals of imperfections hold", [c for o in done for c in o.members], 0.92, 0.98),
        Figure("95 % intervals of base parameters hold", of_base, 0.93, 0.98),
        Figure("cases without data", [bool(o.failed) for o in outcomes]),
    ]
    return [figure for figure in made if figure.hits]


def tables(where: str, outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield all figures of one engine, and what was said by arm."""
    if not outcomes:
        return
    yield f"\n**Figures, {where}**\n\n" + header("figure", "share (95 % interval)", "must be", "result")
    for one in figures(outcomes):
        yield one.line
    seconds = [one.seconds for one in outcomes if one.seconds] or [0.0]
    yield f"\nSeconds of CPU a discovery: median {np.median(seconds):.1f}, most {max(seconds):.1f}."
    yield f"\n**Verdicts, {where}**\n\n" + header("hidden", "cases", *VERDICTS, "wrong name")
    for arm, sentence in ARMS.items():
        some = [one for one in outcomes if one.case.arm == arm and not one.failed]
        counts = (sum(one.verdict == name for one in some) for name in VERDICTS)
        if some:
            yield row(sentence, len(some), *counts, sum(one.wrong for one in some))


def miss_lines(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield every case with a wrong name."""
    wrong = [one for one in outcomes if one.wrong]
    if wrong:
        yield "\n**Wrong names**\n"
        yield header("hidden", "values", "verdict", "said")
    for one in wrong:
        values = ", ".join(f"{v:.3g}" for several in one.values for v in several)
        yield row(" + ".join(one.hidden) or "nothing", values, one.verdict, " + ".join(one.names))
