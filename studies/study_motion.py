"""Measure the intervals of a robot that moves, and standard errors against time (docs/studies/motion.md; hours).

Coverage: random robots stand in ordinary laboratories and move in the full dynamics, one plan a speed. One foot:
the same where they stand on one foot as well. Nothing, hidden: what `discover` says of such records, and of
laboratories with one fault. Sizes: how large faults of a joint must be to be found in holds, and in motion of the
same laboratory time. Time: a laboratory holds postures in statics, others move in the full dynamics.
"""

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
from scipy.stats import t

import tulip_testbed as tt
from studies.hidden_effects.hiding import ONE, Case, Clearness, Truth, clear_effect, hidden_kinds
from studies.hidden_effects.judging import REFUSED, Found, Outcome, said
from studies.hidden_effects.laboratories import Built
from studies.hidden_effects.readings import Values
from studies.runner import Settings, header, row, share, shipped_plan
from studies.study_hidden_effects import written
from studies.teaching.style import DOCS, GREY, X, card, save_svg
from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.self_calibration import as_log_shows, with_independent_rows
from tulip_testbed.discovery.candidate_search import CandidateSearch, calibrated_data, first_calibration
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.detectability import detectable_size, single_level
from tulip_testbed.discovery.discover import discover
from tulip_testbed.discovery.law_candidates import law_candidates
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, split_label
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.identify import Identification
from tulip_testbed.experiments.imperfections import drawn, single_stream
from tulip_testbed.experiments.laboratory import FROM_POSTURE_TO_POSTURE
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.noise_in_time import WHITE
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import Robot, joint_names, load_robot

PLACEMENTS, POSTURES, PLAN_SEED = 6, 20, 5
SPEEDS = {"slow": 0.1, "usual": 0.3, "fast": 0.6}  # rad/s of the fastest joint
ONE_FOOT = "one-foot"
ARMS = {name: (speed,) for name, speed in SPEEDS.items()} | {ONE_FOOT: (SPEEDS["usual"], 0, 0)}
SETTINGS = Settings(seed=500, only=(*SPEEDS, ONE_FOOT, "nothing", "hidden", "sizes", "time"))
RUNS, OF_ONE_FOOT = 20, 200  # of a speed and preset; through the postures of the shipped mixed plan
LABORATORIES, LONGER = 12, (10, 40)  # with nothing hidden; placements and postures of each: 12 minutes
CASES, LEAST_ROWS = 20, 3  # hidden faults; every third posture, as many as the motion has independent rows
FRICTION = "reading by direction"  # of an encoder on the motor, through what yields
OF_JOINTS = {
    "backlash": "deg",
    "joint-compliance": "deg/Nm",
    "encoder-offset": "deg",
    "encoder-gain": "%",
    FRICTION: "deg",
}
TESTS = 100.0  # independent ones among the candidates
CAD = ", inertias of CAD"
PRESETS = ("wii", "force-plate")
PAPER = Path(__file__).resolve().parents[1] / "assets" / "tulip_mjcf" / "table2.csv"
PAPERS_POSTURES, PLACING, HOLD = 108, 10.0, 1.0  # min
MOVED, MOVES = 26, 60.0  # placements, and minutes of motion: with the placing the same day
# First placements of every support; else the first, two, three and four.
PARTS = {"holds": (8, 12, 16, 22), "motion": (4, 8, 15, 22, MOVED)}


@cache
def moving(speed: float, placements: int = PLACEMENTS, postures: int = POSTURES) -> PosturePlan:
    """Return the plan that random robots follow; kept, since planning takes longer than a simulation.

    It goes through random postures, or without placements through those of the shipped mixed plan.
    """
    folder = Path("runs") / "study-motion" / f"plan-{speed:g}-{placements}-{postures}"
    if not folder.exists():
        random = partial(tt.draw_plan, placements=placements, per_placement=postures, seed=PLAN_SEED)
        write_plan(folder, tt.plan_motion(random().plan if placements else "mixed", speed=speed).plan)
    return read_plan(folder, load_robot())


def laboratory(sensors: str, seed: int) -> tt.Laboratory:
    """Return an ordinary laboratory in which a random robot stands."""
    return drawn(tt.Laboratory(sensors=sensors, random_robot=(0.1, seed)), 1.0, single_stream(seed))


