"""The benchmark's tables: Markdown for people, CSV for everybody else."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from tulip_testbed.effects.instance import split_label
from tulip_testbed.experiments.benchmark import cases as arms
from tulip_testbed.experiments.benchmark.outcome import Outcome
from tulip_testbed.experiments.benchmark.score import Figure, figures, in_set, of, rate, right, wrong

Rows = list[tuple[str, ...]]


def demand(figure: Figure) -> str:
    """What a figure must reach, as text."""
    if figure.least is not None and figure.most is not None:
        return f"{figure.least:g} to {figure.most:g}"
    if figure.least is not None:
        return f"at least {figure.least:g}"
    return f"at most {figure.most:g}" if figure.most is not None else ""


def shown(figure: Figure) -> str:
    """Value and interval."""
    if not figure.count:
        return "-"
    if not np.isfinite(figure.low):
        return f"{figure.value:.3g} (too few for an interval)"
    return f"{figure.value:.3g} ({figure.low:.2g} to {figure.high:.2g})"


def verdict(figure: Figure) -> str:
    """Whether a figure is what it must be, and whether its interval leaves that open."""
    if figure.met is None:
        return ""
    least = -np.inf if figure.least is None else figure.least
    most = np.inf if figure.most is None else figure.most
    if figure.met:
        return "met, shown" if least <= figure.low and figure.high <= most else "met, not shown"
    return "missed, shown" if figure.high < least or figure.low > most else "missed, not shown"


def figure_rows(found: Sequence[Figure]) -> Rows:
    """Of the main table."""
    rows: Rows = [("figure", "value (95 % interval)", "cases", "must be", "")]
    return rows + [(f.name, shown(f), str(f.count), demand(f), verdict(f)) for f in found if f.count]


def power_rows(outcomes: Sequence[Outcome]) -> Rows:
    """Against multiples of the minimum detectable size."""
    rows: Rows = [("MDE", "cases", "predicted", "gap seen", "right name first", "in the set", "wrong name")]
    single = of(outcomes, arms.SINGLE, lambda o: o.multiple in arms.MULTIPLES)
    for multiple in arms.MULTIPLES:
        some = [o for o in single if o.multiple == multiple]
        if some:
            shares = (
                shown(rate("", hits))
                for hits in (
                    [o.flagged for o in some],
                    map(right, some),
                    map(in_set, some),
                    map(wrong, some),
                )
            )
            predicted = f"{np.mean([o.predicted for o in some]):.2f}"
            rows.append((f"{multiple:g}", str(len(some)), predicted, *shares))
    return rows


def confusion(outcomes: Sequence[Outcome]) -> Counter[tuple[str, float, str, str]]:
    """Counts by true kind, multiple, verdict and kind named first ("" for none)."""
    return Counter(
        (
            o.kinds[0],
            o.multiple if o.multiple in arms.MULTIPLES else max(arms.MULTIPLES),
            o.verdict,
            split_label(o.names[0])[0] if o.names else "",
        )
        for o in of(outcomes, arms.SINGLE)
    )


def confusion_rows(outcomes: Sequence[Outcome]) -> Rows:
    """By true kind, from 2 MDE on."""
    rows: Rows = [
        ("hidden", "cases", "isolable", "right first", "in the set", "verdicts", "else named first")
    ]
    clear = of(outcomes, arms.SINGLE, lambda o: o.multiple >= 2)
    for kind in sorted({o.kinds[0] for o in clear}):
        some = [o for o in clear if o.kinds[0] == kind]
        others = Counter(
            f"{o.names[0]} for {split_label(o.hidden[0])[1] or kind}"
            for o in some
            if o.names and not right(o)
        )
        rows.append(
            (
                kind,
                str(len(some)),
                str(sum(o.isolable for o in some)),
                str(sum(map(right, some))),
                str(sum(map(in_set, some))),
                _counted(Counter(o.verdict for o in some)),
                _counted(others),
            )
        )
    return rows


def outside_rows(outcomes: Sequence[Outcome]) -> Rows:
    """By fault and size."""
    rows: Rows = [("fault", "MDE", "cases", "verdicts", "named")]
    outside = of(outcomes, arms.OUTSIDE_ARM)
    for kind, multiple in sorted({(o.kinds[0], o.multiple) for o in outside}):
        some = [o for o in outside if (o.kinds[0], o.multiple) == (kind, multiple)]
        named = Counter(" + ".join(o.names) for o in some if o.said)
        rows.append(
            (
                kind,
                f"{multiple:g}",
                str(len(some)),
                _counted(Counter(o.verdict for o in some)),
                _counted(named),
            )
        )
    return rows


def left_out_rows(outcomes: Sequence[Outcome]) -> Rows:
    """By kind."""
    rows: Rows = [("left out", "cases", "with twins", "verdicts", "named")]
    left = of(outcomes, arms.LEFT_OUT)
    for kind in sorted({o.kinds[0] for o in left}):
        some = [o for o in left if o.kinds[0] == kind]
        named = Counter(" + ".join(o.names) for o in some if o.said)
        rows.append(
            (
                kind,
                str(len(some)),
                str(sum(not o.isolable for o in some)),
                _counted(Counter(o.verdict for o in some)),
                _counted(named),
            )
        )
    return rows


def _counted(counter: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counter.items()))


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """A table; the first row is its header."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def csv_text(rows: Sequence[Sequence[object]]) -> str:
    """The same for programs."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def sections(outcomes: Sequence[Outcome]) -> list[tuple[str, Rows]]:
    """Titles and tables."""
    statics = [o for o in outcomes if not o.dynamics]
    dynamics = [o for o in outcomes if o.dynamics]
    return [
        ("Figures, static laboratory", figure_rows(figures(statics))),
        ("Figures, full dynamics", figure_rows(figures(dynamics))),
        ("Power against the predicted minimum detectable size (MDE)", power_rows(statics)),
        ("Single effects from 2 MDE on", confusion_rows(statics)),
        ("Single effects in full dynamics", confusion_rows(dynamics)),
        ("Faults outside the catalogue", outside_rows(statics)),
        ("Effects left out of the catalogue", left_out_rows(statics)),
    ]


def report_text(outcomes: Sequence[Outcome]) -> str:
    """All tables as Markdown."""
    return "\n\n".join(
        f"### {title}\n\n{markdown(rows)}" for title, rows in sections(outcomes) if len(rows) > 1
    )


def files(outcomes: Sequence[Outcome], heading: str) -> dict[str, str]:
    """Names and contents of what is written beside the cases."""
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
    return {
        "report.md": f"{heading}\n\n{report_text(outcomes)}\n",
        "power.csv": csv_text(power_rows([o for o in outcomes if not o.dynamics])),
        "confusion.csv": csv_text(
            [("hidden", "mde", "verdict", "named_first", "cases"), *((*key, count) for key, count in counted)]
        ),
        "cases.csv": csv_text(
            [("case", "arm", "hidden", "mde", "dynamics", "isolable", "verdict", "named", "failed"), *cases]
        ),
    }


def report_document(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """For JSON."""
    parts = {"statics": False, "dynamics": True}
    return {
        "cases": len(outcomes),
        "figures": {
            part: [
                asdict(f) | {"met": f.met} for f in figures([o for o in outcomes if o.dynamics == dynamics])
            ]
            for part, dynamics in parts.items()
        },
    }
