"""The data of postures that a view shows, as plain arrays."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.identify import DEFAULT_ESTIMATOR, identify
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.feasibility import stability_margin, support_polygon
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements, PlateGeometry, PosturePlan
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.pages import NO_TRUE_COM
from tulip_testbed.sim.plan_folder import check_model
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under, nominal_plates


@dataclass(frozen=True)
class Subject:
    """Postures with all known data about them, one row each.

    Attributes:
        notes: sentences for the reader.
        plates: recorded poses, (m, 2, 3) [m, m, rad]. board: the shape of a plate.
        cells: in their plate's frame, (2, 4, 2) [m]. top_height: of the plates, (2,) [m].
        com: projections of the centre of mass by where they come from ("truth", "estimate", "nominal
            model"), (m, 2) [m] each.
        command: (m, n_joints) [rad], None: unknown. cell_forces: (m, 8) [N], None: a plan, or no cells.
        foot_loads: vertical force on each foot, (m, 2) [N], and its point, (m, 2, 2) [m]. None: a plan.
        cop: (m, 2) [m], None: a plan. weight: of the nominal robot [N], NaN: a plan.
        polygons: support polygon of every row, (k, 2) [m]. margin: d_e of the point that is judged (the CoP,
            in a plan the nominal CoM), (m,) [m].
        least_margin: d_s [m], None: the robot's description gives none.
        true_masses: the true standard parameters (n_links, 4) under the key "truth", or nothing.
        verdict: in a sentence, or "".
    """

    rows: PosturePlan | Measurements
    nominal: Nominal
    plates: np.ndarray
    board: PlateGeometry
    cells: np.ndarray
    top_height: np.ndarray
    com: dict[str, np.ndarray]
    polygons: list[np.ndarray]
    margin: np.ndarray
    least_margin: float | None
    command: np.ndarray | None = None
    cell_forces: np.ndarray | None = None
    foot_loads: np.ndarray | None = None
    load_points: np.ndarray | None = None
    cop: np.ndarray | None = None
    weight: float = np.nan
    true_masses: dict[str, np.ndarray] = field(default_factory=dict)
    verdict: str = ""
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def measurements(self) -> Measurements | None:
        return self.rows if isinstance(self.rows, Measurements) else None

    @property
    def sensors_in_feet(self) -> bool:
        """Return whether the feet stand on the ground, not on plates."""
        return self.measurements is not None and not self.measurements.on_plates

    @property
    def residual(self) -> np.ndarray | None:
        """CoP minus the estimate's CoM (eq. 12), (m, 2) [m]."""
        if self.cop is None or "estimate" not in self.com:
            return None
        return self.cop - self.com["estimate"]


def planned(plan: PosturePlan, robot: Robot) -> Subject:
    """Return the subject of a plan: the nominal robot in the planned postures."""
    board = nominal_plates(robot)[0]
    return _subject(
        plan,
        nominal_robot(robot, "mixed"),
        plates=boards_under(preset_rig("ideal", robot), plan.foot_poses),
        cells=np.array([board.cells, board.cells]),
        top_height=np.full(2, board.top_height),
    )


def measured(measurements: Measurements, robot: Robot, source: str = "measurements") -> Subject:
    """Return the subject of measurements of a source, with the estimate if the data allow one."""
    model = measurements.robot
    check_model(f"{source}: manifest.json", model["model"], model["sha256"], robot)
    subject = of_measurements(measurements, robot, source)
    try:
        own = identify(measurements, robot, source)
    except InputError as error:
        return replace(subject, notes=(f"No estimate: {error}.",))
    estimated = replace(subject.nominal, parameters=own.parameters, value=own.full.value)
    com = estimated.center_of_mass(measurements.joint_angles, measurements.support)
    note = f"Estimate: full model, {DEFAULT_ESTIMATOR}."
    return replace(subject, com=subject.com | {"estimate": com}, notes=(note,))


def validated(run: Validation) -> Subject:
    """Return the subject of a validation: measurements, the estimate that was judged, and the truth."""
    measurements, own = run.measurements, run.identification
    subject = of_measurements(measurements, run.robot)
    estimated = nominal_robot(run.robot, common_support(measurements.support))
    estimated = replace(estimated, parameters=own.parameters, value=own.full.value)
    com = {"estimate": estimated.center_of_mass(measurements.joint_angles, measurements.support)}
    notes = [f"Estimate: full model, {own.estimator}."]
    if run.simulation.com is None:
        notes.append(NO_TRUE_COM)
    else:
        com["truth"] = run.simulation.com
    failed = [check.name for check in run.checks if check.result == "fail"]
    verdict = f"Verdict: {run.verdict}" + (f" ({', '.join(failed)})" if failed else "")
    return replace(
        subject,
        com=subject.com | com,
        true_masses={"truth": run.simulation.standard},
        verdict=verdict + ".",
        notes=tuple(notes),
    )


def of_measurements(measurements: Measurements, robot: Robot, source: str = "measurements") -> Subject:
    """Return the subject of measurements without an estimate."""
    nominal = nominal_robot(robot, "mixed")
    if measurements.joints != nominal.parameters.tree.joints:
        raise InputError(f"{source}: found other joints than those of {robot.model_file.name}")
    seen = observe(measurements, nominal)
    cop = contact_pressure(seen).center
    down, points = seen.foot_loads
    return _subject(
        measurements,
        nominal,
        cop,
        plates=seen.contact_poses,
        cells=measurements.cells,
        top_height=measurements.top_height,
        command=measurements.command,
        cell_forces=measurements.cell_forces if measurements.contacts is None else None,
        foot_loads=down,
        load_points=points,
        weight=nominal.mass * measurements.gravity,
    )


def _subject(
    rows: PosturePlan | Measurements, nominal: Nominal, cop: np.ndarray | None = None, **more: Any
) -> Subject:
    """Return the subject of postures with the hulls of the soles that carry the robot."""
    com = nominal.center_of_mass(rows.joint_angles, rows.support)
    soles = nominal.geometry(rows.joint_angles, rows.support).soles
    carrying = zip(soles, feet_in_contact(rows.support), strict=True)
    polygons = [support_polygon(feet[on]) for feet, on in carrying]
    judged = zip(com if cop is None else cop, polygons, strict=True)
    return Subject(
        rows=rows,
        nominal=nominal,
        board=nominal_plates(nominal.robot)[0],
        com={"nominal model": com},
        polygons=polygons,
        margin=np.array([stability_margin(point, polygon) for point, polygon in judged]),
        least_margin=nominal.robot.settings.get("planning", {}).get("stability_margin"),
        cop=cop,
        **more,
    )
