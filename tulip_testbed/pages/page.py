"""Make the HTML page of a run."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image

from tulip_testbed.base.column import printable
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.checks import check_table
from tulip_testbed.experiments.correlation_table import NO_CORRELATION, correlation_table
from tulip_testbed.experiments.estimate_report import ModelReport
from tulip_testbed.experiments.montecarlo.coverage import ParameterCoverage
from tulip_testbed.experiments.montecarlo.coverage_tables import (
    coverage_check_table,
    coverage_table,
    spread_table,
)
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, RATIO
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.parameter_tables import models, parameter_table, read_reported
from tulip_testbed.experiments.records import Record
from tulip_testbed.experiments.settings_table import settings_tables
from tulip_testbed.experiments.validate import correlations_at
from tulip_testbed.experiments.validation_record import ValidationRecord
from tulip_testbed.identification.base_parameters import base_parameters, common_support, renumbered
from tulip_testbed.identification.contact_pressure import contact_pressure
from tulip_testbed.identification.feasibility import support_polygon
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.pages import figures as drawn
from tulip_testbed.pages import words
from tulip_testbed.pages.figures import Figure
from tulip_testbed.rendering import rendered
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.scene import boards_under, nominal_plates
from tulip_testbed.standing import soles_in_base

TEMPLATE = "page.html.j2"
POLYGONS, PICTURES = 6, 4  # how many placements and postures are drawn
SIZE = (360, 480)  # pixels, of a picture
COLOURS = 128  # of a picture, which then takes a third of the space


@dataclass(frozen=True)
class Picture:
    """A drawn posture as a data address, with its description."""

    address: str
    caption: str
    text: str


@dataclass(frozen=True)
class Section:
    """A section of the page; empty parts are left out.

    Attributes:
        folded: a heading and a preformatted text or a table, which a click unfolds.
    """

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    pictures: tuple[Picture, ...] = ()
    folded: tuple[tuple[str, str | Table], ...] = ()


@dataclass(frozen=True)
class Page:
    """The whole page.

    Attributes:
        verdict: "pass" or "fail", or a discovery's; "": there is none. sentence: its meaning.
        story: further sentences about the verdict.
        missing: one sentence for each picture that could not be drawn.
        searched: whether there is a box that searches the rows of the tables.
    """

    title: str
    verdict: str
    sentence: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    missing: tuple[str, ...] = field(default=())
    story: tuple[str, ...] = field(default=())
    searched: bool = False


def html(page: Page) -> str:
    """Return the page as one HTML file that loads nothing from the network."""
    figures = [figure for section in page.sections for figure in section.figures]
    return filled(TEMPLATE, page=page, figures=figures, plotly=Markup(drawn.plotly_script()), script=Markup)


def filled(template: str, **content: Any) -> str:
    """Fill in a template of this package; the content is escaped, unless it is `Markup`."""
    text = files("tulip_testbed.pages").joinpath(template).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=shown_value,
    )
    return environment.from_string(text).render(**content)


def shown_value(value: Any) -> Any:
    """Return a value without control characters, which a name or a text of a file may hold."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return "\n".join(map(printable, value.split("\n")))


def title_of(run: Record) -> str:
    """Return the title of a run's page; a run in memory has no name of its own."""
    name = "" if run.folder is None else f" {run.folder.resolve().name}"
    return f"{run.robot.name}: {run.kind}{name}"


