"""A plan and what it promises: condition number, standard errors, correlations, margins."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Array, Figure, Outside, Result
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.correlations import correlation_table, united_links
from tulip_testbed.experiments.plan_clearances import clearance_table, clearances_of
from tulip_testbed.experiments.usable_plan import as_plan, identifiable_regressor, joined, planned_parameters
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.feasibility import predicted_cell_loads, predicted_foot_loads
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning.optimal_plan import smallest_margins
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.reading_noise import ReadingNoise, cell_noise, placement_levers
from tulip_testbed.identification.statistics import (
    HIGH_CORRELATION,
    WELL_IDENTIFIED,
    high_correlations,
    relative_standard_errors,
    standard_errors,
)
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.trajectory import Trajectory
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under, nominal_plates

NO_MARGINS = "Margins are known for six joints a leg only."
LARGE_SHARE = 1000.0  # % of a nominal value: it is near zero
SEARCHED = (
    *("objective", "initial_condition_number", "measured_objective", "initial_objective", "final_objective"),
)
NO_PROMISES = ("plan", "postures", "placements", "made", "wall_s", *SEARCHED)  # in the document of a plan


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DescribedPlan(Result):
    """A plan with what it promises.

    Figures are those of the postures after all that were measured before; the margins are of the plan alone.

    Attributes:
        source: the plan's name or folder. postures, placements: how many there are.
        condition_number: of the regressor.
        preset, sigma_mm: of the sensors, and the s.d. of the centre of pressure that they promise [mm].
        predicted_standard_error_mm, predicted_relative_standard_error_percent: of generalised least squares
            with this s.d., for the nominal robot, if every posture can be held, (p,) [mm, %].
        well_identified: how many parameters have a small relative standard error.
        correlations: `a`, `b`, `rho` of high ones (eq. 15). margins: see `margins_of`.
        clearances: see `clearances_of`. made: how the plan was made.
        objective, initial_condition_number, ...: of a search: what it made small, and its figures.
        wall_s: time of the search [s].
        plan: the postures. whole: these, after those that were measured before.
        finished: whether a search came to its end.
        notes: where the plan is.
    """

    source: Annotated[str | None, Field(alias="plan")]
    postures: int
    placements: int
    condition_number: float
    preset: str
    sigma_mm: float
    predicted_standard_error_mm: Array
    predicted_relative_standard_error_percent: Array
    well_identified: int
    correlations: list[dict[str, Any]]
    margins: dict[str, dict[str, Any]] | None
    clearances: dict[str, list[dict[str, Any]]]
    made: dict[str, Any]
    objective: str | None = None
    initial_condition_number: Figure = math.nan
    measured_objective: Figure = math.nan
    initial_objective: Figure = math.nan
    final_objective: Figure = math.nan
    wall_s: Figure = math.nan
    plan: Annotated[PosturePlan, Outside()]
    whole: Annotated[PosturePlan, Outside()]
    robot: Annotated[Robot, Outside()]
    finished: Annotated[bool, Outside()] = True
    notes: Annotated[tuple[str, ...], Outside()] = ()

    @property
    def exit_code(self) -> int:
        """Return 130 of an interrupted search, or else 0."""
        return 0 if self.finished else 130

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, without what only a search has where there was none."""
        searched = (*SEARCHED, "wall_s")
        document = super().to_json()
        return {key: value for key, value in document.items() if value is not None or key not in searched}

    def promises(self) -> dict[str, Any]:
        """Return what the plan promises, as its folder keeps it."""
        return {name: value for name, value in self.to_json().items() if name not in NO_PROMISES}

    def tables(self) -> list[Table | str]:
        parameters = planned_parameters(self.robot, self.whole)
        pairs = [(pair["a"], pair["b"], pair["rho"]) for pair in self.correlations]
        return [
            self._head(),
            *([] if self.plan.motion is None else [_moving(self.plan, self.plan.motion)]),
            f"{self.well_identified} of {len(parameters.names)} parameters would be well identified "
            f"(relative standard error below {WELL_IDENTIFIED:.0f} %), preset {self.preset}, sigma "
            f"{self.sigma_mm:.2f} mm.",
            self.table(),
            correlation_table("full", pairs, parameters, self.whole.joint_angles),
            NO_MARGINS if self.margins is None else margin_table(self.margins),
            clearance_table(self.clearances),
            *self.notes,
        ]

    def _head(self) -> str:
        """Describe in a sentence what the plan is, and what a search improved."""
        size = f"{self.postures} postures on {self.placements} placements"
        if self.objective is None:
            return f"{size}, condition number {self.condition_number:.0f}."
        size += f", objective {self.objective}"
        if math.isnan(self.measured_objective):
            first = f"{self.initial_condition_number:.1f}"
            return f"{size}: condition number {first} -> {self.condition_number:.1f}."
        criteria = (self.measured_objective, self.initial_objective, self.final_objective)
        before, random, chosen = (number(value, ".4g") for value in criteria)
        return (
            f"{size}: {before} with the {len(self.whole) - len(self.plan)} measured postures, {random} with "
            f"the random ones to begin with, {chosen} with these; the numbers below are of both together."
        )

    def table(self) -> Table:
        parameters = planned_parameters(self.robot, self.whole)
        figures = ("s.e.", "mm", ".2f"), ("of the nominal value", "%", ".1f")
        heads = (("no.", "", "d"), "parameter", *figures, Column("links", extra=True))
        errors = self.predicted_standard_error_mm.tolist()
        shares = self.predicted_relative_standard_error_percent.tolist()
        rows = [
            [k, name, error, share if share < LARGE_SHARE else math.inf, united_links(parameters, k)]
            for k, (name, error, share) in enumerate(zip(parameters.names, errors, shares, strict=True), 1)
        ]
        title = f"Predicted standard errors, preset {self.preset}, if every posture can be held"
        return Table(title, heads, rows, "-: the nominal value is near zero.")


