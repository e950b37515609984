"""Audit the conventions of a log: every hypothesis and how likely the measured wrenches make it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.identification.conventions.convention_fit import (
    ConventionFit,
    NeededWrench,
    effective_rows,
    fit_convention,
    needed,
    reading_in_the_air,
)
from tulip_testbed.identification.conventions.log_conventions import (
    ALL,
    ASPECTS,
    FOOT,
    PREPARED,
    PUBLISHED,
    SENSOR,
    ContactFrames,
    WrenchConvention,
    contact_frames,
    in_sensors,
    other_readings,
    rewritten,
    shifted,
    total_in_base,
)
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.measurements.stated_convention import AXES, WORLD, StatedConvention

DECISIVE = 8.0  # of the log-likelihood, over that of the next hypothesis
WORST_FORCE, WORST_MOMENT = 0.1, 0.05  # r.m.s. residual over the weight [-, m], beyond which nothing fits
MOST_ROWS = 300
FIRST_COUNTED = 0.5  # of the rows, until their correlation is known
YAWS = np.radians(np.arange(-180.0, 180.0, 30.0))
FINER = np.radians([8.0, 3.0, 1.0])  # steps about the best of them
SAME_YAW = np.radians(10.0)  # of the world's axes and the foot's
OF_POSTURE = (SENSOR, PREPARED, PUBLISHED)  # axes that follow from the joint angles
LAGS = np.linspace(-0.5, 0.5, 21)  # s
LEAST_ROWS, LEAST_SERIES = 3, 40  # for an audit, and for a lag
NAMES = {
    "axes": AXES,
    "sign": "sign of the wrench",
    "about": "point of the moments",
    "order": "order of the channels",
}


@dataclass(frozen=True)
class Conventions:
    """The result of an audit; where nothing is decisive the contract's convention is kept.

    Attributes:
        rows: hypotheses of each convention, the likeliest first.
        convention: of the wrenches, as applied.
        problems: what is not decided or contradicts the log.
        doubt: hypotheses between which the wrenches do not decide; "" if they do.
        residual: r.m.s. of the unexplained force and moment over the weight, x, y, z, (6,) [-, m].
        lag: by which the contact sensors are behind the joints and its s.d., (2,) [s]; NaN: unknown; an
            infinite s.d.: that or more.
        applied: the measurements with wrenches as the contract has them.
    """

    rows: tuple[StatedConvention, ...]
    convention: WrenchConvention
    problems: tuple[str, ...]
    doubt: str
    residual: np.ndarray
    lag: np.ndarray
    applied: Measurements

    @property
    def stated(self) -> tuple[StatedConvention, ...]:
        """Return the hypotheses as manifest and document have them."""
        return tuple(replace(row, log_likelihood=round(row.log_likelihood, 2)) for row in self.rows)


def convention_table(conventions: Sequence[StatedConvention]) -> Table:
    names = ("convention", "hypothesis", "log-likelihood", "applied")
    rows = [
        [row.what, row.hypothesis, round(row.log_likelihood, 1), "yes" if row.applied else ""]
        for row in conventions
    ]
    return Table("Conventions", tuple(map(Column, names)), rows)


class _Tried(NamedTuple):
    log_likelihood: float
    convention: WrenchConvention
    fit: ConventionFit


_likelihood = attrgetter("log_likelihood")


class _Counted(NamedTuple):
    """How many independent rows the rows count for, and those of each foot in the air, right and left."""

    rows: float
    air: Sequence[float]


def can_be_audited(measurements: Measurements) -> bool:
    """Return whether the contacts are six-axis sensors in the feet, with enough rows of both feet's loads."""
    contacts = measurements.contacts
    of_feet = contacts is not None and contacts.mount == "foot" and contacts.channels == WRENCH
    return of_feet and len(_usable(measurements)) >= LEAST_ROWS


