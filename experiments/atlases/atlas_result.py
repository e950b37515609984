"""The atlas of a plan: what the plan detects, what it cannot detect, what it cannot distinguish."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.result import Array, InMemory, Result
from tulip_testbed.base.table import Table
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.effects.targets import PLACEMENTS
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


@dataclass(frozen=True, kw_only=True)
class AtlasRow:
    """One size of one effect, in SI units, and its biases if it is not modelled, (p,).

    Attributes:
        parameter: name of the size; None: the effect has none, it is there or not.
        prior_sd: of the size.
        detectable: least size that is found with 90 % probability, by all channels; infinite: never.
            Of an effect without size 1: found, infinite: not found with that probability.
        by_channel: the same for each channel alone.
        visible: whether the search would consider it at all.
        nearest, nearest_angle_rad: the effect that looks most like it, and the angle to it; None: none.
        group: number of its group of look-alikes, from 1.
        bias_at_prior_m, bias_at_prior_se: at one prior s.d. (if it is there), in standard errors too.
        bias_at_detectable_se: at the detectable size; NaN where there is none.
    """

    effect: str
    target: str | None
    parameter: str | None
    unit: str
    prior_sd: float | None
    detectable: float
    by_channel: dict[str, float]
    visible: bool
    nearest: str | None = None
    nearest_angle_rad: float | None = None
    isolable: bool | None = None
    group: int | None = None
    bias_at_prior_m: Array
    bias_at_prior_se: Array
    bias_at_detectable_se: Array

    @property
    def label(self) -> str:
        return effect_label(self.effect, self.target)

    @property
    def name(self) -> str:
        """Return the parameter; "" where the effect has one only."""
        return self.parameter if self.parameter and len(catalogue()[self.effect].sizes) > 1 else ""

    @property
    def display(self) -> tuple[float, str]:
        """Return scale and unit in which sizes are shown."""
        named = (one for one in catalogue()[self.effect].parameters if one.name == self.parameter)
        return next((one.display for one in named), (1.0, ""))

    def shown(self, size: float | None) -> Any:
        """Return a size in the unit that it is shown in; of an effect without one whether it is found."""
        if self.parameter is None or size is None:
            return True if size is None or np.isfinite(size) else np.inf
        return self.display[0] * size


@dataclass(frozen=True, eq=False, repr=False)
class Atlas(Result):
    """Effects that a plan detects, distinguishes and hides.

    Attributes:
        postures: that can be measured, of so many `planned` ones.
        power: with which an effect is found. level: of the whole search.
        tests: number of independent tests to which the catalogue is equivalent. level_of_each: of them.
        standard_error_m: of the base parameters by the default estimator, (p,) [m].
        effects: sizes of all effects, in the catalogue's order.
        shown: effects that could be observed, (n,). angle_rad: between them, (n, n) [rad].
        groups: of look-alikes among them.
        robot: its name. folder: where the page is; None: nowhere.
    """

    preset: str
    seed: int
    postures: int
    planned: int
    power: float
    level: float
    tests: float
    level_of_each: float
    isolable_rad: float
    parameters: tuple[str, ...]
    standard_error_m: Array
    effects: tuple[AtlasRow, ...]
    groups: tuple[tuple[str, ...], ...]
    shown: tuple[str, ...]
    angle_rad: Array
    robot: InMemory[str]
    folder: InMemory[Path | None] = None

    def tables(self) -> list[Table | str]:
        page = [] if self.folder is None else [f"Atlas: {self.folder / PAGE}"]
        return [
            opening(self),
            kind_table(_one_placement(self)),
            f"{len(self.groups)} groups of effects cannot be distinguished. {closing(self)}",
            *page,
        ]

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row a size of an effect, in SI units."""
        kept = ("effect", "target", "parameter", "unit", "prior_sd", "detectable", "visible", "nearest")
        rows = [[getattr(row, name) for name in kept] for row in self.effects]
        return Table("Effects", tuple(map(Column, kept)), rows).frame()


