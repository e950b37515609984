"""Tables of an atlas: what a plan detects, what it cannot detect, what it cannot distinguish."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlases.effect_atlas import Atlas, Row
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.identification.residual_channels import CHANNELS
from tulip_testbed.sim.column import Column
from tulip_testbed.sim.numbers import number
from tulip_testbed.sim.table import Table

NO_BIAS = 0.005  # standard errors: shown as 0.00
LEGEND = (
    "plausible: 1 s.d. of the prior. found from: the least size that is found with 90 % probability, by all "
    "channels or by one alone (A centre of pressure, F sum of the vertical forces, T twist of the plates, C "
    "closure of the legs); -: never. bias: of the parameter that suffers most if the effect is not modelled, "
    "in standard errors of the default estimator, at the plausible size and the least one found. angle: to "
    "the most similar effect."
)


def atlas_report(found: Atlas) -> list[Table | str]:
    """Return the tables and sentences of an atlas."""
    planned, rows = found.planned, _one_placement(found)
    detected, hidden = ([row for row in rows if row.visible == wanted] for wanted in (True, False))
    near = [found.nearest(k)[1] for k in range(len(found.shown))] if len(found.shown) > 1 else []
    parts: list[Table | str] = [
        f"{len(planned.observed)} of {len(planned.plan)} postures can be measured; the catalogue is "
        f"equivalent to {found.tests:.0f} independent tests, each at the level {number(found.level, '.1e')}.",
        effect_table(found, detected, "Effects that these postures detect"),
    ]
    if hidden:
        title = "Effects that these postures cannot detect at plausible sizes"
        parts.append(effect_table(found, hidden, title))
    parts.append(LEGEND)
    if found.groups:
        parts.append(group_table(found))
    isolable = sum(angle >= ISOLABLE for angle in near)
    return [
        *parts,
        f"{isolable} of {len(found.shown)} effects that are detected can be isolated from all others.",
    ]


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