def audit_conventions(measurements: Measurements, nominal: Nominal) -> Conventions:
    """Compare what six-axis sensors in the feet read with what the nominal robot needs, in every convention.

    One is applied if its likelihood is decisive over all others and its residual is small for the weight.
    """
    m = _usable(measurements)
    m = m.take(np.arange(0, len(m), -(-len(m) // MOST_ROWS)))
    need, frames = needed(nominal, m), contact_frames(nominal, m)
    aloft = [min(1.0, len(read)) for read, _ in _in_the_air(m, frames, WrenchConvention())]
    counted = _Counted(FIRST_COUNTED * len(m), aloft)
    best = _tried(m, need, frames, counted)[0]
    air = _in_the_air(m, frames, best.convention)
    counted = _Counted(effective_rows(best.fit.residual), [effective_rows(read) for read, _ in air])
    tried = _tried(m, need, frames, counted)
    best, rows, undecided = tried[0], [], []
    for aspect in ASPECTS:
        ranked = _ranked(tried, aspect)
        if aspect == "axes":
            best, ranked = _foot_or_world(best, tried, ranked)
        if ranked[1][1] > ranked[0][1] - DECISIVE:
            undecided.append(f"{NAMES[aspect]}: '{ranked[0][0]}' or '{ranked[1][0]}'")
        rows += [(aspect, value, likelihood) for value, likelihood in ranked]
    scale = need.weight
    residual = np.sqrt((best.fit.residual**2).mean(axis=0)) / scale
    problems = []
    fits = residual[:3].max() < WORST_FORCE and residual[3:].max() < WORST_MOMENT
    if not fits:
        force, moment = 100 * residual[:3].max(), 1e3 * residual[3:].max()
        first, following = _best_two([best.convention, *(one.convention for one in tried)])
        problems.append(
            f"no convention explains the wrenches: the best, {first}, leaves {force:.0f} % of the weight and "
            f"{moment:.0f} mm, the next is {following}"
        )
    doubt = f"the wrenches do not decide: {'; '.join(undecided)}" if fits and undecided else ""
    stated = next(one for one in tried if one.convention == WrenchConvention())
    if doubt and stated.log_likelihood > tried[0].log_likelihood - DECISIVE:
        doubt, best = f"{doubt}; taken as stated", stated
    elif doubt:
        problems.append(doubt)
    settled = fits and not undecided
    yaw = float(np.angle(np.exp(1j * best.convention.yaw)))
    chosen = replace(best.convention, yaw=yaw) if settled else WrenchConvention()
    top = max(one[2] for one in rows)
    out = [
        # The value applied is the one shown, alone or first.
        StatedConvention(
            NAMES[aspect], value, likelihood - top, value.partition(",")[0] == getattr(chosen, aspect)
        )
        for aspect, value, likelihood in rows
    ]
    likely = [best.convention] if fits else [replace(best.convention, axes=one) for one in OF_POSTURE]
    others, contradictions = _joints(m, nominal, likely, best.log_likelihood, counted)
    problems += contradictions
    out += ([_origin(best.fit.origin)] if fits else []) + others
    lag = _lag(m, need, frames, best, counted.rows) if fits else np.full(2, np.nan)
    if np.isinf(lag[1]):
        side = "behind" if lag[0] > 0 else "ahead of"
        problems.append(f"the contact sensors are {abs(lag[0]):g} s or more {side} the joints")
    elif abs(lag[0]) > max(4 * lag[1], 0.02):
        problems.append(f"the contact sensors are {lag[0]:.3f} +- {lag[1]:.3f} s behind the joints")
    applied = measurements
    if settled and chosen != WrenchConvention():
        applied = rewritten(measurements, contact_frames(nominal, measurements), chosen)
    found = Conventions(tuple(out), chosen, tuple(problems), doubt, residual, lag, applied)
    return replace(found, applied=replace(applied, conventions=found.stated))


def _usable(m: Measurements) -> Measurements:
    assert m.wrenches is not None
    read = np.isfinite(m.wrenches).all(axis=2) | ~feet_in_contact(m.support)
    return m.take(np.flatnonzero(read.all(axis=1) & np.isfinite(m.joint_angles).all(axis=1)))


def _tried(m: Measurements, need: NeededWrench, frames: ContactFrames, counted: _Counted) -> list[_Tried]:
    """Fit every convention, the likeliest first; those in the world's axes at their likeliest yaw."""
    tried = [
        _fitted(m, need, frames, one, counted)
        for convention in ALL
        if convention.axes != PUBLISHED or not np.allclose(frames.published, np.eye(3))
        for one in ([replace(convention, yaw=y) for y in YAWS] if convention.axes == WORLD else [convention])
    ]
    for about in ASPECTS["about"]:
        world = [one for one in tried if (one.convention.axes, one.convention.about) == (WORLD, about)]
        best = max(world, key=_likelihood)
        for step in FINER:
            turned = [replace(best.convention, yaw=best.convention.yaw + k * step) for k in (-2, -1, 1, 2)]
            best = max(best, *(_fitted(m, need, frames, one, counted) for one in turned), key=_likelihood)
        tried.append(best)
    return sorted(tried, key=_likelihood, reverse=True)


def _fitted(
    m: Measurements,
    need: NeededWrench,
    frames: ContactFrames,
    convention: WrenchConvention,
    counted: _Counted,
) -> _Tried:
    body = None if convention.about == FOOT else frames.body
    measured = total_in_base(m, frames, convention)
    fit = fit_convention(measured, need, convention.axes == WORLD, body, counted.rows)
    if not any(counted.air):
        return _Tried(fit.log_likelihood, convention, fit)
    zeros = [
        reading_in_the_air(read, upright, need.weight, rows)
        for (read, upright), rows in zip(_in_the_air(m, frames, convention), counted.air, strict=True)
    ]
    return _Tried(fit.log_likelihood + sum(zeros), convention, fit)


def _in_the_air(
    m: Measurements, frames: ContactFrames, convention: WrenchConvention
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return what each foot in the air reads, as far as it was logged, (k, 6), and the vertical, (k, 3)."""
    assert m.wrenches is not None
    read = in_sensors(m.wrenches, frames, convention)
    air = ~feet_in_contact(m.support) & np.isfinite(read).all(axis=2)
    upright = frames.sensors[:, :, 2]
    return [(read[air[:, side], side], upright[air[:, side], side]) for side in (0, 1)]


def _ranked(tried: list[_Tried], aspect: str) -> list[tuple[str, float]]:
    best: dict[str, float] = {}
    for one in tried:
        best.setdefault(getattr(one.convention, aspect), one.log_likelihood)
    return list(best.items())


def _foot_or_world(
    best: _Tried, tried: list[_Tried], ranked: list[tuple[str, float]]
) -> tuple[_Tried, list[tuple[str, float]]]:
    """Count the foot's axes and the world's as one where neither is likelier and the yaw is the foot's."""
    likelihood = dict(ranked)
    others = {one.convention.axes: one for one in reversed(tried)}
    same = abs(np.angle(np.exp(1j * others[WORLD].convention.yaw))) < SAME_YAW
    close = abs(likelihood[WORLD] - likelihood[SENSOR]) < DECISIVE
    if best.convention.axes not in (SENSOR, WORLD) or not (same and close):
        return best, ranked
    both = f"{SENSOR}, or world: the same while the foot is flat"
    kept = [(both, ranked[0][1]), *(one for one in ranked if one[0] not in (SENSOR, WORLD))]
    return others[SENSOR], kept


def _described(convention: WrenchConvention) -> str:
    return ", ".join(f"{NAMES[aspect]}: {getattr(convention, aspect)}" for aspect in ASPECTS)


def _best_two(conventions: Sequence[WrenchConvention]) -> list[str]:
    return list(dict.fromkeys(map(_described, conventions)))[:2]


def _origin(origin: np.ndarray) -> StatedConvention:
    (x, y, _), sd = 1e3 * origin[0], 1e3 * origin[1, :2].max()
    text = f"{x:+.0f} mm in x, {y:+.0f} mm in y from its stated place, s.d. {sd:.0f} mm; z not determined"
    return StatedConvention("place of that point", text, 0.0, False)


def _joints(
    m: Measurements, nominal: Nominal, likely: list[WrenchConvention], reached: float, counted: _Counted
) -> tuple[list[StatedConvention], list[str]]:
    """Return other readings of the joints that are likelier than the one taken, in any likely convention."""
    found = []
    for what, other in other_readings(m, nominal.parameters.tree.joint_range):
        need, frames = needed(nominal, other), contact_frames(nominal, other)
        best = max(_fitted(other, need, frames, one, counted).log_likelihood for one in likely)
        found.append((best - reached, what))
    found.sort(reverse=True)
    better = [one for one in found if one[0] > 0]
    rows = [StatedConvention("joints", what, gain, False) for gain, what in (better or found)[:3]]
    as_named = StatedConvention("joints", "as the columns are named", 0.0, True)
    told = [
        f"joints: '{what}' is likelier by {gain:.0f}; state it" for gain, what in found if gain > DECISIVE
    ]
    return [as_named, *rows], told


def _lag(m: Measurements, need: NeededWrench, frames: ContactFrames, best: _Tried, rows: float) -> np.ndarray:
    """Return by how much the wrenches are late, and its s.d., (2,) [s]; NaN: unknown; infinite: or more."""
    if len(m) < LEAST_SERIES or not (np.diff(m.time) > 0).all():
        return np.full(2, np.nan)
    measured = total_in_base(m, frames, best.convention)
    body, world = None if best.convention.about == FOOT else frames.body, best.convention.axes == WORLD
    likelihood = np.array(
        [
            fit_convention(shifted(measured, m.time, lag), need, world, body, rows).log_likelihood
            for lag in LAGS
        ]
    )
    k = int(np.clip(likelihood.argmax(), 1, len(LAGS) - 2))
    curve, slope, _ = np.polyfit(LAGS[k - 1 : k + 2] - LAGS[k], likelihood[k - 1 : k + 2], 2)
    if likelihood.argmax() != k and likelihood.max() > likelihood[len(LAGS) // 2] + DECISIVE:
        return np.array([LAGS[likelihood.argmax()], np.inf])
    if curve >= 0 or likelihood.argmax() != k:
        return np.full(2, np.nan)
    return np.array([LAGS[k] - slope / (2 * curve), np.sqrt(-0.5 / curve)])