def one(arm: str, sensors: str, seed: int) -> dict:
    """Return how far estimates lie off in standard errors, with and without the inertias."""
    plan = moving(*ARMS[arm])
    run = laboratory(sensors, seed).run(plan, seed=seed, engine="dynamics", workers=1)
    truth = true_base_parameters(run.laboratory.rig, common_support(run.measurements.support))
    samples = len(run.samples or ())
    found: dict = {"minutes": samples / 6000, "kept": samples / len(plan.motion or ())}
    for name, tolerances in {"": None, CAD: {"inertia": 0.0}}.items():
        if name and arm != "fast":
            continue
        fit = tt.identify(run, tolerances=tolerances)
        found[name] = off(fit, truth) | {"ratio": over_papers(fit).tolist()}
    return found


def over_papers(fit: Identification) -> np.ndarray:
    """Return the standard errors of the parameters that the paper has, over the paper's, (25,)."""
    with PAPER.open() as file:
        table = list(csv.DictReader(file))
    paper = np.array([abs(float(r["full_mm"])) * float(r["full_rel_se_percent"]) / 100 for r in table])
    own = fit.full.names
    rows = [own.index(name) for name in nominal_robot(load_robot()).parameters.names]
    return 1e3 * np.sqrt(np.diag(fit.full.covariance))[rows] / paper


def off(fit: Identification, truth: np.ndarray) -> dict:
    """Return the errors of estimates in standard errors, whether their intervals cover, and the noise."""
    calibration, full = fit.calibration, fit.full
    assert calibration is not None
    error, noise = full.value - truth, calibration.observed.noise_in_time or WHITE
    z = error / np.sqrt(np.diag(full.covariance))
    lags = [each for each in calibration.families if each.family.name == "contact-lag"]
    return {
        "z": z.tolist(),
        "covered": (np.abs(z) <= t.ppf(0.975, calibration.interval_dof)).tolist(),
        "chi2": float(error @ np.linalg.solve(full.covariance, error)) / len(error),
        "lag": [float(lags[0].value[0]), float(lags[0].standard_error[0])],
        "seconds": noise.seconds if noise.share else 0.0,
    }


def coverage(settings: Settings) -> Iterator[str]:
    """Yield a row an arm."""
    yield header(
        *("sensors", "speed, rad/s", "motion, min", "kept", "runs", "95 % intervals that cover"),
        *("r.m.s. error, s.e.", "chi2/p", "s.e. over the paper's: median (range)", "largest (range)"),
        *("lag, ms (s.e.)", "noise lasts, s"),
    )
    folder, arms = settings.folder("motion"), [*product(PRESETS, SPEEDS), ("wii", ONE_FOOT)]
    for sensors, arm in (each for each in arms if each[1] in settings.only):
        seeds = settings.seed + np.arange(settings.count(OF_ONE_FOOT if arm == ONE_FOOT else RUNS))
        calls = {folder / f"{arm}-{sensors}-{seed}.json": (arm, sensors, seed) for seed in seeds.tolist()}
        moving(*ARMS[arm])  # once, before workers ask for it
        found = settings.kept(f"{sensors}, {arm}", one, calls)
        for name in ("", CAD) if arm == "fast" else ("",):
            fits = [each[name] for each in found]
            covered = np.array([fit["covered"] for fit in fits])
            lags = 1e3 * np.array([fit["lag"] for fit in fits])
            ratios = np.array([fit["ratio"] for fit in fits])
            yield row(
                *(sensors + name, SPEEDS.get(arm, arm), f"{found[0]['minutes']:.1f}"),
                *(f"{np.mean([each['kept'] for each in found]):.2f}", len(fits)),
                share(int(covered.sum()), covered.size),
                f"{np.sqrt(np.mean(np.square([fit['z'] for fit in fits]))):.2f}",
                f"{np.mean([fit['chi2'] for fit in fits]):.2f}",
                *(
                    f"{np.median(each):.3f} ({each.min():.3f} to {each.max():.3f})"
                    for each in (np.median(ratios, axis=1), ratios.max(axis=1))
                ),
                "; ".join(f"{lag:.1f} ({error:.1f})" for lag, error in lags),
                "; ".join(f"{fit['seconds']:.1f}" for fit in fits),
            )


def nothing_hidden(seed: int) -> str:
    """Return what `discover` says of the record of a laboratory with nothing but imperfections."""
    run = laboratory("wii", seed).run(moving(0.3, *LONGER), seed=seed, engine="dynamics", workers=1)
    return tt.discover(run).verdict


