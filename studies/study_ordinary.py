"""Discovery where everything is a little wrong, and in some laboratories one thing badly (hours).

Every robot is random (masses and centres of mass spread by 0.05 to 0.2) and every laboratory has members of
all families with spreads of 0.1 to 1 tolerance. The nulls with scattered placements are the exception: exact,
with plates that scatter 0.5 to 3 times as the data sheet says. A fault is an effect of the catalogue with
sizes from its prior, or a fault that the catalogue lacks.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from studies.runner import Settings, header, row, shipped_plan
from studies.study_self_calibration import ROBOTS
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.discovery.discover import Discovery, discover
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.random_effects import draw_of_kind
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.score import rate
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import PosturePlan
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.threads import one_blas_thread

ORDINARY, FAULT, OUTSIDE_FAULT, SCATTER, DYNAMICS = "ordinary", "fault", "outside", "scatter", "dynamics"
COUNTS = {ORDINARY: 60, FAULT: 120, OUTSIDE_FAULT: 60, SCATTER: 40, DYNAMICS: 40}
SETTINGS = Settings(seed=1, only=tuple(COUNTS))
SCATTERED = (0.5, 3.0)  # times the data sheet's placement_sd
AMPLITUDES = (1.0, 4.0)  # of faults that the catalogue lacks, times the typical one
MOST_TRIES = 20


@dataclass(frozen=True)
class Case:
    """What one discovery said, and the truth.

    Attributes:
        hidden: the fault, or "". found: labels of the effects that stand out, the best first.
        alike: labels of all explanations of them.
        calibrated: labels of the ordinary imperfections, that with the most standard errors first, and
            whether its sign is right.
        beyond: size of the fault over three tolerances of its family; infinite if it belongs to none.
        covered: whether each 95 % interval of an ordinary imperfection holds the truth. sizes: of the fault.
    """

    preset: str
    hidden: str
    verdict: str
    found: tuple[str, ...]
    alike: tuple[str, ...]
    calibrated: tuple[tuple[str, bool], ...]
    beyond: float
    covered: tuple[bool, ...]
    sizes: tuple[bool, ...]
    seconds: float


def study(settings: Settings) -> Iterator[str]:
    """Yield one table an arm."""
    presets = ("wii", "force-plate")
    for arm in settings.only:
        numbers = range(settings.seed, settings.seed + settings.count(COUNTS[arm]))
        calls = [(arm, presets[number % 2], number) for number in numbers]
        cases = [case for case in settings.parallel(arm, one_case, calls) if case is not None]
        yield f"\n**{arm}**, {len(cases)} laboratories\n"
        yield from table(arm, cases)


def table(arm: str, cases: list[Case]) -> Iterator[str]:
    """Yield the figures with exact intervals, and the cases that count against the discovery."""
    verdicts = [case.verdict for case in cases]
    yield ", ".join(f"{name} {verdicts.count(name)}" for name in sorted(set(verdicts))) + "\n"
    yield header("figure", "value", "95 % interval", "of")
    beyond = [case for case in cases if case.beyond > 1 and case.verdict != "none"]
    figures = [
        rate("another cause is named", (_wrong(case) for case in cases)),
        rate("a gap is seen", (case.verdict != "none" for case in cases)),
        rate("right first, of the faults that show", map(_right, filter(_shows, cases))),
        rate("named or in the set, of those beyond their family", map(_said, beyond)),
        rate("unknown", (case.verdict == "unknown" for case in cases)),
        rate("intervals of ordinary imperfections hold", (c for case in cases for c in case.covered)),
        rate("intervals of the fault hold", (c for case in cases for c in case.sizes)),
    ]
    for one in figures:
        if one.count:
            yield row(one.name, f"{one.value:.3f}", f"{one.low:.3f} to {one.high:.3f}", one.count)
    seconds = [case.seconds for case in cases]
    yield row(
        "seconds of CPU, median and most", f"{np.median(seconds):.1f}", f"{max(seconds):.1f}", len(cases)
    )
    yield ""
    for case in cases:
        if _wrong(case) or (case.hidden and not _right(case)):
            best = ", ".join(label for label, _ in case.calibrated[:1]) or "none"
            said = f"{case.verdict} {', '.join(case.found)}".strip()
            fault = case.hidden or "no fault"
            yield f"- {case.preset}: {fault}: {said} (clearest imperfection: {best})"


def _wrong(case: Case) -> bool:
    """Whether another cause is named."""
    return case.verdict == "named" and set(case.found) != {_label(case.hidden)}


def _said(case: Case) -> bool:
    return case.verdict in ("named", "ambiguous") and _label(case.hidden) in case.alike


def _shows(case: Case) -> bool:
    """Whether anything shows the fault: it is said, or something else is that was not there."""
    return bool(case.hidden) and (case.verdict in ("named", "ambiguous", "unknown") or _right(case))


def _right(case: Case) -> bool:
    """Whether the fault is the first effect, or the clearest ordinary imperfection with the right sign."""
    if case.verdict in ("named", "ambiguous"):
        return case.found[:1] == (_label(case.hidden),)
    return case.verdict == "calibrated" and case.calibrated[:1] == ((_label(case.hidden), True),)


def _label(text: str) -> str:
    return text.split("=")[0]


@one_blas_thread
def one_case(arm: str, preset: str, seed: int) -> Case | None:
    """Draw a laboratory, simulate it, discover, compare; None: no laboratory could be built."""
    rng = np.random.default_rng((seed, 41, tuple(COUNTS).index(arm)))
    robot = load_robot()
    plan = shipped_plan(robot)
    for _ in range(MOST_TRIES):
        try:
            laboratory, fault = _drawn(arm, preset, robot, plan, rng)
            run = laboratory.run(plan, seed, "dynamics" if arm == DYNAMICS else "statics", workers=1)
        except InputError:  # the robot falls, or the effect cannot be built on this robot
            continue
        sheet = replace(run.measurements.sensors, placement_sd=PRESETS[preset].placement_sd)
        began = time.process_time()
        found = discover(replace(run.measurements, sensors=sheet), robot)
        return _case(found, laboratory, fault, preset, time.process_time() - began)
    return None


def _drawn(
    arm: str, preset: str, robot: Robot, plan: PosturePlan, rng: np.random.Generator
) -> tuple[Laboratory, str]:
    """Draw a laboratory and its fault, as text; "": none."""
    rig = preset_rig(preset, robot)
    sensors = PRESETS[preset]
    if arm == SCATTER:
        factor = float(rng.uniform(*SCATTERED))
        (px, py, pa), (mx, my, ma) = factor * np.array([sensors.placement_sd, sensors.mark_sd])
        wider = replace(sensors, placement_sd=(px, py, pa), mark_sd=(mx, my, ma))
        rig = replace(rig, sensors=wider)
        return Laboratory(robot, preset, nominal=rig), ""
    spread = float(rng.uniform(*ROBOTS))
    rig = edited(rig, edit_of(robot.model, draw_robot(robot.model, spread, rng)))
    members = ordinary_members(rig, rng)
    fault: tuple[EffectInstance, ...] = ()
    text = ""
    if arm in (FAULT, DYNAMICS):
        kinds = [effect for effect in catalogue().values() if effect.statics]
        numbers = tuple(int(n) for n in np.unique(plan.placement))
        fault = (draw_of_kind(kinds[rng.integers(len(kinds))], robot, numbers, rng),)
        text = str(fault[0])
    elif arm == OUTSIDE_FAULT:
        one = OUTSIDE[rng.integers(len(OUTSIDE))]
        sign = 1.0 if one.positive else float(rng.choice([-1.0, 1.0]))
        size = sign * one.amplitude * float(np.exp(rng.uniform(*np.log(AMPLITUDES))))
        rig = one.inject(rig, int(rng.integers(1000)), size)
        text = f"{one.name}={size:.3g}"
    labels = {one.label for one in fault}
    hidden = (*(one for one in members if one.label not in labels), *fault)
    return Laboratory(robot, preset, hidden=hidden, nominal=rig), text


def _case(found: Discovery, laboratory: Laboratory, fault: str, preset: str, seconds: float) -> Case:
    """Hold a discovery against the truth."""
    true = {one.label: one.values for one in laboratory.hidden}
    covered, ordinary = [], []
    for one in found.calibrated:
        values = true.get(one.label, (0.0,) * len(one.values))
        pairs = [(v, i, x) for v, i, x in zip(values, one.intervals, one.values, strict=True) if i]
        covered += [low <= v <= high for v, (low, high), _ in pairs]
        z = [abs(x) / max((high - low) / 3.92, 1e-300) for _, (low, high), x in pairs]
        at = int(np.argmax(z))
        ordinary.append((max(z), one.label, bool(np.sign(pairs[at][0]) == np.sign(pairs[at][2]))))
    sizes = []
    for k in found.effects:
        one = with_intervals(found.fit, k)
        if one.label == _label(fault):
            each = zip(one.effect.parameters, true[one.label], one.intervals, strict=True)
            sizes += [i[0] <= v <= i[1] for parameter, v, i in each if i and not parameter.grid]
    tolerances = usual_tolerances(found.observed, None).value
    name = _label(fault).split(":")[0]
    tolerance = tolerances.get(name, 0.0)
    values = true.get(_label(fault), ())
    beyond = max(np.abs(values)) / (3 * tolerance) if tolerance and values else np.inf
    return Case(
        preset=preset,
        hidden=fault,
        verdict=found.verdict,
        found=tuple(found.fit.terms[k].label for k in found.effects),
        alike=tuple(one.label for k in found.effects for one in found.equivalents[k]),
        calibrated=tuple((label, sign) for _, label, sign in sorted(ordinary, reverse=True)),
        beyond=float(beyond) if fault else 0.0,
        covered=tuple(covered),
        sizes=tuple(sizes),
        seconds=seconds,
    )