def _moving(plan: PosturePlan, motion: Trajectory) -> str:
    joint, speed = motion.fastest
    return (
        f"The robot moves: {len(motion.segments)} segments, {motion.seconds / 60:.1f} min, at most "
        f"{speed:.2f} rad/s ({plan.joints[joint]}). The numbers below are of the postures if they were held."
    )


def describe_plan(
    robot: Robot, plan: PosturePlan, source: str | None, preset: str, measured: Measurements | None = None
) -> DescribedPlan:
    """Describe a plan for the sensors of a preset, "wii" or "force-plate"."""
    whole = plan if measured is None else joined([as_plan(robot, measured), plan])
    rows = identifiable_regressor(source or "plan", robot, whole)
    parameters = planned_parameters(robot, whole)
    nominal = parameters.values(standard_parameters(robot.model))
    matrix = rows.reshape(len(whole), 2, -1)
    noise = planned_noise(robot, whole, preset)
    covariance = np.linalg.inv(np.tensordot(matrix, noise.weights(matrix), axes=((0, 1), (0, 1))))
    errors = standard_errors(covariance)
    relative = relative_standard_errors(nominal, errors)
    pairs = high_correlations(np.linalg.inv(rows.T @ rows), np.arange(1, len(nominal) + 1), HIGH_CORRELATION)
    return DescribedPlan(
        source=source,
        postures=len(plan),
        placements=len(np.unique(plan.placement)),
        condition_number=float(np.linalg.cond(rows)),
        preset=preset,
        sigma_mm=1e3 * float(np.sqrt(noise.variance.mean())),
        predicted_standard_error_mm=1e3 * errors,
        predicted_relative_standard_error_percent=relative,
        well_identified=int((relative < WELL_IDENTIFIED).sum()),
        correlations=[{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
        margins=margins_of(robot, plan),
        clearances=clearances_of(robot, plan),
        made=plan.made,
        plan=plan,
        whole=whole,
        robot=robot,
    )


def planned_noise(robot: Robot, plan: PosturePlan, preset: str) -> ReadingNoise:
    """Compute the noise of the centre of pressure at a plan's postures, see `describe_plan`."""
    rig, nominal = preset_rig(preset, robot), nominal_robot(robot, common_support(plan.support))
    com = nominal.center_of_mass(plan.joint_angles, plan.support)
    readings = planned_readings(rig, plan, com)
    sheet = readings.sensors
    slope = nominal.parameters.slope_along(nominal.value, plan.joint_angles, plan.support)
    slope = (sheet.encoder_sd or 0.0) * slope
    own = (sheet.cell_sd or 0.0) ** 2 * cell_noise(readings, com) + slope @ slope.mT
    sd = np.array([*rig.sensors.mark_sd, *rig.sensors.placement_sd])
    return ReadingNoise(own, placement_levers(readings) * sd, plan.placement)


def planned_readings(rig: Rig, plan: PosturePlan, com: np.ndarray) -> Measurements:
    """Compute the plates' readings without noise for the nominal centre of mass, (m, 2) [m]."""
    robot, model = rig.robot, rig.robot.model
    plate = dataclasses.replace(nominal_plates(robot)[0], mass=0.0)  # tared
    weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
    feet, stands = plan.foot_poses, feet_in_contact(plan.support)
    boards = boards_under(rig, feet)
    cells = []
    for point, pair, board, on in zip(com, feet, boards, stands, strict=True):
        share, cop = predicted_foot_loads(point, pair[:, :2])
        if not on.all():
            share, cop = on.astype(float), np.where(on[:, None], point, board[:, :2])
        cells.append(predicted_cell_loads(share, cop, board, plate, weight))
    count = len(plan)
    return Measurements.from_arrays(
        header_of(rig),
        posture=plan.posture,
        placement=plan.placement,
        support=plan.support,
        window=np.full(count, rig.protocol.window),
        samples=np.full(count, round(rig.protocol.window * rig.sensors.sample_rate)),
        joint_angles=plan.joint_angles,
        cell_forces=np.array(cells),
        plate_poses=boards,
    )


def margins_of(robot: Robot, plan: PosturePlan) -> dict[str, dict[str, Any]] | None:
    """Return the least margin of every constraint of `tulip plan optimal` over the postures.

    None where the robot has other than six joints a leg. Negative where a plan was not made to keep it, as
    a random one's.
    """
    try:
        problem = planning_problem(robot, nominal_plates(robot)[0], support=common_support(plan.support))
    except InputError:
        return None
    return smallest_margins(problem, plan)


def margin_table(margins: dict[str, dict[str, Any]]) -> Table:
    heads = ("constraint", ("margin", "", ".3f"), "unit", ("posture", "", "d"), "where")
    rows = [[name, m["value"], m["unit"], m["posture"], m["at"]] for name, m in margins.items()]
    return Table("Smallest margin of every constraint, beyond what `tulip plan optimal` keeps", heads, rows)