def nothing(settings: Settings) -> Iterator[str]:
    """Yield how often every verdict is given where nothing is hidden."""
    seeds = range(settings.seed, settings.seed + settings.count(LABORATORIES))
    calls = {settings.folder("motion") / f"nothing-{seed}.json": (seed,) for seed in seeds}
    moving(SPEEDS["usual"], *LONGER)  # once, before workers ask for it
    yield f"\nNothing hidden: {dict(Counter(settings.kept('nothing hidden', nothing_hidden, calls)))}\n"


def hidden_fault(seed: int, kind: str) -> Outcome:
    """Hide a fault that the record shows clearly, and return what `discover` says of it."""
    inside, rng, plan = laboratory("wii", seed), np.random.default_rng(seed), moving(0.3, *LONGER)
    built = Built("wii", replace(inside, hidden=()).rig, {})
    clearness = Clearness(built, plan.take(np.arange(0, len(plan), LEAST_ROWS)), seed)
    label, values, shown = clear_fault([kind, *rng.permutation(kinds()).tolist()], clearness, rng)
    kind, target = split_label(label)
    instance = EffectInstance(catalogue()[kind], target, values)
    run = inside.with_effects(instance).run(plan, seed=seed, engine="dynamics", workers=1)
    outcome = Outcome(Case(ONE, "wii", (kind,), True), seed, Truth({label: values}, shows=(shown,)))
    try:
        found = discover(run.measurements, inside.robot, seed)
    except InputError as error:
        return replace(outcome, verdict=REFUSED, found=(Found(str(error)),))
    return replace(outcome, verdict=found.verdict, found=said(found))


def clear_fault(
    among: Sequence[str], clearness: Clearness, rng: np.random.Generator
) -> tuple[str, Values, float]:
    """Return label, values and s.e. of a fault of the first kind of which a plausible one is clear."""
    for kind in among:
        try:
            return clear_effect(kind, clearness, set(), rng)
        except InputError:
            continue
    raise InputError("found no plausible fault that is clear, expected one")


def kinds() -> list[str]:
    """List the kinds that a motion can hide."""
    return [one for one in hidden_kinds() if one not in FROM_POSTURE_TO_POSTURE]