def validation_page(run: ValidationRecord) -> Page:
    """Make the page of a validation."""
    report, content, robot, measured = run.report, run.report.plain(), run.robot, run.measurements
    parameters = base_parameters(robot, support=common_support(measured.support))
    paper = read_reported(robot)
    shown = models(robot)
    missing: list[str] = []
    com = run.truth.com
    plain = content["least_squares"] or {}
    tables = [
        parameter_table(model, content[model], parameters, paper, least_squares=plain.get(model))
        for model in shown
    ]
    norms = {model: run.residual_mm[model] for model in shown}
    means = {model: report.models[model].residual_mm.mean for model in shown}
    z = {model: _z(report.models[model]) for model in shown}
    pairs = [
        (renumbered(robot, parameters, entry["pair"]), entry["joint"])
        for entry in robot.settings.get("correlated", [])
    ]
    matrix = correlations_at(parameters, measured.joint_angles, measured.support)
    high = tuple(
        correlation_table(
            model, pairs_of_model, parameters, measured.joint_angles, "least_squares." if plain else ""
        )
        for model in shown
        if (pairs_of_model := plain.get(model, content[model])["correlations"])
    )
    sections = (
        Section("Checks", tables=(check_table(content["checks"]),)),
        Section("Parameters", words.parameter_words(content), tuple(tables), (drawn.errors_over_se(z),)),
        Section(
            "Residuals",
            figures=(drawn.residual_norms(measured.posture, measured.placement, norms, means),),
        ),
        Section(
            "Correlations", () if high else (NO_CORRELATION,), high, (drawn.correlation_map(matrix, pairs),)
        ),
        Section(
            "Postures",
            (words.dropped(content), words.POLYGON_WORDS, *([words.NO_TRUE_COM] if com is None else [])),
            figures=_polygons(robot, measured, com),
            pictures=_pictures(robot, measured, _contact_poses(robot, measured), missing),
        ),
        how_it_was_made(run),
    )
    mass = report.total_mass
    facts = (
        ("sensors", run.document.configuration.preset),
        ("seed", str(run.document.configuration.seed)),
        ("estimator", report.estimator),
        *_imperfections_fact(report.imperfections),
        ("postures used", f"{report.postures_used} of {report.postures_planned}"),
        ("total mass, kg", f"{mass.estimate:.3f} ± {mass.standard_error:.3f} (truth {mass.truth:.3f})"),
    )
    return Page(
        title_of(run), report.verdict, words.validation_sentence(report), facts, sections, tuple(missing)
    )


def montecarlo_page(run: MonteCarlo) -> Page:
    """Make the page of a Monte Carlo."""
    content = run.to_json()
    missing: list[str] = []
    rows = {model: of.parameters for model, of in run.models.items()}
    places = {"full": content, "simplified": content["simplified"]}
    tables = tuple(coverage_table(model, places[model]["parameters"]) for model in rows)
    figures: tuple[Figure, ...] = ()
    if run.identified > 1:
        errors = run.errors_mm
        figures = (
            *_coverage_figures(rows),
            *(drawn.error_boxes(m, [row.number for row in rows[m]], errors[m]) for m in rows),
        )
    size = len(run.plan)
    chosen = np.unique(np.linspace(0, size - 1, PICTURES).astype(int))
    sections = (
        Section("Checks", tables=(coverage_check_table(content["checks"]),)),
        Section("Coverage", words.coverage_words(content), (), figures[:3]),
        Section("Errors", figures=figures[3:]),
        Section("Parameters", tables=(*tables, spread_table(content))),
        Section("Postures", pictures=_planned_pictures(run.robot, run.plan, chosen, missing)),
        how_it_was_made(run),
    )
    facts = (
        ("sensors", run.document.configuration.preset),
        ("seed", str(run.document.settings.seed)),
        ("estimator", run.estimator),
        *_imperfections_fact(run.imperfections),
        ("runs identified", f"{run.identified} of {run.runs}"),
        ("postures planned", str(size)),
    )
    return Page(title_of(run), run.verdict, words.montecarlo_sentence(run), facts, sections, tuple(missing))


def how_it_was_made(run: Record) -> Section:
    """Return the folded section of a run's settings."""
    tables = settings_tables(run.document.plain())
    return Section("How it was made", folded=tuple((f"{t.title} ({len(t.rows)} values)", t) for t in tables))


def _imperfections_fact(scale: float) -> tuple[tuple[str, str], ...]:
    return (("imperfections", f"scale {scale:g}" if scale else "none: an exact laboratory"),)


