"""The gap on placements that were not looked at, before and after: does what was found predict?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tulip_testbed.discovery.fit import Fit, Term, fit, removed, through_effects, with_constant
from tulip_testbed.discovery.linear_model import linear_model, nuisances, weighing
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, packed, residuals, unpacked
from tulip_testbed.identification.residual_noise import Noise, whitening
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import Measurements

FOLDS = 4
LEAST_PLACEMENTS = 4
CHANNELS = ("A", "F", "T", "C", "AFTC")


@dataclass(frozen=True)
class HeldOut:
    """Residuals of placements that took no part in the fit.

    Attributes:
        before, after: whitened root mean squares by channel and all together ("AFTC"), 1 is the noise.
        millimetres: of the centre of pressure, r.m.s. before, after, and by the noise, (3,) [mm].
        floor: what `after` may be by chance, its 97.5 % quantile, by channel.
    """

    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]
    millimetres: tuple[float, float, float]


def rows_of(observed: Observation, rows: np.ndarray) -> Observation:
    """Some postures of an experiment."""
    count = len(observed)
    m = observed.measurements
    cut = {
        f.name: getattr(m, f.name)[rows]
        for f in fields(m)
        if isinstance(getattr(m, f.name), np.ndarray)
        and f.name not in ("cells", "top_height")
        and len(getattr(m, f.name)) == count
    }
    kept = {
        f.name: getattr(observed, f.name)[rows]
        for f in fields(observed)
        if isinstance(getattr(observed, f.name), np.ndarray)
        and f.name not in ("cells", "standard", "board_share", "torque_limits")
        and len(getattr(observed, f.name)) == count
    }
    return replace(observed, measurements=replace(m, **cut), **kept)


def check_placements(measurements: Measurements) -> None:
    """Refuse fewer placements than can be held out.

    Raises:
        InputError: says how many are needed.
    """
    count = len(np.unique(measurements.placement))
    if count < LEAST_PLACEMENTS:
        raise InputError(
            f"measurements: found {count} placements, expected at least {LEAST_PLACEMENTS}: "
            "whether a finding holds is shown on placements that took no part in it"
        )


def held_out(observed: Observation, noise: Noise, terms: Sequence[Term], bend: np.ndarray) -> HeldOut:
    """Cross-validate over placements: base parameters and sizes from the others alone.

    Raises:
        InputError: fewer placements than can be held out.
    """
    check_placements(observed.measurements)
    placements = np.unique(observed.measurements.placement)
    # What happened to one placement alone, the others cannot tell: it is taken as fitted to all.
    single = [term.candidate.effect.targets is PLACEMENTS for term in terms]
    mended = removed(observed, observed, [term for term, alone in zip(terms, single, strict=True) if alone])
    own = np.repeat(single, [len(term.sizes) for term in terms]).astype(bool)
    mended_bend = bend[..., np.append(~own, True)]
    general = tuple(term for term, alone in zip(terms, single, strict=True) if not alone)
    fold = np.searchsorted(placements, observed.measurements.placement) % FOLDS
    sums = {key: np.zeros(3) for key in CHANNELS}
    square, count = np.zeros(3), 0
    for k in range(FOLDS):
        inside = fold == k
        plain = fit(rows_of(observed, ~inside), noise, ())
        fitted = fit(rows_of(mended, ~inside), noise, general, mended_bend[~inside] if general else None)
        sides = (
            (rows_of(observed, inside), plain, None),
            (rows_of(mended, inside), fitted, mended_bend[inside]),
        )
        for key in CHANNELS:
            for column, (test, model, more) in enumerate(sides):
                size, freedom, raw = _left(test, noise, model, more, key)
                sums[key] += np.array([size * (column == 0), size * (column == 1), freedom * column])
                if key == "A":
                    square[column] += raw[0]
                    square[2] += raw[1] * column
        count += 2 * int(inside.sum())
    before = {key: float(np.sqrt(v[0] / v[2])) for key, v in sums.items() if v[2] > 0}
    after = {key: float(np.sqrt(v[1] / v[2])) for key, v in sums.items() if v[2] > 0}
    floor = {key: float(np.sqrt(1 + 1.96 * np.sqrt(2 / v[2]))) for key, v in sums.items() if v[2] > 0}
    first, last, least = 1e3 * np.sqrt(square / count)
    return HeldOut(before, after, floor, (float(first), float(last), float(least)))


def _left(
    test: Observation, noise: Noise, model: Fit, bend: np.ndarray | None, channels: str
) -> tuple[float, int, tuple[float, float]]:
    """Chi-square of held-out postures under a fit to others, its freedom, and channel A's squares [m2].

    What the fit does not know of them (the swing foot's place) is projected out, what it knows
    badly (base parameters, weight) widens the expected residual.
    """
    trained = model.linear
    beside = bend @ with_constant(model.terms) if bend is not None and model.terms else None
    # Readings are smoothed freed of the effects: under the wrong model, what is no noise would be taken off.
    about = linear_model(
        removed(test, test, model.terms),
        noise,
        through=through_effects(test, model.terms) if model.terms else None,
        beside=beside,
    )
    smooth = unpacked(test, packed(test) - (packed(about.observed) - packed(about.smooth)))
    clean = removed(test, test, model.terms)
    still = removed(smooth, smooth, model.terms)
    through = through_effects(smooth, model.terms) if model.terms else None
    white = whitening(still, trained.theta, noise, channels, through)
    raw = residuals(clean, trained.theta)
    if beside is not None:
        raw = raw - beside
    columns = nuisances(still, channels)
    p = len(trained.theta)
    shared = np.append(np.arange(p), columns.shape[-1] - 1)
    spread, solution = _shared(trained, p)
    raw = raw + columns[..., shared] @ solution
    start, reach = white(raw), white(columns[..., shared])
    places = white(np.delete(columns, shared, axis=-1))
    places = places[:, np.abs(places).max(axis=0) > 0] if places.size else places
    basis = np.linalg.qr(places)[0]
    start, reach = start - basis @ (basis.T @ start), reach - basis @ (basis.T @ reach)
    covariance = np.eye(len(start)) + reach @ spread @ reach.T
    size = float(start @ np.linalg.solve(covariance, start))
    squares = (0.0, 0.0)
    if channels == "A":
        inside = raw[:, ROWS["A"]]
        levers = white.reach[..., len(test.tree.joints) + 8 : len(test.tree.joints) + 14] * noise.plates
        own = (white.own + levers @ levers.mT)[:, :2, :2]
        wide = columns[:, ROWS["A"]][..., shared]
        own = own + wide @ spread @ wide.mT
        squares = (float((inside**2).sum()), float(np.trace(own, axis1=1, axis2=2).sum()))
    return size, len(start) - basis.shape[1], squares


def _shared(linear, p: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of base parameters and weight error by a fit, and their last step, (p + 1, ...)."""
    observed = linear.smooth
    columns = nuisances(observed, "AFTC")
    whole = np.vstack([linear.white(columns), weighing(observed)[None]])
    used = np.abs(whole).max(axis=0) > 0
    shared = np.append(np.arange(p), whole.shape[1] - 1)
    places = np.setdiff1d(np.flatnonzero(used), shared)
    basis = np.linalg.qr(whole[:, places])[0]
    known = whole[:, shared] - basis @ (basis.T @ whole[:, shared])
    start = np.append(linear.white(residuals(linear.observed, linear.theta)), 0.0)
    spread = np.linalg.pinv(known.T @ known, hermitian=True)
    return spread, -spread @ (known.T @ start)
