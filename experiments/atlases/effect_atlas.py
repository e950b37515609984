"""The atlas of a plan: which effects it would detect, distinguish or hide, before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.discovery.columns import CandidateColumns, candidate_columns
from tulip_testbed.discovery.detectability import POWER, detectable_size, single_level
from tulip_testbed.discovery.evidence import DETECTABLE, effective_tests
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.instance import MOST_PRIORS
from tulip_testbed.experiments.atlases.bias import bias, weights
from tulip_testbed.experiments.atlases.isolability import ISOLABLE, angles, groups
from tulip_testbed.experiments.atlases.planned_experiment import Planned
from tulip_testbed.identification.distributions import chi2_isf, normal_isf
from tulip_testbed.identification.residual_channels import CHANNELS

SAME = 1e-9  # of the largest column: a choice that changes nothing


@dataclass(frozen=True)
class Row:
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
class Atlas:
    """All of it.

    Attributes:
        rows: sizes of all candidates, in the catalogue's order.
        shown: candidates that could be observed, (n,).
        angle: between them, (n, n) [rad]. groups: of look-alikes among them, by their numbers.
        tests: number of independent tests to which the catalogue is equivalent. level: of each.
    """

    planned: Planned
    rows: tuple[Row, ...]
    shown: tuple[Candidate, ...]
    angle: np.ndarray
    groups: tuple[tuple[int, ...], ...]
    tests: float
    level: float

    def __repr__(self) -> str:
        seen = sum(row.visible for row in self.rows)
        return (
            f"Atlas of {len(self.planned.plan)} postures: {seen} of {len(self.rows)} sizes can be seen, "
            f"{len(self.groups)} groups of effects look alike"
        )

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row a size of an effect, in SI units."""
        kept = ("effect", "target", "parameter", "unit", "prior_sd", "detectable", "visible", "nearest")
        rows = [[row[name] for name in kept] for row in document(self)["effects"]]
        return Table("Effects", tuple(map(Column, kept)), rows).frame()

    def nearest(self, number: int) -> tuple[int, float]:
        """Return the other candidate that looks most like one, and the angle to it [rad]."""
        angle = np.where(np.arange(len(self.angle)) == number, np.inf, self.angle[number])
        return int(angle.argmin()), float(angle.min())


def atlas(planned: Planned, rng: np.random.Generator) -> Atlas:
    """Make it.

    Args:
        rng: for the number of independent tests.
    """
    among = candidates(planned.observed)
    columns = candidate_columns(linear_model(planned.observed, planned.noise), among)
    single = {c: candidate_columns(linear_model(planned.observed, planned.noise, c), among) for c in CHANNELS}
    tests = effective_tests([columns], rng)
    level = single_level(LEVEL, tests)
    estimator, rows = weights(planned), []
    for k, candidate in enumerate(among):
        point = _point(columns, k)
        moved = bias(planned, estimator, candidate, point)
        for size in range(len(candidate.effect.sizes)) if candidate.effect.sizes else (None,):
            column = columns.projected[k][point][:, [size or 0]]
            prior = 1.0 if size is None else candidate.prior[size]
            rows.append(
                Row(
                    candidate,
                    size,
                    _detectable(columns, k, point, size, level),
                    {c: _detectable(single[c], k, point, size, level) for c in CHANNELS},
                    bool(np.linalg.norm(column) * prior > DETECTABLE),
                    moved[:, size or 0],
                )
            )
    shown = [k for k in range(len(among)) if any(r.visible for r in rows if r.candidate is among[k])]
    angle = angles([_distinct(columns.projected[k]) for k in shown])
    return Atlas(
        planned,
        tuple(rows),
        tuple(among[k] for k in shown),
        angle,
        tuple(tuple(group) for group in groups(angle)),
        tests,
        level,
    )


def _point(columns: CandidateColumns, k: int) -> int:
    """Of the grid: the middle one of a time, the least visible one of a choice that changes anything."""
    points = columns.projected[k]
    if columns.candidates[k].effect.sizes:
        return len(points) // 2
    length = np.array([np.linalg.norm(column) for column in points])
    return int(np.where(length > SAME * length.max(), length, np.inf).argmin())


def _distinct(points: list[np.ndarray]) -> list[np.ndarray]:
    """Without those that change nothing."""
    length = np.array([np.linalg.norm(column) for column in points])
    return [column for column, size in zip(points, length, strict=True) if size > SAME * length.max()]


def _detectable(columns: CandidateColumns, k: int, point: int, size: int | None, level: float) -> float:
    column = columns.projected[k][point]
    if size is None:
        # The gain 2 g'r - g'g has mean g'g and variance 4 g'g where the effect is there.
        length = float(np.linalg.norm(column))
        needed = chi2_isf(2 * level, 1)
        return 1.0 if length**2 - 2 * normal_isf(1 - POWER) * length > needed else np.inf
    candidate = columns.candidates[k]
    direction = (np.arange(column.shape[1]) == size).astype(float)
    found = detectable_size(candidate, column, level, direction)
    return found if found < MOST_PRIORS * candidate.prior[size] else np.inf


def document(found: Atlas) -> dict[str, Any]:
    """For JSON; sizes in SI units, biases in m and standard errors."""
    errors, names = found.planned.standard_errors, found.planned.nominal.parameters.names
    number = {id(candidate): k for k, candidate in enumerate(found.shown)}
    group_of = {k: n + 1 for n, group in enumerate(found.groups) for k in group}

    def row(r: Row) -> dict[str, Any]:
        at = number.get(id(r.candidate))
        other = None if at is None or len(found.shown) < 2 else found.nearest(at)
        return {
            "effect": r.candidate.effect.name,
            "target": r.candidate.target or None,
            "parameter": r.parameter.name if r.parameter else None,
            "unit": r.parameter.unit if r.parameter else "",
            "prior_sd": None if r.size is None else r.prior,
            "detectable": r.detectable,
            "by_channel": r.by_channel,
            "visible": r.visible,
            "nearest": None if other is None else found.shown[other[0]].label,
            "nearest_angle_rad": None if other is None else other[1],
            "isolable": None if other is None else bool(other[1] >= ISOLABLE),
            "group": None if at is None else group_of.get(at),
            "bias_at_prior_m": r.bias.tolist(),
            "bias_at_prior_se": (r.bias / errors).tolist(),
            "bias_at_detectable_se": (r.bias_undetected / errors).tolist(),
        }

    return {
        "postures": len(found.planned.observed),
        "planned": len(found.planned.plan),
        "power": POWER,
        "level": LEVEL,
        "tests": found.tests,
        "level_of_each": found.level,
        "isolable_rad": ISOLABLE,
        "parameters": list(names),
        "standard_error_m": errors.tolist(),
        "effects": [row(r) for r in found.rows],
        "groups": [[found.shown[k].label for k in group] for group in found.groups],
        "shown": [candidate.label for candidate in found.shown],
        "angle_rad": found.angle.tolist(),
    }
