"""The page of a Monte Carlo."""

from __future__ import annotations

from tulip_testbed.experiments.montecarlo.coverage import ParameterCoverage
from tulip_testbed.experiments.montecarlo.coverage_tables import (
    LEGEND,
    coverage_check_table,
    coverage_lines,
    coverage_table,
)
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, RATIO
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.pages import figures as drawn
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, imperfections_fact, title_of
from tulip_testbed.pages.pictures import planned_pictures


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
    sections = (
        Section("Checks", tables=(coverage_check_table(content["checks"]),)),
        Section("Coverage", (LEGEND, *coverage_lines(content)), (), figures[:3]),
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
