"""Results of discovery in an ordinary world: shares with exact intervals, and wrong results."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.benchmark.case_outcome import Outcome
from tulip_testbed.experiments.benchmark.cases import OUTSIDE_ARM
from tulip_testbed.experiments.benchmark.ordinary_cases import CLEAR, NOTHING, PRIOR, SCATTER, TWICE
from tulip_testbed.experiments.benchmark.score import (
    Figure,
    exactly,
    median,
    open_said,
    rate,
    right,
    wrong,
)

ARMS = {
    NOTHING: "nothing hidden",
    PRIOR: "one effect, its size from the prior",
    CLEAR: "one effect, clear",
    TWICE: "two effects of one kind, clear",
    OUTSIDE_ARM: "a fault outside the catalogue",
    SCATTER: "nothing hidden, plates scatter unlike their data sheet",
}


def ordinary_figures(outcomes: Sequence[Outcome]) -> list[Figure]:
    """Return all figures of one preset, of statics or of dynamics."""

    def of(arm: str, keep: Callable[[Outcome], bool] = lambda o: True) -> list[Outcome]:
        return [o for o in outcomes if o.arm == arm and not o.failed and keep(o)]

    shown = of(PRIOR, shows)
    done = [o for o in outcomes if not o.failed]
    imperfect = [o for o in done if o.imperfect]
    isolable = of(CLEAR, lambda o: o.isolable)
    return [
        rate("nothing hidden: wrongly named", map(wrong, of(NOTHING)), most=0.03),
        rate(
            "nothing hidden: `calibrated` or `none`",
            (o.verdict in ("calibrated", "none") for o in of(NOTHING)),
        ),
        rate(
            "ordinary imperfections: 95 % intervals hold",
            (c for o in imperfect for c in o.members),
            0.92,
            0.98,
        ),
        rate(
            "base parameters: 95 % intervals hold",
            (c for o in done if _trusted(o) for c in o.base),
            0.93,
            0.98,
        ),
        rate("sizes from the prior: right first, of those that show", map(right, shown), least=0.9),
        rate("sizes from the prior: a gap is seen", (o.flagged for o in of(PRIOR))),
        rate("clear: right first, isolable", map(right, isolable), least=0.9),
        rate("clear: right first, all", map(right, of(CLEAR))),
        rate("clear: `named`, and exactly that", (o.verdict == "named" and exactly(o) for o in of(CLEAR))),
        rate("two of one kind: both found, nothing else", map(exactly, of(TWICE))),
        rate("intervals of the effects' sizes hold", (c for o in done for c in o.coverage), 0.9, 0.98),
        rate("outside: `unknown` or a law", map(open_said, of(OUTSIDE_ARM)), least=0.9),
        rate(
            "outside: `unknown` or a law, of those that show",
            (open_said(o) for o in of(OUTSIDE_ARM) if o.verdict not in ("none", "calibrated")),
            least=0.9,
        ),
        rate("scattering plates: false alarms", (o.flagged for o in of(SCATTER)), most=0.02),
        rate("wrong and confident, all arms", map(wrong, done), most=0.03),
        median("seconds of CPU, median", (o.cpu_s for o in done), most=10.0),
        rate("more than 60 s of CPU", (o.cpu_s > 60 for o in done), most=0.0),
        rate("cases without data", (bool(o.failed) for o in outcomes)),
    ]


def shows(o: Outcome) -> bool:
    """Whether anything shows the effect: a name, a gap without one, or it is the clearest imperfection."""
    return o.verdict in ("named", "described", "ambiguous", "unknown") or right(o)


def _trusted(o: Outcome) -> bool:
    """Whether the discovery says that the model is complete."""
    return o.verdict in ("none", "calibrated", "named", "described")


def verdict_table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """Return what was said, by arm and imperfections."""
    said = ("none", "calibrated", "named", "described", "ambiguous", "unknown")
    columns = (
        Column("arm"),
        Column("imperfect"),
        Column("cases", format="d"),
        *(Column(name, format="d") for name in (*said, "wrong name")),
    )
    rows = []
    for arm, sentence in ARMS.items():
        for imperfect in (False, True):
            some = [o for o in outcomes if o.arm == arm and o.imperfect == imperfect and not o.failed]
            if some:
                counts = [sum(o.verdict == name for o in some) for name in said]
                ordinary = "yes" if imperfect else "no"
                rows.append([sentence, ordinary, len(some), *counts, sum(map(wrong, some))])
    return Table(title, columns, rows)


def miss_table(outcomes: Sequence[Outcome]) -> Table:
    """Return every case with a wrong name, and every clear effect that did not come first."""
    columns = (Column("case", format="d"), *map(Column, ("hidden", "verdict", "said")))
    rows = []
    for o in outcomes:
        missed = o.arm in (CLEAR, TWICE) and not o.failed and not (right(o) if o.arm == CLEAR else exactly(o))
        if wrong(o) or missed or (o.arm == PRIOR and shows(o) and not right(o)):
            values = (*o.values, *[()] * (len(o.hidden) - len(o.values)))
            hidden = " + ".join(map(_with_values, o.hidden, values)) or "nothing"
            rows.append([o.run, hidden, o.verdict, " + ".join(o.names)])
    return Table("Wrong results", columns, rows)


def _with_values(label: str, values: Sequence[float]) -> str:
    sizes = [v for v in values if np.isfinite(v)]
    return label if not sizes else f"{label}={','.join(f'{v:.3g}' for v in sizes)}"
