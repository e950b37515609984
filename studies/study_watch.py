"""Count the false alarms of `tulip watch`, and how soon it notices faults (docs/studies/watch.md; an hour).

The parts: `clean` days, `faults` that begin at posture 40 and slow `drifts`, all by statics, and `dynamics`, days
and faults in the full dynamics.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from studies.runner import Settings, header, row, share, shipped_plan
from studies.watched_days import (
    DRIFTS,
    FAULTS,
    Day,
    FaultyDay,
    Kind,
    alarms,
    faulty_day,
    ordinary_day,
    played,
)
from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.watching.day_model import day_model
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot, load_robot

SETTINGS = Settings(seed=12000, workers=1, only=("clean", "faults", "drifts", "dynamics"))
PRESETS = ("wii", "force-plate")
CLEAN = 50
LABORATORIES = 2  # a preset, in the full dynamics
TRIES, ANOTHER = 5, 1000  # laboratories for a fault, and the distance of their seeds


def study(settings: Settings) -> Iterator[str]:
    """Make the tables."""
    robot = load_robot()
    plan = shipped_plan(robot)
    parts = {"clean": _clean, "faults": _faults, "drifts": _drifts, "dynamics": _dynamics}
    for part, make in parts.items():
        if part in settings.only:
            yield from make(settings, robot, plan)


def _clean(settings: Settings, robot: Robot, plan: PosturePlan) -> Iterator[str]:
    count = settings.count(CLEAN)
    seeds = [(settings.seed + k, PRESETS[k % 2], plan) for k in range(count)]
    yield from _clean_table("Clean days, statics", settings.parallel("clean days", clean_day, seeds))


def clean_day(seed: int, preset: str, plan: PosturePlan) -> tuple[str, int, int]:
    """Return preset, rows and false alarms of a clean day."""
    return _watched(ordinary_day(seed, preset, "statics", plan), plan)


def _watched(day: Day, plan: PosturePlan) -> tuple[str, int, int]:
    verdicts = played(day_model(plan, day.laboratory.robot, day.rows), day.rows)
    return day.laboratory.sensors, len(verdicts), len(alarms(verdicts))


def _clean_table(title: str, days: Sequence[tuple[str, int, int]]) -> Iterator[str]:
    yield f"\n**{title}**\n"
    yield header("sensors", "days", "rows", "days with a false alarm (95 %)")
    for preset in (*PRESETS, "all"):
        own = [one for one in days if preset in (one[0], "all")]
        if own:
            wrong = sum(alarms > 0 for *_, alarms in own)
            yield row(preset, len(own), sum(rows for _, rows, _ in own), share(wrong, len(own)))


def _faults(settings: Settings, robot: Robot, plan: PosturePlan) -> Iterator[str]:
    kinds = range(settings.count(len(FAULTS)))
    for which in (0, 1):
        arguments = [
            (settings.seed + 100 + len(FAULTS) * which + k, PRESETS[(k + which) % 2], plan, FAULTS[k])
            for k in kinds
        ]
        found = settings.parallel("faults", fault_of_day, arguments)
        name = ("first sensors", "the other sensors")[which]
        yield from _fault_table(f"Faults from posture 40 on, statics, {name}", found)


def _drifts(settings: Settings, robot: Robot, plan: PosturePlan) -> Iterator[str]:
    count = settings.count(2 * len(DRIFTS))
    arguments = [
        (settings.seed + 150 + k, PRESETS[k % 2], plan, DRIFTS[k // 2 % len(DRIFTS)]) for k in range(count)
    ]
    found = settings.parallel("drifts", fault_of_day, arguments)
    yield from _fault_table("Slow drifts from posture 40 on, statics", found)


def fault_of_day(seed: int, preset: str, plan: PosturePlan, kind: Kind) -> FaultyDay:
    """Draw a laboratory and let a fault begin in its day; another one if the robot falls with the fault."""
    for number in range(seed, seed + TRIES * ANOTHER, ANOTHER):
        try:
            return faulty_day(ordinary_day(number, preset, "statics", plan), kind, plan, number)
        except InputError:
            continue
    raise InputError(f"{kind.label}: found no laboratory in which the robot stands with it")


def _fault_table(title: str, found: Sequence[FaultyDay]) -> Iterator[str]:
    yield f"\n**{title}**\n"
    yield header("fault", "sensors", "MDE", "later by", "named")
    for one in found:
        label = one.kind.label + (" (grows)" if one.kind.ramp else "")
        multiple = f"{one.multiple:.1f}" if np.isfinite(one.multiple) else "cable off"
        late = one.late if one.noticed >= 0 and one.detectable >= 0 else "-"
        yield row(label, one.preset, multiple, late, one.told or "-")
    yield f"\nNoticed within three postures: {share(sum(one.hit for one in found), len(found))}."


def _dynamics(settings: Settings, robot: Robot, plan: PosturePlan) -> Iterator[str]:
    """Clean days in the full dynamics, and a share of the faults in each of them."""
    labs = [
        (settings.seed + 200 + k, PRESETS[k % 2], "dynamics", plan)
        for k in range(settings.count(LABORATORIES * len(PRESETS)))
    ]
    days = settings.parallel("dynamics", ordinary_day, labs)
    yield from _clean_table("Clean days, full dynamics", [_watched(day, plan) for day in days])
    kinds = range(settings.count(len(FAULTS)))
    arguments = [(days[k % len(days)], FAULTS[k], plan, settings.seed + 300 + k) for k in kinds]
    found = settings.parallel("faults in dynamics", faulty_day, arguments)
    yield from _fault_table("Faults from posture 40 on, full dynamics", found)