def hidden(settings: Settings) -> Iterator[str]:
    """Yield a row a fault that was simulated."""
    count, rng = settings.count(CASES), np.random.default_rng(settings.seed)
    turns = [kind for _ in range(-(-count // len(kinds()))) for kind in rng.permutation(kinds()).tolist()]
    folder, cases = settings.folder("motion"), enumerate(turns[:count], settings.seed)
    calls = {folder / f"hidden-{seed}.json": (seed, kind) for seed, kind in cases}
    moving(SPEEDS["usual"], *LONGER)  # once, before workers ask for it
    found = settings.kept("hidden", hidden_fault, calls)
    first, wrong = sum(one.first for one in found), sum(one.wrong for one in found)
    yield f"\n{len(found)} faults: {first} first, {wrong} confident and wrong.\n"
    yield header("seed", "hidden", "shows, s.e.", "verdict", "said", "first", "wrong")
    for one in found:
        ((label, values),) = one.truth.hidden.items()
        names = "; ".join(written({each.label: each.values}) for each in one.found)
        marks = ["yes" if each else "" for each in (one.first, one.wrong)]
        size = written({label: values})
        yield row(one.run, size, f"{one.truth.shows[0]:.0f}", f"`{one.verdict}`", names, *marks)


def detectable(measured: Measurements) -> dict[str, np.ndarray]:
    """Return the least sizes of faults of every joint that discovery finds with 90 % probability, by kind."""
    robot = load_robot()
    observed, found = as_log_shows(observe(measured, nominal_robot(robot)), None)
    if observed.noise_in_time is not None:
        observed, found = with_independent_rows(observed), None
    search = CandidateSearch.of(observed)
    linear = calibrated_data(search.observed, found or first_calibration(search.observed)).null.linear
    effects = [each for each in search.candidates if each.effect.name in OF_JOINTS]
    laws = [each for each in law_candidates(search.observed) if each.target in by_direction(robot)]
    named = [each.effect.name for each in effects] + [FRICTION] * len(laws)
    columns, level = candidate_columns(linear, effects + laws).projected, single_level(LEVEL, TESTS)
    least = np.array(
        [
            detectable_size(one, points[len(points) // 2], level)
            for one, points in zip(effects + laws, columns, strict=True)
        ]
    )
    return {kind: least[np.array(named) == kind] for kind in OF_JOINTS}


def by_direction(robot: Robot) -> list[str]:
    """Name the laws by which encoders err with the direction of their joints."""
    return [f"encoder:{joint}/direction/step" for joint in joint_names(robot.model)]


def sizes(settings: Settings) -> Iterator[str]:
    """Yield a row a kind of fault."""
    inside, seed, (count, _) = laboratory("wii", settings.seed), settings.seed, LONGER
    motion = moving(SPEEDS["usual"], *LONGER)
    assert motion.motion is not None
    minutes = motion.motion.seconds / 60 + PLACING * count
    placements = count - 2
    postures = round((minutes / placements - PLACING) / HOLD)
    plan = tt.draw_plan(placements=placements, per_placement=postures, seed=PLAN_SEED).plan
    held, moved = (inside.run(p, seed=seed, workers=settings.workers).measurements for p in (plan, motion))
    yield "\n" + header(
        "fault of a joint", f"holds, {len(held)} in {minutes:.0f} min", "motion", "motion over holds"
    )
    of_holds, of_motion = detectable(held), detectable(moved)
    for kind, unit in OF_JOINTS.items():
        scale = 100 if unit == "%" else np.degrees(1.0)
        both = [scale * least[kind] for least in (of_holds, of_motion)]
        ranges = [f"{np.median(b):.2g} ({b.min():.2g} to {b.max():.2g})" for b in both]
        yield row(f"{kind}, {unit}", *ranges, f"{np.median(both[1] / both[0]):.2f}")


def equal_time(settings: Settings) -> Iterator[str]:
    """Yield a row a number of placements, for holds and for motions; draw them."""
    plan, inside = shipped_plan(load_robot()), laboratory("wii", settings.seed)
    motion = tt.plan_motion(plan.take(plan.placement <= MOVED), minutes=MOVES).plan
    few, seed = plan.take(np.arange(PAPERS_POSTURES)), settings.seed
    lifted = replace(moving(*ARMS[ONE_FOOT]), motion=None)
    held, held_lifted = (inside.run(each, seed=seed, engine="statics").measurements for each in (few, lifted))
    moved, moved_lifted = (
        inside.run(each, seed=seed, engine="dynamics", workers=settings.workers).measurements
        for each in (motion, moving(*ARMS[ONE_FOOT]))
    )
    yield "\n" + header(
        *("what", "placements", "robot time, min", "laboratory time, min", "rows"),
        *("median s.e. over the paper's", "largest"),
    )
    with card(8.2, 3.2) as (figure, ax):
        of_each = {
            "holds": (held, GREY, "o-"),
            "motion": (moved, X, "o-"),
            "holds, also on one foot": (held_lifted, GREY, "s--"),
            "motion, also on one foot": (moved_lifted, X, "s--"),
        }
        for name, (data, colour, line) in of_each.items():
            minutes, curve = HOLD if name[0] == "h" else float(np.median(np.diff(data.time))) / 60, []
            there = [np.unique(data.placement[data.support == each]) for each in np.unique(data.support)]
            for most in PARTS.get(name, range(1, 5)):
                part = data.take(np.isin(data.placement, np.concatenate([some[:most] for some in there])))
                ratios = over_papers(tt.identify(part))
                robot, placements = minutes * len(part), len(np.unique(part.placement))
                curve.append((robot, float(np.median(ratios))))
                yield row(
                    *(name, placements, f"{robot:.0f}", f"{robot + PLACING * placements:.0f}", len(part)),
                    *(f"{np.median(ratios):.3f}", f"{ratios.max():.2f}"),
                )
            ax.plot(*zip(*curve, strict=True), line, color=colour, label=name)
        ax.axhline(1.0, color="black", linestyle="--", linewidth=1.0, label="the paper's standard errors")
        ax.set(xlabel="robot time without placing, min", ylabel="median s.e. over the paper's")
        ax.set_ylim(0)
        figure.legend(loc="outside upper left", ncols=4)
        save_svg(figure, DOCS / "motion-time.svg")


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of the parts."""
    if set(settings.only) & {*SPEEDS, ONE_FOOT}:
        yield from coverage(settings)
    parts = {"nothing": nothing, "hidden": hidden, "sizes": sizes, "time": equal_time}
    for part, make in parts.items():
        if part in settings.only:
            yield from make(settings)