def _coverage_figures(rows: dict[str, list[ParameterCoverage]]) -> tuple[Figure, ...]:
    def of(name: str) -> dict[str, list[tuple[int, float, list[float]]]]:
        return {
            model: [(row.number, getattr(row, name), getattr(row, f"{name}_interval")) for row in found]
            for model, found in rows.items()
        }

    bias = {model: [(row.number, *_relative_bias(row)) for row in found] for model, found in rows.items()}
    return (
        drawn.with_intervals(
            "ratio",
            "Standard error found over stated.",
            "found over stated",
            of("standard_error_ratio"),
            1,
            RATIO,
        ),
        drawn.with_intervals(
            "coverage", "Coverage of 95 % intervals.", "coverage", of("coverage95"), 0.95, COVERAGE
        ),
        drawn.with_intervals("bias", "Bias over stated standard error.", "bias over s.e.", bias, 0, BIAS),
    )


def _relative_bias(row: ParameterCoverage) -> tuple[float, list[float]]:
    middle = row.bias / row.standard_error
    half = 1.96 * row.bias_mc_error / row.standard_error
    return middle, [middle - half, middle + half]


def _z(model: ModelReport) -> tuple[list[int], np.ndarray]:
    rows = model.parameters
    estimate, truth, error = np.array(
        [(row.estimate, row.truth, row.standard_error) for row in rows], float
    ).T
    return [row.number for row in rows], (estimate - truth) / error


def _polygons(robot: Robot, measured: Measurements, com: np.ndarray | None) -> tuple[Figure, ...]:
    soles = soles_in_base(nominal_robot(robot), measured.joint_angles, measured.support)
    nominal = nominal_robot(robot, common_support(measured.support))
    carrying, cop = feet_in_contact(measured.support), contact_pressure(measured, nominal).center
    placements, poses = np.unique(measured.placement), _contact_poses(robot, measured)
    board = nominal_plates(robot)[0].size
    found = []
    for placement in placements[np.unique(np.linspace(0, len(placements) - 1, POLYGONS).astype(int))]:
        rows = np.flatnonzero(measured.placement == placement)
        feet = soles[rows[0]][carrying[rows[0]]]
        points = {"CoP": cop[rows]} | ({} if com is None else {"CoM, truth": com[rows]})
        plates = poses[rows[0]]
        found.append(
            drawn.support_polygon_figure(int(placement), plates, support_polygon(feet), points, board)
        )
    return tuple(found)


def _contact_poses(robot: Robot, measured: Measurements) -> np.ndarray:
    """Poses of the plates, or of the soles where the sensors are in the feet, (m, 2, 3) [m, m, rad]."""
    return observe(measured, nominal_robot(robot, common_support(measured.support))).contact_poses


def _pictures(
    robot: Robot, postures: Measurements | PosturePlan, plates: np.ndarray, missing: list[str]
) -> tuple[Picture, ...]:
    """Draw postures spread over the experiment; a reason not to draw them is added to `missing`."""
    rows = np.unique(np.linspace(0, len(postures) - 1, PICTURES).astype(int))
    try:
        drawings = rendered(robot, postures.joint_angles[rows], postures.support[rows], plates[rows], *SIZE)
    except InputError as error:
        missing.append(f"Pictures of postures: {error}.")
        return ()
    names = [f"Posture {postures.posture[k]}, placement {postures.placement[k]}" for k in rows]
    return tuple(
        Picture(
            "data:image/png;base64," + base64.b64encode(png(drawing)).decode(),
            name,
            f"The robot on its two plates: {name}.",
        )
        for name, drawing in zip(names, drawings, strict=True)
    )


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).quantize(COLOURS).save(file, "PNG", optimize=True)
    return file.getvalue()


def _planned_pictures(
    robot: Robot, plan: PosturePlan, chosen: np.ndarray, missing: list[str]
) -> tuple[Picture, ...]:
    shown = plan.take(chosen)
    boards = boards_under(preset_rig("ideal", robot), shown.foot_poses)
    return _pictures(robot, shown, boards, missing)
