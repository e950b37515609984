"""Tables of a tolerance analysis: what biases which parameter, and what must be kept."""

from __future__ import annotations

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.atlases.tolerance import ALLOWED, CHECKED, UNITS, Tolerance

LARGE = 1000.0  # units: more than anybody would call a tolerance


def tolerance_report(found: Tolerance) -> list[Table | str]:
    """Return the tables and sentences of a tolerance analysis."""
    difference = np.abs(found.simulated - found.bias)
    k, j = np.unravel_index(int(difference.argmax()), difference.shape)
    names = found.planned.nominal.parameters.names
    return [
        f"{len(found.planned.observed)} of {len(found.planned.plan)} postures can be measured.",
        bias_table(found),
        tolerance_table(found),
        f"Checked by simulation ({CHECKED} runs with and without each error): the largest difference from "
        f"the prediction is {difference[k, j]:.2f} s.e. ({found.sources[k].label}, {names[j]}); the largest "
        f"bias is {np.abs(found.bias).max():.2f} s.e.",
    ]


def bias_table(found: Tolerance) -> Table:
    """Return the bias of every parameter by one unit of every error."""
    columns = (
        Column("error"),
        Column("of"),
        *(Column(str(number), format=".2f", extra=True) for number in range(1, found.bias.shape[1] + 1)),
    )
    rows = [
        [source.label, source.words, *bias.tolist()]
        for source, bias in zip(found.sources, found.bias, strict=True)
    ]
    title = "Bias of every parameter, by its number, in standard errors of the default estimator"
    return Table(title, columns, rows, "`tulip model` tells the names of the parameters.")


def tolerance_table(found: Tolerance) -> Table:
    """Return how large every error may be."""
    columns = (
        Column("error"),
        Column("of"),
        Column("biases most"),
        Column("by", "s.e.", "+.3f"),
        Column("simulated", "s.e.", "+.3f"),
        Column("allowed alone", format=".2g"),
        Column("allowed s.d. if all of a kind err", format=".2g"),
        Column("unit"),
    )
    names, rows, told = found.planned.nominal.parameters.names, [], set()
    for k, source in enumerate(found.sources):
        worst = int(np.abs(found.bias[k]).argmax())
        effect = source.candidate.effect.name
        one, unit = UNITS[effect][1].split(" ")
        alone, together = (
            float(one) * units if units <= LARGE else "any"
            for units in (found.allowed(k), found.together(effect))
        )
        rows.append(
            [
                source.label,
                source.words,
                names[worst],
                float(found.bias[k, worst]),
                float(found.simulated[k, worst]),
                alone,
                None if effect in told else together,
                unit,
            ]
        )
        told.add(effect)
    return Table(
        f"Tolerances that keep the bias of every parameter below {ALLOWED} standard errors", columns, rows
    )
