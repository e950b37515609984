"""Count how often discovery is right in laboratories that it does not expect (docs/studies/hidden-effects.md).

Every case is a laboratory of its own, in which everything is a little wrong and something may be hidden:
`nothing`, `one` clear effect, `two` of them, or a fault `outside` of the catalogue that moves the base
parameters. It takes hours. After Ctrl-C the study reports on the cases so far; the same command carries out
the others. `--case NUMBER` carries out one case again and keeps its measurements.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import beta

from studies.hidden_effects.hiding import NOTHING, ONE, OUTSIDE, TWO, Case, hidden_kinds
from studies.hidden_effects.judging import SURE, Outcome, carry_out, drawn
from studies.hidden_effects.laboratories import ON_PLATES
from studies.hidden_effects.outside_faults import AT_WII, FAULTS
from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements import PosturePlan, write_measurements
from tulip_testbed.sim.robot import Robot, load_robot

FULL = {NOTHING: 60, ONE: 60, TWO: 60, OUTSIDE: 60}
DYNAMIC = {NOTHING: 10, ONE: 20}  # cases in the full dynamics
DYNAMICS = "dynamics"
DOCUMENT = TypeAdapter(Outcome)


@dataclass(frozen=True)
class HiddenEffects(Settings):
    """How the study is run."""

    case: int = -1
    """number of a single case"""


SETTINGS = HiddenEffects(seed=0, only=(*FULL, DYNAMICS))


def study(settings: HiddenEffects) -> Iterator[str]:
    """Yield the tables of all cases that were carried out."""
    robot = load_robot()
    plan, folder, every = shipped_plan(robot), settings.folder("hidden-effects"), cases(settings)
    if settings.case >= 0:
        yield from _again(settings, every, robot, plan, folder)
        return
    chosen = [k for k, case in enumerate(every) if part_of(case) in settings.only]
    try:
        calls = {folder / f"{k:05}.json": (every[k], k, settings.seed, robot, plan) for k in chosen}
        settings.kept("cases", carry_out, calls)
    except KeyboardInterrupt:
        yield "Stopped.\n"
    done = [DOCUMENT.validate_json(path.read_bytes()) for path in sorted(folder.glob("*.json"))]
    outcomes = [one for one in done if part_of(one.case) in settings.only]
    yield f"{len(outcomes)} of {len(chosen)} cases."
    for where, dynamics in (("Static laboratories", False), ("Full dynamics", True)):
        yield from tables(where, [one for one in outcomes if one.case.dynamics == dynamics])
    yield from misses(outcomes)


def _again(
    settings: HiddenEffects, every: Sequence[Case], robot: Robot, plan: PosturePlan, folder: Path
) -> Iterator[str]:
    if settings.case >= len(every):
        raise InputError(f"--case: found {settings.case}, expected a number below {len(every)}")
    there, given = folder / f"measurements-{settings.case:05}", (settings.case, settings.seed, robot, plan)
    case, built, truth, measured, _ = drawn(every[settings.case], *given)
    if not there.exists():
        write_measurements(there, measured)
    yield f"{case}\n\nmeasurements: {there}\n\n{truth}\n\n{written(built.effects)}\n"
    yield str(carry_out(every[settings.case], *given))


def part_of(case: Case) -> str:
    """Return the part of the study to which a case belongs."""
    return DYNAMICS if case.dynamics else case.arm


def cases(settings: HiddenEffects) -> list[Case]:
    """Return all cases, in an order in which every arm is spread evenly."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    out = []
    for dynamics, counts in ((False, FULL), (True, DYNAMIC)):
        for arm, count in counts.items():
            if arm == OUTSIDE:  # with coarse sensors few faults move the base parameters
                names = _in_turn([fault.name for fault in FAULTS], settings.count(0.75 * count), rng)
                out += [Case(arm, ON_PLATES[1], (name,), dynamics) for name in names]
                names = _in_turn(list(AT_WII), settings.count(0.25 * count), rng)
                out += [Case(arm, ON_PLATES[0], (name,), dynamics) for name in names]
                continue
            for k, name in enumerate(_in_turn(hidden_kinds(), settings.count(count), rng)):
                second = (name if k // 2 % 2 else str(rng.choice(hidden_kinds())),) if arm == TWO else ()
                kinds = () if arm == NOTHING else (name, *second)
                out.append(Case(arm, ON_PLATES[k % 2], kinds, dynamics))
    return [out[k] for k in rng.permutation(len(out))]


def _in_turn(names: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Names, each as often as the others, in random order within a turn."""
    turns = [rng.permutation(len(names)) for _ in range(-(-count // len(names)))]
    return [names[k] for turn in turns for k in turn][:count]


class Figure(NamedTuple):
    """A share of cases or of intervals, or the size of errors, with what it must be.

    Attributes:
        by_laboratory: 0 or 1 for each case or interval, or squares of errors, laboratory by laboratory.
        mean_square: whether the figure is the root of their mean.
    """

    name: str
    by_laboratory: Sequence[Sequence[float]]
    least: float = 0.0
    most: float = 1.0
    mean_square: bool = False

    @property
    def line(self) -> str:
        """Return its line of the table, with the interval that laboratories give."""
        sums = np.array([[sum(one), len(one)] for one in self.by_laboratory if len(one)], float)
        total, count = sums.sum(axis=0)
        mean, groups = total / count, len(sums)
        spread = sums[:, 0] - mean * sums[:, 1]
        variance = float(spread @ spread) / count**2
        if self.mean_square:
            ends = np.sqrt(np.maximum(mean + 1.96 * np.sqrt(variance) * np.array([-1.0, 1.0]), 0.0))
            mean = np.sqrt(mean)
        else:
            ends = _korn_graubard(mean, variance, count, groups)
        met = "met" if self.least <= mean <= self.most else "**missed**"
        value = f"{mean:.3f} ({ends[0]:.3f} to {ends[1]:.3f})"
        return row(self.name, value, f"{count:.0f}", groups, f"{self.least:g} to {self.most:g}", met)


def _korn_graubard(share: float, variance: float, count: float, groups: int) -> tuple[float, float]:
    """Return the exact interval for as many independent cases as the clusters say (Korn and Graubard 1998)."""
    size = share * (1 - share) / variance if variance > 0 else groups
    size = min(size, count)
    hits = share * size
    low = beta.ppf(0.025, hits, size - hits + 1) if hits > 0 else 0.0
    return float(low), float(beta.ppf(0.975, hits + 1, size - hits) if hits < size else 1.0)


def figures(outcomes: Sequence[Outcome]) -> list[Figure]:
    """Return all figures that have a case."""
    done = [one for one in outcomes if not one.failed]
    sure = [one for one in done if one.verdict in SURE]
    arm = {name: [one for one in done if one.case.arm == name] for name in FULL}

    wii, force_plate = ([o for o in arm[ONE] if o.case.preset == name] for name in ON_PLATES)
    first, both = (lambda o: o.first), (lambda o: o.both)
    shares = (
        ("nothing hidden: named or described", arm[NOTHING], lambda o: o.verdict in SURE[2:], 0, 0.02),
        ("nothing hidden: `unknown`", arm[NOTHING], lambda o: o.verdict == "unknown", 0, 0.05),
        ("one clear effect, `wii`: first", wii, first, 0.8, 1),
        ("one clear effect, `force-plate`: first", force_plate, first, 0.9, 1),
        ("two of one kind: both named", [o for o in arm[TWO] if o.alike], both, 0.6, 1),
        ("two of different kinds: both named", [o for o in arm[TWO] if not o.alike], both, 0.75, 1),
        ("outside: neither `none` nor `calibrated`", arm[OUTSIDE], _doubted, 0.95, 1),
        ("wrong and confident, all arms", done, lambda o: o.wrong, 0, 0.02),
        ("cases without data", outcomes, lambda o: o.failed, 0, 1),
    )
    intervals = {
        "base parameters": [one.held for one in sure],
        "named sizes": [sum(one.sizes.values(), ()) for one in sure],
    } | {
        f"`{name}`": [one.members.get(name, ()) for one in sure]
        for name in sorted({name for one in sure for name in one.members})
    }
    made = [
        *(
            Figure(name, [[float(bool(hit(o)))] for o in some], least, most)
            for name, some, hit, least, most in shares
        ),
        *(Figure(f"{name}: intervals hold", held, 0.92, 0.98) for name, held in intervals.items()),
        Figure(
            "base parameters: r.m.s. error [s.e.]", [[e**2 for e in o.base] for o in sure], 0.9, 1.15, True
        ),
    ]
    return [figure for figure in made if any(map(len, figure.by_laboratory))]


def _doubted(one: Outcome) -> bool:
    return one.verdict not in ("none", "calibrated")


def tables(where: str, outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield all figures of one engine."""
    if not outcomes:
        return
    yield f"\n**{where}**\n\n" + header(
        "figure", "value (95 % interval)", "of", "laboratories", "must be", "result"
    )
    for one in figures(outcomes):
        yield one.line
    seconds = [one.seconds for one in outcomes if one.seconds] or [0.0]
    yield f"\nSeconds of CPU a discovery: median {np.median(seconds):.1f}, most {max(seconds):.1f}."


def missed(one: Outcome) -> bool:
    """Return whether a case came out otherwise than it should."""
    right = {NOTHING: not _doubted(one), ONE: one.first, TWO: one.both, OUTSIDE: _doubted(one)}
    return bool(one.failed) or one.wrong or not right[one.case.arm]


def misses(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield every case that came out otherwise than it should; `--case` carries it out again."""
    yield "\n" + header(
        "missed case", "sensors", "hidden", "shows, biases [s.e.]", "verdict", "said", "wrong"
    )
    for one in filter(missed, outcomes):
        truth, said = one.truth, {found.label: found.values for found in one.found}
        hidden = written(truth.hidden) or truth.outside or " + ".join(one.case.kinds) or "nothing"
        shows = f"{', '.join(f'{s:.0f}' for s in truth.shows)}; {truth.bias:.1f}"
        wrong = "yes" if one.wrong else ""
        yield row(one.run, one.case.preset, hidden, shows, one.failed or one.verdict, written(said), wrong)


def written(effects: Mapping[str, Sequence[float]]) -> str:
    return " + ".join(f"{name}={', '.join(f'{v:.3g}' for v in values)}" for name, values in effects.items())
