"""The page of any result; all but those of a discovery and a protocol are made here."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tulip_testbed.base.files import new_folder, write_bytes, write_text
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import write_json
from tulip_testbed.experiments.atlases.atlas_result import LEGEND as ATLAS_LEGEND
from tulip_testbed.experiments.atlases.atlas_result import PAGE as ATLAS_PAGE
from tulip_testbed.experiments.atlases.atlas_result import Atlas, atlas_tables, closing, opening
from tulip_testbed.experiments.correlations import NO_CORRELATION
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.montecarlo.coverage import LEGEND, ParameterCoverage, coverage_table
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, RATIO, coverage_check_table
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.parameter_tables import LEGEND as PARAMETER_LEGEND
from tulip_testbed.experiments.parameter_tables import models
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.saved_runs import RunResult
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
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, html, imperfections_fact, title_of
from tulip_testbed.pages.pictures import posture_pictures
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene import boards_under, nominal_plates

POLYGONS = 6  # how many placements are drawn
POLYGON_WORDS = (
    "View from above, as in the paper's Fig. 2 (x points up, y to the left): plates light blue, the support "
    "polygon of a placement's first posture orange, the CoP of all its postures as vermilion dots, the true "
    "CoM as green crosses. Below, some postures as in the paper's Fig. 3."
)


def page_of(run: RunResult | Prediction) -> Page:
    if isinstance(run, Prediction):
        return prediction_page(run)
    if isinstance(run, Discovered):
        return discovery_page(run)
    return validation_page(run) if isinstance(run, Validation) else montecarlo_page(run)


def write_page(path: Path, run: RunResult | Prediction) -> Page:
    """Write the page of a prediction or a run as one new HTML file, which appears whole, and return it."""
    page = page_of(run)
    write_bytes(path, html(page).encode(), new=True)
    return page


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
            (f"Estimator: {own.estimator}. {PARAMETER_LEGEND}",),
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
            figures=tuple(_polygons(nominal, measured, poses, com)),
            pictures=posture_pictures(robot, measured, poses, missing),
        ),
        how_it_was_made(run.document),
    )
    mass, error = own.mass
    facts = (
        ("sensors", str(run.document.configuration.get("preset"))),
        ("seed", str(run.document.configuration.get("seed"))),
        ("estimator", own.estimator),
        *imperfections_fact(run.imperfections),
        ("postures used", f"{run.postures_used} of {run.postures_planned}"),
        ("total mass, kg", f"{mass:.3f}, s.e. {error:.3f} (truth {run.true_mass:.3f})"),
    )
    return Page(title_of(run), run.verdict, "\n".join(run.answers), facts, sections, tuple(missing))


def _polygons(
    nominal: Nominal, measured: Measurements, poses: np.ndarray, com: np.ndarray | None
) -> Iterator[Figure]:
    robot = nominal.robot
    soles = nominal_robot(robot, "mixed").geometry(measured.joint_angles, measured.support).soles
    carrying, cop = feet_in_contact(measured.support), contact_pressure(observe(measured, nominal)).center
    placements, board = np.unique(measured.placement), nominal_plates(robot)[0].corners
    for placement in placements[np.unique(np.linspace(0, len(placements) - 1, POLYGONS).astype(int))]:
        rows = np.flatnonzero(measured.placement == placement)
        polygon = support_polygon(soles[rows[0]][carrying[rows[0]]])
        points = {"CoP": cop[rows]} | ({} if com is None else {"CoM, truth": com[rows]})
        yield drawn.support_polygon_figure(int(placement), poses[rows[0]], polygon, points, board)


def montecarlo_page(run: MonteCarlo) -> Page:
    missing: list[str] = []
    boards = boards_under(preset_rig("ideal", run.robot), run.plan.foot_poses)
    rows = {model: of.parameters for model, of in run.models.items()}
    tables = tuple(coverage_table(*of) for of in rows.items())
    figures: tuple[Figure, ...] = ()
    if run.identified > 1:
        errors = run.errors_mm
        figures = (
            *_coverage_figures(rows),
            *(drawn.error_boxes(m, [row.number for row in rows[m]], errors[m]) for m in rows),
        )
    sections = (
        Section("Checks", tables=(coverage_check_table(run.checks),)),
        Section("Coverage", (LEGEND, *run.lines()), (), figures[:3]),
        Section("Errors", figures=figures[3:]),
        Section("Parameters", tables=tables),
        Section("Postures", pictures=posture_pictures(run.robot, run.plan, boards, missing)),
        how_it_was_made(run.document),
    )
    facts = (
        ("sensors", str(run.document.configuration.get("preset"))),
        ("seed", str(run.document.settings.seed)),
        ("estimator", run.estimator),
        *imperfections_fact(run.imperfections),
        ("runs identified", f"{run.identified} of {run.runs}"),
        ("postures planned", str(len(run.plan))),
    )
    return Page(title_of(run), run.verdict, "\n".join(run.answers), facts, sections, tuple(missing))


def _coverage_figures(rows: dict[str, list[ParameterCoverage]]) -> tuple[Figure, ...]:
    def of(name: str) -> dict[str, list[tuple[int, float, list[float]]]]:
        return {
            model: [(row.number, getattr(row, name), getattr(row, f"{name}_interval")) for row in found]
            for model, found in rows.items()
        }

    bias = {}
    for model, found in rows.items():
        relative = [(row.bias / row.standard_error, row.bias_mc_error / row.standard_error) for row in found]
        ends = [(middle, [middle - 1.96 * error, middle + 1.96 * error]) for middle, error in relative]
        bias[model] = [(row.number, *both) for row, both in zip(found, ends, strict=True)]
    ratio = "Standard error found over stated.", "found over stated", of("standard_error_ratio"), 1, RATIO
    covered = "Coverage of 95 % intervals.", "coverage", of("coverage95"), 0.95, COVERAGE
    return (
        drawn.with_intervals("ratio", *ratio),
        drawn.with_intervals("coverage", *covered),
        drawn.with_intervals("bias", "Bias over stated standard error.", "bias over s.e.", bias, 0, BIAS),
    )


def prediction_page(found: Prediction) -> Page:
    """Make the page of a prediction: how far every model is off on postures that took no part."""
    shown = found.tables()
    tables = tuple(one for one in shown if isinstance(one, Table))
    notes = tuple(one for one in shown if isinstance(one, str) and one != found.verdict)
    models = list(dict.fromkeys(one.name for one in found.models))
    figures = []
    for split in dict.fromkeys(one.split for one in found.models):
        of_split = [one for one in found.models if one.split == split]
        rows: dict[str, dict[str, tuple[float, tuple[float | None, float | None]]]] = {}
        for axis in "xy":
            ends = [(getattr(one.low95, axis, None), getattr(one.high95, axis, None)) for one in of_split]
            values = [getattr(one.rms_mm, axis) for one in of_split]
            rows[axis] = dict(
                zip((one.name for one in of_split), zip(values, ends, strict=True), strict=True)
            )
        figures.append(drawn.error_bars(split, rows))
    facts = (("models", str(len(models))), ("splits", ", ".join(one.name for one in figures)))
    sections = (
        Section("Errors of the models", figures=tuple(figures)),
        Section(tables[0].title, notes, tables),
    )
    return Page("Prediction of the centre of pressure", "", found.verdict, facts, sections)


def write_atlas(folder: Path, found: Atlas) -> None:
    """Write the folder, which appears whole or not at all."""
    with new_folder(folder) as working:
        write_json(working / "atlas.json", found.to_json())
        write_text(working / ATLAS_PAGE, html(atlas_page(found)))


def atlas_page(found: Atlas) -> Page:
    """Make the page of all effects, with a box to search them."""
    facts = (("sensors", found.preset), ("seed", str(found.seed)))
    sections = [Section(table.title, tables=(table,)) for table in atlas_tables(found)]
    return Page(
        f"{found.robot}: atlas",
        "",
        f"{opening(found)} {closing(found)}",
        facts,
        tuple(sections),
        story=(ATLAS_LEGEND,),
        searched=True,
    )
