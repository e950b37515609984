"""Tables of an atlas: what a plan detects, what it cannot detect, what it cannot distinguish."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlases.effect_atlas import Atlas, Row
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.identification.residual_channels import CHANNELS

NO_BIAS = 0.005  # standard errors: shown as 0.00
LEGEND = (
    "plausible: 1 s.d. of the prior. found from: the least size that is found with 90 % probability, by all "
    "channels or by one alone (A centre of pressure, F sum of the vertical forces, T twist of the plates, C "
    "closure of the legs); -: never. bias: of the parameter that suffers most if the effect is not modelled, "
    "in standard errors of the default estimator, at the plausible size and the least one found. angle: to "
    "the most similar effect."
)


def atlas_summary(found: Atlas) -> tuple[str, Table, str]:
    """Return an atlas in short: one row a kind of effect and unit."""
    return (
        opening(found),
        kind_table(found, _one_placement(found)),
        f"{len(found.groups)} groups of effects cannot be distinguished. {closing(found)}",
    )


def atlas_tables(found: Atlas) -> tuple[Table, ...]:
    """Return the effects that a plan detects, those that it cannot detect, and the look-alikes."""
    rows = _one_placement(found)
    detected, hidden = ([row for row in rows if row.visible == wanted] for wanted in (True, False))
    tables = [effect_table(found, detected, "Effects that these postures detect")]
    if hidden:
        tables.append(
            effect_table(found, hidden, "Effects that these postures cannot detect at plausible sizes")
        )
    return (*tables, group_table(found)) if found.groups else tuple(tables)


def opening(found: Atlas) -> str:
    """Describe the plan and the tests."""
    planned = found.planned
    return (
        f"{len(planned.observed)} of {len(planned.plan)} postures can be measured; the catalogue is "
        f"equivalent to {found.tests:.0f} independent tests, each at the level {100 * found.level:.2g} %."
    )


def closing(found: Atlas) -> str:
    """Say how many of the effects can be isolated."""
    near = [found.nearest(k)[1] for k in range(len(found.shown))] if len(found.shown) > 1 else []
    isolable = sum(angle >= ISOLABLE for angle in near)
    return f"{isolable} of {len(found.shown)} effects that are detected can be isolated from all others."


def kind_table(found: Atlas, rows: list[Row]) -> Table:
    """Return one row a kind of effect and unit: the range over its targets."""
    columns = (
        Column("effect"),
        Column("unit"),
        Column("detected"),
        Column("plausible", format=".2g"),
        Column("found from", format=".2g"),
        Column("angle", "deg", ".0f"),
        Column("largest bias", "s.e.", ".2g"),
    )
    place = {id(candidate): k for k, candidate in enumerate(found.shown)}
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        unit = row.parameter.display[1] if row.parameter else ""
        kinds.setdefault((row.candidate.effect.name, unit), []).append(row)
    lines = []
    for (name, unit), of in kinds.items():
        sizes = [_size(row, row.detectable) for row in of if np.isfinite(row.detectable)]
        at = [place[id(row.candidate)] for row in of if id(row.candidate) in place]
        near = [np.degrees(found.nearest(k)[1]) for k in at] if len(found.shown) > 1 else []
        biases = [float(np.abs(row.bias / found.planned.standard_errors).max()) for row in of]
        known = [value for value in biases if np.isfinite(value)]
        lines.append(
            [
                name,
                unit,
                f"{sum(row.visible for row in of)} of {len(of)}",
                _range([_size(row, row.prior) for row in of]),
                _range(sizes),
                _range(near),
                _shown_bias(max(known)) if known else None,
            ]
        )
    note = (
        "plausible: 1 s.d. of the prior. found from: the least size that is found with 90 % probability. "
        "angle: to the most similar effect. largest bias: of a parameter if the effect is not modelled, at "
        "its plausible size. Ranges are those over the targets."
    )
    return Table("Effects that these postures detect, by kind", columns, lines, note)


def _shown_bias(bias: float) -> float:
    return bias if bias >= NO_BIAS else 0.0


def _range(values: list[Any]) -> Any:
    """Return a value, or the least and the largest where they differ."""
    if not values or isinstance(values[0], bool):
        return values[0] if values else None
    low, high = float(min(values)), float(max(values))
    return low if math.isclose(low, high, rel_tol=0.05, abs_tol=1e-6) else (low, high)


def effect_table(found: Atlas, rows: list[Row], title: str) -> Table:
    """Return one row a size of a candidate."""
    columns = (
        Column("effect"),
        Column("size of"),
        Column("unit"),
        Column("plausible", format=".2g"),
        Column("found from", format=".2g"),
        Column("angle", "deg", ".0f"),
        Column("bias", "s.e.", "+.2f", extra=True),
        Column("bias when just found", "s.e.", "+.2f", extra=True),
        Column("of the parameter", extra=True),
        Column("most similar effect", extra=True),
        *(Column(f"by {channel}", format=".2g", extra=True) for channel in CHANNELS),
    )
    place = {id(candidate): k for k, candidate in enumerate(found.shown)}
    errors, names = found.planned.standard_errors, found.planned.nominal.parameters.names
    lines = []
    for row in rows:
        at = place.get(id(row.candidate))
        similar, angle = (None, None) if at is None or len(found.shown) < 2 else found.nearest(at)
        bias = row.bias / errors
        known = bool(np.isfinite(bias).all())
        worst = int(np.abs(bias).argmax()) if known else 0
        lines.append(
            [
                row.candidate.label,
                row.name,
                row.parameter.display[1] if row.parameter else "",
                _size(row, row.prior),
                _size(row, row.detectable),
                None if angle is None else float(np.degrees(angle)),
                float(bias[worst]) if known else None,
                float(row.bias_undetected[worst] / errors[worst]) if known else None,
                names[worst] if known and abs(bias[worst]) >= NO_BIAS else "",
                "" if similar is None else found.shown[similar].label,
                *(_size(row, row.by_channel[c]) for c in CHANNELS),
            ]
        )
    return Table(title, columns, lines)


def group_table(found: Atlas) -> Table:
    """Return the groups of look-alikes."""
    rows = [[k, [found.shown[n].label for n in group]] for k, group in enumerate(found.groups, 1)]
    bound = f"{np.degrees(ISOLABLE):.0f} deg"
    title = f"Effects that these postures cannot distinguish (an angle below {bound} to another of the group)"
    return Table(title, (Column("group", format="d"), Column("effects")), rows)


def _one_placement(found: Atlas) -> list[Row]:
    """Return the rows, of those that concern one placement only the one that is hardest to detect."""
    out, worst = [], {}
    for row in found.rows:
        if row.candidate.effect.targets is not PLACEMENTS:
            out.append(row)
            continue
        key = (row.candidate.effect.name, row.size)
        if key not in worst or row.detectable > worst[key].detectable:
            worst[key] = row
    return out + list(worst.values())


def _size(row: Row, value: float) -> Any:
    """Return a size in the unit that it is shown in; of an effect without one whether it is found."""
    if row.parameter is None:
        return True if np.isfinite(value) else np.inf
    return row.parameter.display[0] * value
