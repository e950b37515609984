"""The atlas of a plan: what the plan detects, what it cannot detect, what it cannot distinguish."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column, columns
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import finite
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.detectability import POWER
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlases.planned_experiment import Planned
from tulip_testbed.identification.residual_channels import CHANNELS

PAGE = "atlas.html"
NO_BIAS = 0.005  # standard errors: shown as 0.00
# From there on the right one comes first in 95 % (docs/how-to/atlas.md, seeds 0 to 99).
ISOLABLE = np.radians(15.0)
LEGEND = (
    "plausible: 1 s.d. of the prior. found from: the least size that is found with 90 % probability, by all "
    "channels or by one alone (A centre of pressure, F sum of the vertical forces, T twist of the plates, C "
    "closure of the legs); -: never. bias: of the parameter that suffers most if the effect is not modelled, "
    "in standard errors of the default estimator, at the plausible size and the least one found. angle: to "
    "the most similar effect."
)


@dataclass(frozen=True)
class AtlasRow:
    """One size of one candidate.

    Attributes:
        size: number among the effect's sizes; None: the effect has none, it is there or not.
        detectable: least size that is found with 90 % probability, by all channels; infinite: never.
            Of an effect without size 1: found, infinite: not found with that probability.
        by_channel: the same for each channel alone.
        visible: whether the search would consider it at all.
        bias: of the base parameters if it is not modelled, at one prior s.d. (if it is there), (p,) [m].
    """

    candidate: Candidate
    size: int | None
    detectable: float
    by_channel: dict[str, float]
    visible: bool
    bias: np.ndarray

    @property
    def parameter(self) -> Parameter | None:
        """Of the effect that this is the size of."""
        effect = self.candidate.effect
        return None if self.size is None else effect.parameters[effect.sizes[self.size]]

    @property
    def name(self) -> str:
        """Of the parameter; "" where the effect has one only."""
        return self.parameter.name if self.parameter and len(self.candidate.effect.sizes) > 1 else ""

    @property
    def prior(self) -> float:
        return 1.0 if self.size is None else float(self.candidate.prior[self.size])

    @property
    def bias_undetected(self) -> np.ndarray:
        """At the detectable size, (p,) [m]; NaN where there is none."""
        return self.bias * (self.detectable / self.prior if np.isfinite(self.detectable) else np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Atlas(Result):
    """Effects that a plan detects, distinguishes and hides.

    Attributes:
        rows: sizes of all candidates, in the catalogue's order.
        shown: candidates that could be observed, (n,).
        angle: between them, (n, n) [rad]. groups: of look-alikes among them, by their numbers.
        tests: number of independent tests to which the catalogue is equivalent. level: of each.
        folder: where its page is; None: nowhere.
    """

    planned: Planned
    rows: tuple[AtlasRow, ...]
    shown: tuple[Candidate, ...]
    angle: np.ndarray
    groups: tuple[tuple[int, ...], ...]
    tests: float
    level: float
    folder: Path | None = None

    def tables(self) -> list[Table | str]:
        page = [] if self.folder is None else [f"Atlas: {self.folder / PAGE}"]
        return [
            opening(self),
            kind_table(self, _one_placement(self)),
            f"{len(self.groups)} groups of effects cannot be distinguished. {closing(self)}",
            *page,
        ]

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row a size of an effect, in SI units."""
        kept = ("effect", "target", "parameter", "unit", "prior_sd", "detectable", "visible", "nearest")
        rows = [[row[name] for name in kept] for row in self._document()["effects"]]
        return Table("Effects", tuple(map(Column, kept)), rows).frame()

    def nearest(self, number: int) -> tuple[int, float]:
        """Return the other candidate that looks most like one, and the angle to it [rad]."""
        angle = np.where(np.arange(len(self.angle)) == number, np.inf, self.angle[number])
        return int(angle.argmin()), float(angle.min())

    @cached_property
    def numbers(self) -> dict[int, int]:
        """Return the numbers of the candidates that are shown, by their identity."""
        return {id(candidate): k for k, candidate in enumerate(self.shown)}

    def similar(self, row: AtlasRow) -> tuple[str | None, float | None]:
        """Return the effect that looks most like that of a row, and the angle to it [rad]; None: none."""
        number = self.numbers.get(id(row.candidate))
        if number is None or len(self.shown) < 2:
            return None, None
        other, angle = self.nearest(number)
        return self.shown[other].label, angle

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document; sizes in SI units, biases in m and standard errors."""
        return finite(self._document())

    def _document(self) -> dict[str, Any]:
        planned, errors, effects = self.planned, self.planned.standard_errors, []
        for row in self.rows:
            (nearest, angle), number = self.similar(row), self.numbers.get(id(row.candidate))
            effects.append(
                {
                    "effect": row.candidate.effect.name,
                    "target": row.candidate.target or None,
                    "parameter": row.parameter.name if row.parameter else None,
                    "unit": row.parameter.unit if row.parameter else "",
                    "prior_sd": None if row.size is None else row.prior,
                    "detectable": row.detectable,
                    "by_channel": row.by_channel,
                    "visible": row.visible,
                    "nearest": nearest,
                    "nearest_angle_rad": angle,
                    "isolable": None if angle is None else bool(angle >= ISOLABLE),
                    "group": next((n for n, group in enumerate(self.groups, 1) if number in group), None),
                    "bias_at_prior_m": row.bias.tolist(),
                    "bias_at_prior_se": (row.bias / errors).tolist(),
                    "bias_at_detectable_se": (row.bias_undetected / errors).tolist(),
                }
            )
        return {
            "preset": planned.sensors,
            "seed": planned.seed,
            "postures": len(planned.observed),
            "planned": len(planned.plan),
            "power": POWER,
            "level": LEVEL,
            "tests": self.tests,
            "level_of_each": self.level,
            "isolable_rad": ISOLABLE,
            "parameters": list(planned.nominal.parameters.names),
            "standard_error_m": errors.tolist(),
            "effects": effects,
            "groups": [[self.shown[k].label for k in group] for group in self.groups],
            "shown": [candidate.label for candidate in self.shown],
            "angle_rad": self.angle.tolist(),
        }


def atlas_tables(atlas: Atlas) -> tuple[Table, ...]:
    """Return the effects that a plan detects, those that it cannot detect, and the look-alikes."""
    rows = _one_placement(atlas)
    detected, hidden = ([row for row in rows if row.visible == wanted] for wanted in (True, False))
    title = "Effects that these postures cannot detect at plausible sizes"
    return (
        effect_table(atlas, detected, "Effects that these postures detect"),
        *([effect_table(atlas, hidden, title)] if hidden else []),
        *([group_table(atlas)] if atlas.groups else []),
    )


def opening(atlas: Atlas) -> str:
    planned = atlas.planned
    return (
        f"{len(planned.observed)} of {len(planned.plan)} postures can be measured; the catalogue is "
        f"equivalent to {atlas.tests:.0f} independent tests, each at the level {100 * atlas.level:.2g} %."
    )


def closing(atlas: Atlas) -> str:
    count = len(atlas.shown)
    isolable = sum(atlas.nearest(k)[1] >= ISOLABLE for k in range(count)) if count > 1 else 0
    return f"{isolable} of {count} effects that are detected can be isolated from all others."


def kind_table(atlas: Atlas, rows: list[AtlasRow]) -> Table:
    sizes = ("plausible", "", ".2g"), ("found from", "", ".2g")
    bias = ("largest bias", "s.e.", ".2g")
    heads = columns("effect", "unit", "detected", *sizes, ("angle", "deg", ".0f"), bias)
    kinds: dict[tuple[str, str], list[AtlasRow]] = {}
    for row in rows:
        unit = row.parameter.display[1] if row.parameter else ""
        kinds.setdefault((row.candidate.effect.name, unit), []).append(row)
    lines = []
    for (name, unit), of in kinds.items():
        sizes = [_size(row, row.detectable) for row in of if np.isfinite(row.detectable)]
        near = [np.degrees(angle) for _, angle in map(atlas.similar, of) if angle is not None]
        biases = [float(np.abs(row.bias / atlas.planned.standard_errors).max()) for row in of]
        known = [value for value in biases if np.isfinite(value)]
        lines.append(
            [
                name,
                unit,
                f"{sum(row.visible for row in of)} of {len(of)}",
                _range([_size(row, row.prior) for row in of]),
                _range(sizes),
                _range(near),
                (max(known) if max(known) >= NO_BIAS else 0.0) if known else None,
            ]
        )
    note = (
        "plausible: 1 s.d. of the prior. found from: the least size that is found with 90 % probability. "
        "angle: to the most similar effect. largest bias: of a parameter if the effect is not modelled, at "
        "its plausible size. Ranges are those over the targets."
    )
    return Table("Effects that these postures detect, by kind", heads, lines, note)


def _range(values: list[Any]) -> Any:
    """Return a value, or the least and the largest where they differ."""
    if not values or isinstance(values[0], bool):
        return values[0] if values else None
    low, high = float(min(values)), float(max(values))
    return low if math.isclose(low, high, rel_tol=0.05, abs_tol=1e-6) else (low, high)


def effect_table(atlas: Atlas, rows: list[AtlasRow], title: str) -> Table:
    """Return one row a size of a candidate."""
    heads = (
        *columns("effect", "size of", "unit", ("plausible", "", ".2g"), ("found from", "", ".2g")),
        Column("angle", "deg", ".0f"),
        *(Column(name, "s.e.", "+.2f", extra=True) for name in ("bias", "bias when just found")),
        *(Column(name, extra=True) for name in ("of the parameter", "most similar effect")),
        *(Column(f"by {channel}", format=".2g", extra=True) for channel in CHANNELS),
    )
    errors, names = atlas.planned.standard_errors, atlas.planned.nominal.parameters.names
    lines = []
    for row in rows:
        similar, angle = atlas.similar(row)
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
                similar or "",
                *(_size(row, row.by_channel[c]) for c in CHANNELS),
            ]
        )
    return Table(title, heads, lines)


def group_table(atlas: Atlas) -> Table:
    rows = [[k, [atlas.shown[n].label for n in group]] for k, group in enumerate(atlas.groups, 1)]
    bound = f"{np.degrees(ISOLABLE):.0f} deg"
    title = f"Effects that these postures cannot distinguish (an angle below {bound} to another of the group)"
    return Table(title, columns(("group", "", "d"), "effects"), rows)


def _one_placement(atlas: Atlas) -> list[AtlasRow]:
    """Return the rows, of those that concern one placement only the one that is hardest to detect."""
    out, worst = [], {}
    for row in atlas.rows:
        if row.candidate.effect.targets is not PLACEMENTS:
            out.append(row)
            continue
        key = (row.candidate.effect.name, row.size)
        if key not in worst or row.detectable > worst[key].detectable:
            worst[key] = row
    return out + list(worst.values())


def _size(row: AtlasRow, value: float) -> Any:
    """Return a size in the unit that it is shown in; of an effect without one whether it is found."""
    if row.parameter is None:
        return True if np.isfinite(value) else np.inf
    return row.parameter.display[0] * value
