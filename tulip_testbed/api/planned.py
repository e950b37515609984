"""Functions of a plan of postures: search, atlas, protocol, watch."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tulip_testbed.api.inputs import (
    Measured,
    PlanSource,
    load_robot,
    measurements_of,
    new_place,
    plan_name,
    plan_of,
)
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import look_up
from tulip_testbed.base.files import check_new
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.laws import LAW
from tulip_testbed.experiments.atlases.atlas_result import Atlas
from tulip_testbed.experiments.atlases.effect_atlas import atlas as _atlas
from tulip_testbed.experiments.atlases.planned_experiment import Planned, planned
from tulip_testbed.experiments.atlases.tolerance import Tolerance
from tulip_testbed.experiments.atlases.tolerance import tolerance as _tolerance
from tulip_testbed.experiments.defaults import DEFAULT_SEED, HOPS, MOTION_SPEED, REPEATS, SPEED
from tulip_testbed.experiments.described_plan import DescribedPlan
from tulip_testbed.experiments.described_plan import describe_plan as _describe_plan
from tulip_testbed.experiments.effect_list import EffectList
from tulip_testbed.experiments.planning_run import PlanSettings, check_out, search_plan, set_up_search
from tulip_testbed.experiments.protocols.motion_plan import MotionPlan, moving_plan
from tulip_testbed.experiments.protocols.protocol_run import LaboratoryProtocol, protocol_of
from tulip_testbed.experiments.usable_plan import check_plan, random_plan
from tulip_testbed.experiments.watching.watch_day import Watch
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.robot import Robot

Targets = Mapping[str, float]
NOISY = ("wii", "force-plate")  # sensors with noise of readings on plates


@checked
@one_blas_thread
def draw_plan(
    robot: Robot | None = None,
    *,
    placements: int = 10,
    per_placement: int = 5,
    seed: int = DEFAULT_SEED,
    sensors: str = "wii",
    out: str | Path | None = None,
    progress: Progress = silent,
) -> DescribedPlan:
    """Draw random feasible postures.

    Args:
        robot: the nominal robot; TULip if None.
        placements: foot placements.
        per_placement: postures on each placement.
        seed: of the draws.
        sensors: whose noise the standard errors are predicted for: "wii" or "force-plate".
        out: the new plan folder.

    Returns:
        the plan with its condition number, predicted standard errors and margins; `plan` are the postures.

    Raises:
        InputError: too few postures, ranges that admit nothing, or a folder that exists.
    """
    _check_noisy(sensors)
    robot, place = robot or load_robot(), new_place(out)
    made = random_plan(robot, placements, per_placement, seed, progress)
    described = _describe_plan(robot, made, "plan" if place is None else str(place), sensors)
    if place is None:
        return described
    write_plan(place, made)
    return replace(described, notes=(f"Plan folder: {place}",))


@checked
@one_blas_thread
def describe_plan(
    plan: PlanSource | None = None,
    robot: Robot | None = None,
    *,
    after: Measured | None = None,
    sensors: str = "wii",
) -> DescribedPlan:
    """Describe a plan and the standard errors that it promises.

    Args:
        plan: postures, or their folder, or the name of a shipped plan.
        robot: the nominal robot; TULip if None.
        after: measurements, together with which the plan is described.
        sensors: whose noise the standard errors are predicted for: "wii" or "force-plate".

    Raises:
        InputError: postures that do not identify the robot.
    """
    robot = robot or load_robot()
    _check_noisy(sensors)
    given = plan_of(plan, robot)
    earlier = None if after is None else measurements_of(after, robot)
    return _describe_plan(robot, given, plan_name(plan), sensors, earlier)


@checked
@one_blas_thread
def plan_motion(
    plan: PlanSource | None = None,
    robot: Robot | None = None,
    *,
    minutes: float | None = None,
    speed: float = MOTION_SPEED,
    sensors: str = "wii",
    out: str | Path | None = None,
    progress: Progress = silent,
) -> MotionPlan:
    """Join the postures of a plan by slow motions.

    Such a plan is measured while the robot moves. On every placement it goes from posture to posture on its
    own feet, inside the margins of sole, zero-moment point, torque and link distances. Motions that would
    need a hoist are left out and counted. Postures on one foot, of which each had a placement, share some.

    Args:
        plan: postures, or their folder, or the name of a shipped plan.
        robot: the nominal robot; TULip if None.
        minutes: of motion: it is slower than `speed` where that fills them; None: as fast as `speed` allows.
        speed: most of the fastest joint [rad/s].
        sensors: with whose noise the inertial forces are compared: "wii" or "force-plate".
        out: the new plan folder.

    Returns:
        segments, time, fastest joint and margins; its `plan` can be simulated.

    Raises:
        InputError: a plan that does not fit the robot or between whose postures nothing moves freely, a
            setting out of range, or a folder that exists.
    """
    _check_noisy(sensors)
    robot, place = robot or load_robot(), new_place(out)
    made = moving_plan(robot, plan_of(plan, robot), minutes, speed, sensors, progress)
    if place is None:
        return made
    write_plan(place, made.plan)
    return replace(made, notes=(*made.notes, f"Plan folder: {place}"))


@checked
@one_blas_thread
def optimize_plan(
    robot: Robot | None = None,
    *,
    seed: int = DEFAULT_SEED,
    objective: str = "condition",
    placements: int = 10,
    postures_per_placement: int = 5,
    hops: int = HOPS,
    after: Measured | None = None,
    right: int = 0,
    left: int = 0,
    repeats: int = 0,
    sensors: str = "wii",
    out: str | Path | None = None,
    progress: Progress = silent,
) -> DescribedPlan:
    """Search for optimal postures (section IV of the paper).

    The search starts from random feasible postures and keeps every constraint. Ctrl-C writes the best plan so
    far; the same call then continues the search.

    Args:
        robot: the nominal robot; TULip if None.
        seed: of everything random.
        objective: "condition", "d-optimal", "a-optimal", ...: what is made small.
        placements: foot placements.
        postures_per_placement: postures on each placement.
        hops: exchanges of a placement's postures; a minute for the default.
        after: measurements: find postures that add most to them.
        right: postures on the right foot, optimised together with the others.
        left: postures on the left foot, optimised together with the others.
        repeats: postures that come twice: half in the same placement, half in another one.
        sensors: whose noise the standard errors are predicted for: "wii" or "force-plate".
        out: the new plan folder.

    Returns:
        the plan with its condition number, predicted standard errors and margins; `plan` are the postures.

    Raises:
        InputError: a setting out of range, or too few postures to identify the robot; a folder that exists.
    """
    place = None if out is None else Path(out)
    _check_noisy(sensors)
    if place is not None:
        check_out(place)
    robot = robot or load_robot()
    size = (placements, postures_per_placement, hops)
    settings = PlanSettings(seed, objective, *size, repeats, right, left)
    earlier = None if after is None else measurements_of(after, robot)
    return search_plan(set_up_search(robot, settings, earlier), settings, place, sensors, progress)


def _check_noisy(sensors: str) -> None:
    look_up("preset", sensors, NOISY, "sensors")


@checked
@one_blas_thread
def atlas(
    plan: PlanSource | None = None,
    robot: Robot | None = None,
    *,
    sensors: str = "wii",
    seed: int = DEFAULT_SEED,
    out: str | Path | None = None,
) -> Atlas:
    """Predict which effects a plan can detect and distinguish.

    No data are needed. The table has one row for each kind of effect. The page atlas.html in the folder shows
    every effect with the bias that it causes if it is not modelled; it has a search box.

    Args:
        plan: postures, or their folder, or the name of a shipped plan.
        robot: the nominal robot; TULip if None.
        sensors: of the laboratory: "wii", "force-plate" or "ideal".
        seed: of everything random.
        out: new folder for a page and atlas.json.

    Raises:
        InputError: a plan that would not identify the robot, or that statics does not know; a folder that
            exists.
    """
    place = new_place(out)
    found = _atlas(_planned(plan, robot, sensors, seed), np.random.default_rng(seed))
    if place is None:
        return found
    from tulip_testbed.pages.run_page import write_atlas  # plotly loads slowly

    write_atlas(place, found)
    return replace(found, folder=place)


@checked
@one_blas_thread
def tolerance(
    plan: PlanSource | None = None,
    robot: Robot | None = None,
    *,
    sensors: str = "wii",
    seed: int = DEFAULT_SEED,
) -> Tolerance:
    """Compute how accurately a laboratory must be set up.

    Errors of plates, floor, encoders and cells bias the parameters; the biases are predicted to first order.

    Args:
        plan: postures, or their folder, or the name of a shipped plan.
        robot: the nominal robot; TULip if None.
        sensors: of the laboratory: "wii", "force-plate" or "ideal".
        seed: of everything random.

    Raises:
        InputError: a plan that would not identify the robot, or that statics does not know.
    """
    return _tolerance(_planned(plan, robot, sensors, seed))


def _planned(plan: PlanSource | None, robot: Robot | None, sensors: str, seed: int) -> Planned:
    robot = robot or load_robot()
    given = plan_of(plan, robot)
    check_plan(robot, given, plan_name(plan))
    return planned(given, sensors, robot, seed)


@checked
def list_effects(name: str | None = None, robot: Robot | None = None) -> EffectList:
    """List the effects that can be simulated, or explain one.

    `law` explains the grammar by which effects are composed that the list lacks: what errs, as a function of
    what, in which shape.

    Args:
        name: of an effect, or "law"; None: all effects.
        robot: that has the targets; TULip if None.

    Raises:
        InputError: there is no such effect.
    """
    if name is not None:
        look_up("effect", name, [*catalogue(), LAW], "effects")
    return EffectList(name, robot or load_robot())


@checked
@one_blas_thread
def protocol(
    plan: PlanSource | None = None,
    robot: Robot | None = None,
    *,
    out: str | Path,
    sensors: str | None = None,
    speed: float = SPEED,
    repeats: int = REPEATS,
    progress: Progress = silent,
) -> LaboratoryProtocol:
    """Write what a laboratory needs to carry a plan out.

    The folder gets protocol.html (pages to print: drawings to scale, postures, boxes to tick, checklists),
    plan (the plan in the order in which it is measured), trajectories (CSV, and ROS 2
    JointTrajectory as YAML), measurements (the start of the measurement folder) and rows.csv (to fill in).

    Args:
        plan: postures, or their folder, or the name of a shipped plan.
        robot: the nominal robot; TULip if None.
        out: new folder.
        sensors: whose data sheet starts the measurements; unknown if left out.
        speed: largest speed of a joint between postures [rad/s].
        repeats: postures that are measured twice if the plan repeats none; at most every fifth is.

    Returns:
        the plan in the order in which it is measured, with the motion to every posture.

    Raises:
        InputError: a plan that does not fit the robot, a setting out of range, or a folder that exists.
    """
    from tulip_testbed.pages.protocol_page import contents, write_protocol

    robot, place = robot or load_robot(), Path(out)
    check_new(place)
    made = protocol_of(robot, plan_of(plan, robot), sensors, speed, repeats, progress)
    missing = write_protocol(place, made)
    return replace(made, folder=place, missing=tuple(missing), files=tuple(contents(place)))


@checked
def watch(
    folder: str | Path,
    robot: Robot | None = None,
    *,
    plan: PlanSource,
    out: str | Path | None = None,
    targets: Targets | None = None,
    once: bool = False,
) -> Watch:
    """Check postures while they are measured, and say when to stop.

    Each row is compared with the postures before it, the robot's CAD model, the repeats and the data sheets'
    noise. The watch ends when every posture is measured, or by Ctrl-C.

    Args:
        folder: measurement folder whose manifest.json is written and whose postures.csv grows, or motion.csv
            with a plan that moves; nothing is written into it.
        robot: the nominal robot; TULip if None.
        plan: postures that are being measured, or their folder, or the name of a shipped plan.
        out: file that keeps the state, so that a watch that was killed goes on; None: it is not kept.
        targets: standard errors at which to stop, by base parameter or "all" [m].
        once: judge the rows that are there and end.

    Returns:
        an iterator of what came of every row, as soon as it is there; `verdict` says what it shows, which
        posture is next and whether the day may end.

    Raises:
        InputError: another robot's folder or plan, sensors other than plates on four cells, a state of
            another day; while rows arrive, a table whose header changes or that becomes shorter.
    """
    robot = robot or load_robot()
    place = None if out is None else Path(out)
    return Watch(Path(folder), plan_of(plan, robot), robot, place, targets, once)
