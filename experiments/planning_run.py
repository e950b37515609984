"""Check and carry out a search for a plan; its states lie in a folder, from which the same call goes on."""

import dataclasses
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, at_most, look_up, warn
from tulip_testbed.base.files import check_new, present
from tulip_testbed.base.machine import machine
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.resumable import ResumableFolder
from tulip_testbed.base.table_files import MOST_ROWS, read_json, software
from tulip_testbed.experiments.defaults import HOPS
from tulip_testbed.experiments.described_plan import SEARCHED, DescribedPlan, describe_plan
from tulip_testbed.experiments.usable_plan import as_plan, check_measurable, enough, plan_hash
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.optimal_plan import SearchTask, with_repeats
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import SearchState, StateError
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import nominal_plates

SIGMA_MM = 4.16  # the paper's residual per axis (eq. 14)


@dataclass(frozen=True)
class PlanSettings:
    """The settings of a plan, those of `tulip_testbed.optimize_plan`."""

    seed: int = 1
    objective: str = "condition"
    placements: int = 10
    postures_per_placement: int = 5
    hops: int = HOPS
    repeats: int = 0
    right: int = 0
    left: int = 0


def state_folder(out: Path) -> Path:
    """Return where an interrupted search leaves its states, next to its plan."""
    return out.with_name(f".{out.name}.search")


def set_up_search(robot: Robot, settings: PlanSettings, measured: Measurements | None = None) -> SearchTask:
    """Check, before the work, what a plan is to be, alone or after what was measured before."""
    for name, value in vars(settings).items():
        if name != "objective":
            at_least(name, value, int(name in ("placements", "postures_per_placement")))
    for name in ("hops", "right", "left"):
        at_most(name, getattr(settings, name), MOST_ROWS)
    placements, per = settings.placements, settings.postures_per_placement
    at_most("placements, postures_per_placement", placements * per, MOST_ROWS)
    if settings.repeats > (most := placements * per):
        raise InputError(f"repeats: found {settings.repeats}, expected at most the plan's {most} postures")
    counts = {foot: n for foot, n in (("right", settings.right), ("left", settings.left)) if n}
    if counts and measured is not None:
        raise InputError("right, left: found postures on one foot after measurements, expected none")
    check_measurable(robot)
    rows = np.array(["double", *counts]) if measured is None else measured.support
    support = common_support(rows)
    problem = planning_problem(robot, nominal_plates(robot)[0], support=support)
    goals = objectives(1e-3 * SIGMA_MM)
    goal = goals[look_up("objective", settings.objective, goals, "objective")]
    taken = sum(counts.values()) if measured is None else len(measured)
    enough("placements, postures_per_placement", taken + placements * per, problem.parameters)
    seed, hops = settings.seed, settings.hops
    return SearchTask(problem, goal, placements, per, seed, hops, counts, measured)


def search_plan(
    task: SearchTask, wanted: PlanSettings, out: Path | None, sensors: str, progress: Progress = silent
) -> DescribedPlan:
    """Search for a plan, or go on with the interrupted search whose states are next to its folder."""
    began, place = time.perf_counter(), None if out is None else str(out)
    with _states_of(task, wanted, out) as states:
        plan, finished = _carry_out(task, states, progress)
        if finished and wanted.repeats:
            plan = with_repeats(plan, wanted.repeats, wanted.seed)
        described = describe_plan(task.problem.robot, plan, place, sensors, task.measured)
        if not finished:
            warn("interrupted; this is the best plan so far, and the same call goes on")
        if out is not None and states is not None:
            _keep_plan(out, replace(plan, made=plan.made | {"described": described.promises()}), states)
            for state in states.glob("seed-*.json") if finished else ():
                state.unlink()
    return replace(
        described,
        **{name: plan.made[name] for name in SEARCHED if name in plan.made},
        wall_s=time.perf_counter() - began,
        finished=finished,
        notes=() if out is None else (f"Plan folder: {out}",),
    )


@contextmanager
def _states_of(task: SearchTask, wanted: PlanSettings, out: Path | None) -> Iterator[Path | None]:
    """Open the folder of a search's states; it goes when it holds none."""
    if out is None:
        yield None
        return
    robot, measured = task.problem.robot, task.measured
    made_with = {
        "settings": dataclasses.asdict(wanted),
        "measured": None if measured is None else plan_hash(as_plan(robot, measured)),
        "robot": robot.hashes,
        "software": software(),
        "machine": machine(),
    }
    folder = ResumableFolder(state_folder(out), "search.json", made_with, "search", "states")
    with folder.opened() as states:
        try:
            yield states
        finally:
            if not any(states.glob("seed-*.json")):
                shutil.rmtree(states, ignore_errors=True)


def _carry_out(task: SearchTask, states: Path | None, progress: Progress) -> tuple[PosturePlan, bool]:
    """Carry out a search from its last state; return its plan and whether it came to its end."""
    kept = None if states is None else states / f"seed-{task.seed}.json"
    state = last = None if kept is None else read_state(kept)
    with progress(f"seed {task.seed}", task.rounds, state.rounds if state else 0) as advance:

        def show(reached: SearchState) -> None:
            nonlocal last
            before, last = last.rounds if last else 0, reached
            if kept is not None:
                reached.write(kept)
            advance(reached.rounds - before, reached.value)

        try:
            return task.run(show, state), True
        except StateError as error:
            raise InputError(f"{kept}: found no state of an interrupted run ({error}); remove it") from None
        except KeyboardInterrupt:
            if last is None or kept is None:
                raise
            plan = task.plan_of(last)
            return replace(plan, made=plan.made | {"interrupted": True}), False


def read_state(path: Path) -> SearchState | None:
    """Read what an interrupted search left; None where there is nothing."""
    if not present(path):
        return None
    try:
        return SearchState.read(path)
    except InputError as error:
        raise InputError(f"{error}; remove it") from None


def check_out(out: Path) -> None:
    """Refuse a name that is taken, unless by the plan of an interrupted search whose states are there."""
    if not (present(state_folder(out)) and _interrupted(out)):
        check_new(out)


def _keep_plan(out: Path, plan: PosturePlan, states: Path) -> None:
    """Write a plan folder, in the place of that of an interruption: its states make it again."""
    if _interrupted(out):
        aside = states / "interrupted"
        shutil.rmtree(aside, ignore_errors=True)
        os.rename(out, aside)
    write_plan(out, plan)


def _interrupted(out: Path) -> bool:
    """Return whether a plan folder says that its search was interrupted."""
    if not present(out / "plan.json"):
        return False
    try:
        return read_json(out / "plan.json").get("made", {}).get("interrupted") is True
    except (InputError, AttributeError):
        return False
