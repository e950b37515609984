"""The benchmark's tables, as Markdown and as CSV files."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.effects.instance import split_label
from tulip_testbed.experiments.benchmark import cases as arms
from tulip_testbed.experiments.benchmark.case_outcome import Outcome
from tulip_testbed.experiments.benchmark.ordinary_tables import (
    miss_table,
    ordinary_figures,
    verdict_table,
)
from tulip_testbed.experiments.benchmark.score import Figure, figures, in_set, of, rate, right, wrong

SAID = (Column("verdicts"), Column("named"))


def demand(figure: Figure) -> tuple[float, float] | None:
    """Return what a figure must reach; None: no demand."""
    if figure.least is None and figure.most is None:
        return None
    least, most = figure.least, figure.most
    return (-np.inf if least is None else least, np.inf if most is None else most)


def shown(figure: Figure) -> tuple[float, float, float] | None:
    """Return value and interval; None without cases."""
    return (figure.value, figure.low, figure.high) if figure.count else None


def verdict(figure: Figure) -> str:
    """Return whether a figure is what it must be, and whether its interval leaves that open."""
    if figure.met is None:
        return ""
    least = -np.inf if figure.least is None else figure.least
    most = np.inf if figure.most is None else figure.most
    if figure.met:
        return "met, shown" if least <= figure.low and figure.high <= most else "met, not shown"
    return "missed, shown" if figure.high < least or figure.low > most else "missed, not shown"


def figure_table(title: str, found: Sequence[Figure]) -> Table:
    """Return every figure with what it must reach."""
    columns = (
        Column("figure"),
        Column("value (95 % interval)", format=".3g"),
        Column("cases", format="d"),
        Column("must be", format="g"),
        Column("verdict"),
    )
    rows = [[f.name, shown(f), f.count, demand(f), verdict(f)] for f in found if f.count]
    return Table(title, columns, rows)


def power_table(outcomes: Sequence[Outcome]) -> Table:
    """Return how often single effects are found, by multiples of the minimum detectable size."""
    columns = (
        Column("MDE", format="g"),
        Column("cases", format="d"),
        Column("predicted", format=".2f"),
        *(Column(n, format=".3g") for n in ("gap seen", "right name first", "in the set", "wrong name")),
    )
    rows = []
    single = of(outcomes, arms.SINGLE, lambda o: o.multiple in arms.MULTIPLES)
    for multiple in arms.MULTIPLES:
        some = [o for o in single if o.multiple == multiple]
        if some:
            hits = ([o.flagged for o in some], map(right, some), map(in_set, some), map(wrong, some))
            predicted = float(np.mean([o.predicted for o in some]))
            rows.append([multiple, len(some), predicted, *(shown(rate("", hit)) for hit in hits)])
    return Table("Power against the predicted minimum detectable size (MDE)", columns, rows)


def confusion(outcomes: Sequence[Outcome]) -> Counter[tuple[str, float, str, str]]:
    """Return counts by true kind, multiple, verdict and kind named first ("" for none)."""
    return Counter(
        (
            o.kinds[0],
            o.multiple if o.multiple in arms.MULTIPLES else max(arms.MULTIPLES),
            o.verdict,
            split_label(o.names[0])[0] if o.names else "",
        )
        for o in of(outcomes, arms.SINGLE)
    )


def confusion_table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """Return what single effects are taken for, by true kind, from 2 MDE on."""
    columns = (
        Column("hidden"),
        *(Column(name, format="d") for name in ("cases", "isolable", "right first", "in the set")),
        Column("verdicts"),
        Column("else named first"),
    )
    rows = []
    clear = of(outcomes, arms.SINGLE, lambda o: o.multiple >= 2)
    for kind in sorted({o.kinds[0] for o in clear}):
        some = [o for o in clear if o.kinds[0] == kind]
        others = Counter(
            f"{o.names[0]} for {split_label(o.hidden[0])[1] or kind}"
            for o in some
            if o.names and not right(o)
        )
        counts = (sum(o.isolable for o in some), sum(map(right, some)), sum(map(in_set, some)))
        rows.append([kind, len(some), *counts, _verdicts(some), _counted(others)])
    return Table(title, columns, rows)


def outside_table(outcomes: Sequence[Outcome]) -> Table:
    """Return what is said of faults outside the catalogue, by fault and size."""
    columns = (Column("fault"), Column("MDE", format="g"), Column("cases", format="d"), *SAID)
    rows = []
    outside = of(outcomes, arms.OUTSIDE_ARM)
    for kind, multiple in sorted({(o.kinds[0], o.multiple) for o in outside}):
        some = [o for o in outside if (o.kinds[0], o.multiple) == (kind, multiple)]
        rows.append([kind, multiple, len(some), _verdicts(some), _named(some)])
    return Table("Faults outside the catalogue", columns, rows)


def left_out_table(outcomes: Sequence[Outcome]) -> Table:
    """Return what is said of effects that were left out of the catalogue, by kind."""
    columns = (Column("left out"), Column("cases", format="d"), Column("with twins", format="d"), *SAID)
    rows = []
    left = of(outcomes, arms.LEFT_OUT)
    for kind in sorted({o.kinds[0] for o in left}):
        some = [o for o in left if o.kinds[0] == kind]
        twins = sum(not o.isolable for o in some)
        rows.append([kind, len(some), twins, _verdicts(some), _named(some)])
    return Table("Effects left out of the catalogue", columns, rows)


def _verdicts(outcomes: Sequence[Outcome]) -> str:
    return _counted(Counter(o.verdict for o in outcomes))


def _named(outcomes: Sequence[Outcome]) -> str:
    return _counted(Counter(" + ".join(o.names) for o in outcomes if o.said))


def _counted(counter: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counter.items()))


def csv_text(rows: Sequence[Sequence[object]]) -> str:
    """Return the same table for programs."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def tables(outcomes: Sequence[Outcome], world: str = arms.EXACT) -> list[Table]:
    """Return all tables that have a row; in an ordinary world the full dynamics comes first."""
    statics = [o for o in outcomes if not o.dynamics]
    dynamics = [o for o in outcomes if o.dynamics]
    if world == arms.ORDINARY:
        made = [
            figure_table("Figures, full dynamics", ordinary_figures(dynamics)),
            figure_table("Figures, static laboratory", ordinary_figures(statics)),
            verdict_table("Verdicts, full dynamics", dynamics),
            verdict_table("Verdicts, static laboratory", statics),
            miss_table(outcomes),
        ]
        return [table for table in made if table.rows]
    made = [
        figure_table("Figures, static laboratory", figures(statics)),
        figure_table("Figures, full dynamics", figures(dynamics)),
        power_table(statics),
        confusion_table("Single effects from 2 MDE on", statics),
        confusion_table("Single effects in full dynamics", dynamics),
        outside_table(statics),
        left_out_table(statics),
    ]
    return [table for table in made if table.rows]


