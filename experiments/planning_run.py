"""A planning run that can be interrupted and taken up again, and what is added to its plan."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, at_least, at_most, listed, look_up
from tulip_testbed.base.files import check_new, present
from tulip_testbed.base.table_files import MOST_ROWS, read_json
from tulip_testbed.experiments.plan_state import no_state, read_state, state_file, write_state
from tulip_testbed.experiments.planning_jobs import Job, Show, plan_job
from tulip_testbed.experiments.usable_plan import enough
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning.interior_point import casadi_module
from tulip_testbed.identification.planning.objectives import Objective
from tulip_testbed.identification.planning.optimal_plan import (
    measured_information,
    objective_by_name,
    with_repeats,
)
from tulip_testbed.identification.planning.problem import Problem, planning_problem
from tulip_testbed.identification.planning.search import SearchState, StateError
from tulip_testbed.identification.planning.search_defaults import HOPS, SOLVERS
from tulip_testbed.identification.planning.single_support import single_support_plan
from tulip_testbed.measurements import Measurements, PosturePlan, read_measurements
from tulip_testbed.sim.plan_folder import check_model, write_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.robot_check import warn_of_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.scene_check import check_scene

SIGMA_MM = 4.16  # the paper's residual per axis (eq. 14)


@dataclass(frozen=True)
class PlanSettings:
    """The settings of a plan.

    Attributes:
        seed: of everything random.
        objective: "condition", "d-optimal", "a-optimal", ..., see `identification.planning.objectives`.
        placements, postures_per_placement: its size.
        hops: exchanges of a placement's postures.
        single_support: postures on the right foot alone, after the others.
        repeats: postures that come twice: half in the same placement, half in another one.
        solver: of the last round, one of `SOLVERS`.
        right, left: postures on the right and on the left foot alone, optimised together with the others.
    """

    seed: int = 1
    objective: str = "condition"
    placements: int = 10
    postures_per_placement: int = 5
    hops: int = HOPS
    single_support: int = 0
    repeats: int = 0
    solver: str = SOLVERS[0]
    right: int = 0
    left: int = 0

    @property
    def on_one_foot(self) -> dict[str, int]:
        """Numbers of postures on one foot that are optimised together with those on both, none if 0."""
        counts = {"right": self.right, "left": self.left}
        return {foot: count for foot, count in counts.items() if count}

    @property
    def size(self) -> tuple[int, int, int]:
        """Placements, postures on each, hops."""
        return self.placements, self.postures_per_placement, self.hops


@dataclass(frozen=True)
class Search:
    """A search for a plan of a robot, checked and ready.

    Attributes:
        measured: what was measured before, None: nothing.
        problem: the constraints. goal: what is made small.
    """

    robot: Robot
    settings: PlanSettings
    measured: Measurements | None
    problem: Problem
    goal: Objective

    def job(self, seed: int | None = None) -> Job:
        """Set up the search from a random start.

        Args:
            seed: of the start; the settings' if None.
        """
        wanted, seed = self.settings, self.settings.seed if seed is None else seed
        counts = wanted.on_one_foot
        return plan_job(self.problem, self.goal, wanted.size, seed, wanted.solver, counts, self.measured)

    def extended(self, plan: PosturePlan) -> PosturePlan:
        """Add the postures on one foot and the repeats that the settings ask for."""
        wanted, plate = self.settings, nominal_plates(self.robot)[0]
        if wanted.single_support:
            one = planning_problem(self.robot, plate, support="right")
            goal = objective_by_name(one, wanted.objective, 1e-3 * SIGMA_MM)
            none = np.zeros((len(one.nominal),) * 2)
            known = none if self.measured is None else measured_information(one, self.measured)
            plan = single_support_plan(one, goal, plan, known, wanted.single_support, wanted.seed)
        return with_repeats(plan, wanted.repeats, wanted.seed) if wanted.repeats else plan


def set_up_search(
    robot: Robot, settings: PlanSettings, measured: Measurements | None = None, trials: int = 1
) -> Search:
    """Check what a plan is to be, before the work.

    Args:
        measured: what was measured before: the plan is to tell most next.
        trials: plans that will be joined.

    Raises:
        InputError: a setting out of range, a solver that is not installed, too few postures.
    """
    for name, least in (
        *(("seed", 0), ("placements", 1), ("postures_per_placement", 1), ("hops", 0)),
        *(("single_support", 0), ("repeats", 0), ("right", 0), ("left", 0)),
    ):
        at_least(name, getattr(settings, name), least)
    placements, per, _ = settings.size
    at_most("placements, postures_per_placement", placements * per, MOST_ROWS)
    if settings.repeats > (most := trials * placements * per):
        raise InputError(f"repeats: found {settings.repeats}, expected at most the plan's {most} postures")
    look_up("solver", settings.solver, SOLVERS, "solver")
    if settings.solver == "ipopt":
        if measured is not None:
            raise InputError("solver: found ipopt for a plan after measurements, expected slsqp")
        casadi_module()
    if counts := settings.on_one_foot:
        _check_mixed(settings, measured)
    check_scene(preset_rig("ideal", robot))
    warn_of_robot(robot)
    rows = np.array(["double", *counts]) if measured is None else measured.support
    support = common_support(rows)
    problem = planning_problem(robot, nominal_plates(robot)[0], support=support)
    goal = objective_by_name(problem, settings.objective, 1e-3 * SIGMA_MM)
    taken = sum(counts.values()) if measured is None else len(measured)
    enough("placements, postures_per_placement", taken + placements * per, problem.parameters)
    return Search(robot, settings, measured, problem, goal)


def _check_mixed(settings: PlanSettings, measured: Measurements | None) -> None:
    """Refuse settings that do not go with postures on one foot among the others."""
    if measured is not None:
        raise InputError("right, left: found postures on one foot after measurements, expected none")
    if settings.single_support:
        raise InputError("right, left: found with single_support, expected one of them")


def carry_out(job: Job, kept: Path, show: Show) -> tuple[PosturePlan, bool]:
    """Continue a job where it was interrupted; return its plan and whether it is complete.

    Args:
        kept: the file of the state, written after every round.

    Raises:
        InputError: a state that this search did not leave.
        KeyboardInterrupt: before there was any plan.
    """
    state = last = read_state(kept, job.key)

    def progress(found: SearchState) -> None:
        nonlocal last
        last = found
        write_state(kept, job.key, found)
        show(found)

    try:
        return job.run(progress, state), True
    except StateError as error:
        raise no_state(kept, error) from None
    except KeyboardInterrupt:
        if last is None:
            raise
        plan = job.best(last)
        return replace(plan, made=plan.made | {"interrupted": True}), False


def check_out(out: Path) -> None:
    """Refuse a name that is taken, unless by the plan of an interrupted run whose state is there.

    Raises:
        InputError: it is taken, or cannot be written.
    """
    if not (present(state_file(out)) and _interrupted(out)):
        check_new(out)


def keep_plan(out: Path, plan: PosturePlan) -> None:
    """Write a plan folder, in the place of an interrupted run's if there is one.

    Raises:
        InputError: it cannot be written.
    """
    aside = out.with_name(f".{out.name}.interrupted")  # also there if a run was killed right here
    if _interrupted(out):
        shutil.rmtree(aside, ignore_errors=True)
        os.rename(out, aside)
    try:
        write_plan(out, plan)
    except BaseException:
        if present(aside) and not present(out):
            os.rename(aside, out)
        if present(out) and not _interrupted(out):  # another process's: nobody will go on
            shutil.rmtree(aside, ignore_errors=True)
            state_file(out).unlink(missing_ok=True)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def measured_for(robot: Robot, folder: Path, joints: tuple[str, ...]) -> Measurements:
    """Return the earlier measurements with this robot.

    Raises:
        InputError: no such folder, or of another robot.
    """
    measured = read_measurements(folder)
    where = f"{folder}: manifest.json"
    check_model(where, measured.robot["model"], measured.robot["sha256"], robot)
    if measured.joints != joints:
        raise InputError(
            f"{where}: key 'joints': found {listed(measured.joints)}; expected the model's order "
            f"{listed(joints)}"
        )
    return measured


def as_plan(robot: Robot, measured: Measurements) -> PosturePlan:
    """Measured postures as if they were planned; the swing foot is where the angles put it."""
    nominal = nominal_robot(robot, common_support(measured.support))
    pose = nominal.other_sole(measured.joint_angles, measured.support)
    return PosturePlan(
        joints=measured.joints,
        joint_angles=measured.joint_angles,
        posture=measured.posture,
        placement=measured.placement,
        support=measured.support,
        swing_pose=pose,
        robot={"model": robot.model_file.name, "sha256": robot.model_hash},
    )


def joined(plans: list[PosturePlan]) -> PosturePlan:
    """Plans one after the other, with the first one's robot and provenance; numbers stay."""

    def stacked(name: str) -> np.ndarray:
        return np.concatenate([getattr(plan, name) for plan in plans])

    return replace(
        plans[0],
        joint_angles=stacked("joint_angles"),
        posture=stacked("posture"),
        placement=stacked("placement"),
        support=stacked("support"),
        swing_pose=stacked("swing_pose"),
        torques=None if all(plan.torques is None for plan in plans) else stacked("feed_forward"),
    )


def _interrupted(out: Path) -> bool:
    """Whether a plan folder says that its run was interrupted."""
    if not present(out / "plan.json"):
        return False
    try:
        return read_json(out / "plan.json").get("made", {}).get("interrupted") is True
    except (InputError, AttributeError):
        return False
