"""Tables of a Monte Carlo."""

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.experiments.montecarlo.coverage import ParameterCoverage
from tulip_testbed.experiments.montecarlo.coverage_verdict import BIAS, COVERAGE, LEVEL, RATIO, CoverageCheck

LEGEND = (
    "bias: mean error; its s.e.: by the number of runs; stated s.e.: by the estimator; found s.e.: s.d. of "
    "the errors over the runs; coverage: share of the runs whose 95 % intervals hold the truth. "
    "Intervals are of 95 % for every single number; those of the checks are wider, since they hold for all "
    "at once."
)


def coverage_table(model: str, rows: list[ParameterCoverage]) -> Table:
    """Return bias, standard errors and coverage of a model's parameters.

    Args:
        model: "full" or "simplified". rows: its parameters.
    """
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("bias", "mm", "+.3f", 1e3),
        Column("s.e. of bias", "mm", ".3f", 1e3),
        Column("stated s.e.", "mm", ".3f", 1e3),
        Column("found s.e.", "mm", ".3f", 1e3, extra=True),
        Column("found over stated", "", ".3f"),
        Column("its interval", "", ".2f", extra=True),
        Column("coverage of 95 %", "%", ".1f", 100),
        Column("its 95 % interval", "%", ".1f", 100, extra=True),
    )
    names = (
        *("number", "name", "bias", "bias_mc_error", "standard_error", "empirical_standard_error"),
        *("standard_error_ratio", "standard_error_ratio_interval"),
        *("coverage95", "coverage95_interval"),
    )
    path = "parameters" if model == "full" else f"{model}.parameters"
    lines = [[Cell(getattr(row, name), f"{path}.{k}.{name}") for name in names] for k, row in enumerate(rows)]
    return Table(f"{model.capitalize()} model", columns, lines)


def coverage_check_table(checks: list[CoverageCheck]) -> Table:
    """Return the checks of the verdict."""
    columns = (
        Column("check"),
        Column("result"),
        Column("worst no.", format="d"),
        Column("value", format=".4f"),
        Column("interval", format=".4f"),
        Column("bounds", format=".2g"),
        Column("beyond, no.", extra=True),
        Column("where the bounds come from", extra=True),
    )
    rows = []
    for k, check in enumerate(checks):
        name, *others = (
            Cell(getattr(check, key), f"checks.{k}.{key}")
            for key in ("name", "number", "value", "interval", "bounds", "beyond", "source")
        )
        result = check.result if check.shown or check.result != "pass" else "inconclusive"
        rows.append([name, Cell(result, mark=result), *others])
    note = (
        f"Bounds: bias within {BIAS[1]:g} s.e., found over stated s.e. {RATIO[0]:g} to {RATIO[1]:g}, "
        f"coverage {100 * COVERAGE[0]:g} to {100 * COVERAGE[1]:g} %. Judged are the errors that "
        "are left if imperfections which the data do not show were known. An estimator inside of the bounds "
        f"fails with a probability below {100 * LEVEL:g} %. Pass: the runs show it, by intervals "
        "wholly inside of the bounds; inconclusive: some still reach beyond them."
    )
    return Table("Checks", columns, rows, note)