def report_text(outcomes: Sequence[Outcome], world: str = arms.EXACT) -> str:
    """Return all tables as Markdown."""
    return "\n\n".join(f"### {table.title}\n\n{table.markdown()}" for table in tables(outcomes, world))


def files(outcomes: Sequence[Outcome], heading: str, world: str = arms.EXACT) -> dict[str, str]:
    """Return the names and contents of the files next to the cases."""
    power = power_table([o for o in outcomes if not o.dynamics])
    counted = sorted(confusion([o for o in outcomes if not o.dynamics]).items())
    cases = [
        (
            o.run,
            o.arm,
            "+".join(o.hidden),
            o.multiple,
            o.dynamics,
            o.isolable,
            o.verdict,
            "+".join(o.names),
            o.failed,
        )
        for o in outcomes
    ]
    of_exact_worlds = {
        "power.csv": csv_text([[c.heading for c in power.columns], *power.texts]),
        "confusion.csv": csv_text(
            [("hidden", "mde", "verdict", "named_first", "cases"), *((*key, count) for key, count in counted)]
        ),
    }
    return {
        "report.md": f"{heading}\n\n{report_text(outcomes, world)}\n",
        **(of_exact_worlds if world == arms.EXACT else {}),
        "cases.csv": csv_text(
            [("case", "arm", "hidden", "mde", "dynamics", "isolable", "verdict", "named", "failed"), *cases]
        ),
    }


def report_document(outcomes: Sequence[Outcome], world: str = arms.EXACT) -> dict[str, Any]:
    """For JSON."""
    parts = {"statics": False, "dynamics": True}
    of_world = ordinary_figures if world == arms.ORDINARY else figures
    return {
        "cases": len(outcomes),
        "figures": {
            part: [
                asdict(f) | {"met": f.met} for f in of_world([o for o in outcomes if o.dynamics == dynamics])
            ]
            for part, dynamics in parts.items()
        },
    }