def nearest_angles(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for every effect the number of the one that looks most like it, and the angle to it [rad]."""
    others = np.where(np.eye(len(angle), dtype=bool), np.inf, angle)
    return others.argmin(axis=1), others.min(axis=1)


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
    return (
        f"{atlas.postures} of {atlas.planned} postures can be measured; the catalogue is equivalent to "
        f"{atlas.tests:.0f} independent tests, each at the level {100 * atlas.level_of_each:.2g} %."
    )


def closing(atlas: Atlas) -> str:
    count = len(atlas.shown)
    isolable = int((nearest_angles(atlas.angle_rad)[1] >= ISOLABLE).sum()) if count > 1 else 0
    return f"{isolable} of {count} effects that are detected can be isolated from all others."


def kind_table(rows: list[AtlasRow]) -> Table:
    sizes = ("plausible", "", ".2g"), ("found from", "", ".2g")
    bias = ("largest bias", "s.e.", ".2g")
    heads = ("effect", "unit", "detected", *sizes, ("angle", "deg", ".0f"), bias)
    kinds: dict[tuple[str, str], list[AtlasRow]] = {}
    for row in rows:
        kinds.setdefault((row.effect, row.display[1]), []).append(row)
    lines = []
    for (name, unit), of in kinds.items():
        sizes = [row.shown(row.detectable) for row in of if np.isfinite(row.detectable)]
        near = [np.degrees(row.nearest_angle_rad) for row in of if row.nearest_angle_rad is not None]
        biases = [float(np.abs(row.bias_at_prior_se).max()) for row in of]
        worst = max(filter(np.isfinite, biases), default=None)
        lines.append(
            [
                name,
                unit,
                f"{sum(row.visible for row in of)} of {len(of)}",
                _range([row.shown(row.prior_sd) for row in of]),
                _range(sizes),
                _range(near),
                0.0 if worst is not None and worst < NO_BIAS else worst,
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
        *("effect", "size of", "unit", ("plausible", "", ".2g"), ("found from", "", ".2g")),
        ("angle", "deg", ".0f"),
        *(Column(name, "s.e.", "+.2f", extra=True) for name in ("bias", "bias when just found")),
        *(Column(name, extra=True) for name in ("of the parameter", "most similar effect")),
        *(Column(f"by {channel}", format=".2g", extra=True) for channel in CHANNELS),
    )
    lines = []
    for row in rows:
        angle, bias = row.nearest_angle_rad, row.bias_at_prior_se
        known = bool(np.isfinite(bias).all())
        worst = int(np.abs(bias).argmax()) if known else 0
        lines.append(
            [
                row.label,
                row.name,
                row.display[1],
                row.shown(row.prior_sd),
                row.shown(row.detectable),
                None if angle is None else float(np.degrees(angle)),
                float(bias[worst]) if known else None,
                float(row.bias_at_detectable_se[worst]) if known else None,
                atlas.parameters[worst] if known and abs(bias[worst]) >= NO_BIAS else "",
                row.nearest or "",
                *(row.shown(row.by_channel[c]) for c in CHANNELS),
            ]
        )
    return Table(title, heads, lines)


def group_table(atlas: Atlas) -> Table:
    rows = [[k, list(group)] for k, group in enumerate(atlas.groups, 1)]
    bound = f"{np.degrees(ISOLABLE):.0f} deg"
    title = f"Effects that these postures cannot distinguish (an angle below {bound} to another of the group)"
    return Table(title, (("group", "", "d"), "effects"), rows)


def _one_placement(atlas: Atlas) -> list[AtlasRow]:
    """Return the rows, of those that concern one placement only the one that is hardest to detect."""
    out, worst = [], {}
    for row in atlas.effects:
        if catalogue()[row.effect].targets is not PLACEMENTS:
            out.append(row)
            continue
        key = (row.effect, row.parameter)
        if key not in worst or row.detectable > worst[key].detectable:
            worst[key] = row
    return out + list(worst.values())
