"""The page of a validation."""

import numpy as np

from tulip_testbed.base.table import Table
from tulip_testbed.experiments.correlations import NO_CORRELATION
from tulip_testbed.experiments.parameter_tables import LEGEND, models
from tulip_testbed.experiments.validate import correlations_at
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.identification.base_parameters import common_support, renumbered
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.feasibility import support_polygon
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.pages import NO_TRUE_COM
from tulip_testbed.pages import figures as drawn
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, imperfections_fact, title_of
from tulip_testbed.pages.pictures import posture_pictures
from tulip_testbed.sim.scene import nominal_plates

POLYGONS = 6  # how many placements are drawn
POLYGON_WORDS = (
    "View from above, as in the paper's Fig. 2 (x points up, y to the left): plates light blue, the support "
    "polygon of a placement's first posture orange, the CoP of all its postures as vermilion dots, the true "
    "CoM as green crosses. Below, some postures as in the paper's Fig. 3."
)


def validation_page(run: Validation) -> Page:
    robot, measured, own = run.robot, run.measurements, run.identification
    estimates = {model: getattr(own, model) for model in models(robot)}
    missing: list[str] = []
    norms = {model: 1e3 * estimate.residual_norms for model, estimate in estimates.items()}
    errors = {
        model: (
            estimate.numbers.tolist(),
            (estimate.value - run.truth[estimate.numbers - 1]) / estimate.standard_error,
        )
        for model, estimate in estimates.items()
    }
    pairs = [
        (renumbered(robot, own.parameters, entry["pair"]), entry["joint"])
        for entry in robot.settings.get("correlated", [])
    ]
    matrix = correlations_at(own.parameters, measured.joint_angles, measured.support)
    high = tuple(one for one in map(run.correlation_table, estimates) if isinstance(one, Table))
    com, nominal = run.simulation.com, nominal_robot(robot, common_support(measured.support))
    poses = observe(measured, nominal).contact_poses  # of plates, or of soles with sensors in the feet
    dropped = f"All {run.postures_planned} planned postures could be measured."
    if run.dropped:
        reasons = "; ".join(f"{one.posture}: {one.reason}" for one in run.dropped)
        dropped = f"Dropped {len(run.dropped)} of {run.postures_planned} postures. {reasons}."
    sections = (
        Section("Checks", tables=(run.table(),)),
        Section(
            "Parameters",
            (f"Estimator: {own.estimator}. {LEGEND}",),
            tuple(map(run.parameter_table, estimates)),
            (drawn.errors_over_se(errors),),
        ),
        Section(
            "Residuals",
            (str(own.constant),),
            figures=(drawn.residual_norms(measured.posture, measured.placement, norms),),
        ),
        Section(
            "Correlations", () if high else (NO_CORRELATION,), high, (drawn.correlation_map(matrix, pairs),)
        ),
        Section(
            "Postures",
            (dropped, POLYGON_WORDS, *([NO_TRUE_COM] if com is None else [])),
            figures=_polygons(nominal, measured, poses, com),
            pictures=posture_pictures(robot, measured, poses, missing),
        ),
        how_it_was_made(run.document),
    )
    mass, error = own.mass
    facts = (
        ("sensors", run.document.configuration.preset),
        ("seed", str(run.document.configuration.seed)),
        ("estimator", own.estimator),
        *imperfections_fact(run.imperfections),
        ("postures used", f"{run.postures_used} of {run.postures_planned}"),
        ("total mass, kg", f"{mass:.3f}, s.e. {error:.3f} (truth {run.true_mass:.3f})"),
    )
    return Page(title_of(run), run.verdict, "\n".join(run.answers), facts, sections, tuple(missing))


def _polygons(
    nominal: Nominal, measured: Measurements, poses: np.ndarray, com: np.ndarray | None
) -> tuple[Figure, ...]:
    robot = nominal.robot
    soles = nominal_robot(robot, "mixed").geometry(measured.joint_angles, measured.support).soles
    carrying, cop = feet_in_contact(measured.support), contact_pressure(observe(measured, nominal)).center
    placements, board, drawings = np.unique(measured.placement), nominal_plates(robot)[0].corners, []
    for placement in placements[np.unique(np.linspace(0, len(placements) - 1, POLYGONS).astype(int))]:
        rows = np.flatnonzero(measured.placement == placement)
        polygon = support_polygon(soles[rows[0]][carrying[rows[0]]])
        points = {"CoP": cop[rows]} | ({} if com is None else {"CoM, truth": com[rows]})
        drawings.append(drawn.support_polygon_figure(int(placement), poses[rows[0]], polygon, points, board))
    return tuple(drawings)
