"""The page of any result; those of a Monte Carlo, a prediction and an atlas are made here."""

from pathlib import Path

from tulip_testbed.base.files import new_folder, write_bytes, write_text
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import write_json
from tulip_testbed.experiments.atlases.atlas_result import LEGEND as ATLAS_LEGEND
from tulip_testbed.experiments.atlases.atlas_result import PAGE as ATLAS_PAGE
from tulip_testbed.experiments.atlases.atlas_result import Atlas, atlas_tables, closing, opening
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.montecarlo.coverage import LEGEND, ParameterCoverage, coverage_table
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, RATIO, coverage_check_table
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.saved_runs import RunResult
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.pages import figures as drawn
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, html, imperfections_fact, title_of
from tulip_testbed.pages.pictures import planned_pictures
from tulip_testbed.pages.validation_page import validation_page


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


def montecarlo_page(run: MonteCarlo) -> Page:
    missing: list[str] = []
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
        Section("Postures", pictures=planned_pictures(run.robot, run.plan, missing)),
        how_it_was_made(run.document),
    )
    facts = (
        ("sensors", run.document.configuration.preset),
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
