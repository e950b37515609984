"""Cross-validation over placements: do the effects predict placements that took no part in the fit?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.joint_fit import (
    Data,
    JointFit,
    joint_fit,
    propagation,
    remove_terms,
    with_constant,
)
from tulip_testbed.discovery.linear_model import LinearModel, linear_model, nuisances, weighing
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
        before, after: root mean squares of the whitened residuals without and with the effects, by channel
            and of all channels ("AFTC"); 1 is the noise.
        millimetres: root mean square of the centre of pressure's residuals before, after, and by the noise
            alone, (3,) [mm].
        floor: 97.5 % quantile of `after` by chance, by channel.
    """

    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]
    millimetres: tuple[float, float, float]


def rows_of(observed: Observation, rows: np.ndarray) -> Observation:
    """Return some postures of an experiment."""
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
    """Refuse measurements with too few placements for cross-validation.

    Raises:
        InputError: with the number that was found and the number that is needed.
    """
    count = len(np.unique(measurements.placement))
    if count < LEAST_PLACEMENTS:
        raise InputError(
            f"measurements: found {count} placements, expected at least {LEAST_PLACEMENTS}: "
            "whether a finding holds is shown on placements that took no part in it"
        )


def held_out(data: Data, terms: Sequence[Fitted], model_error: np.ndarray) -> HeldOut:
    """Cross-validate over placements: fit base parameters and sizes to the other placements alone.

    Args:
        model_error: of the terms' predictions, see `gauss_newton`.

    Raises:
        InputError: fewer placements than cross-validation needs.
    """
    observed, noise = data.observed, data.noise
    check_placements(observed.measurements)
    placements = np.unique(observed.measurements.placement)
    # An effect on a single placement cannot be learnt from the others. It is removed as fitted to all.
    single = [term.candidate.effect.targets is PLACEMENTS for term in terms]
    corrected = remove_terms(observed, observed, [t for t, alone in zip(terms, single, strict=True) if alone])
    own = np.repeat(single, [len(term.sizes) for term in terms]).astype(bool)
    general_error = model_error[..., np.append(~own, True)]
    general = tuple(term for term, alone in zip(terms, single, strict=True) if not alone)
    fold = np.searchsorted(placements, observed.measurements.placement) % FOLDS
    sums = {key: np.zeros(3) for key in CHANNELS}
    square, count = np.zeros(3), 0
    for k in range(FOLDS):
        inside = fold == k
        plain = joint_fit(Data(rows_of(observed, ~inside), noise), ())
        fitted = joint_fit(
            Data(rows_of(corrected, ~inside), noise), general, general_error[~inside] if general else None
        )
        sides = (
            (rows_of(observed, inside), plain, None),
            (rows_of(corrected, inside), fitted, general_error[inside]),
        )
        for key in CHANNELS:
            for column, (test, model, errors) in enumerate(sides):
                size, dof, squares = _tested(test, noise, model, errors, key)
                sums[key] += np.array([size * (column == 0), size * (column == 1), dof * column])
                if key == "A":
                    square[column] += squares[0]
                    square[2] += squares[1] * column
        count += 2 * int(inside.sum())
    before = {key: float(np.sqrt(v[0] / v[2])) for key, v in sums.items() if v[2] > 0}
    after = {key: float(np.sqrt(v[1] / v[2])) for key, v in sums.items() if v[2] > 0}
    floor = {key: float(np.sqrt(1 + 1.96 * np.sqrt(2 / v[2]))) for key, v in sums.items() if v[2] > 0}
    first, last, least = 1e3 * np.sqrt(square / count)
    return HeldOut(before, after, floor, (float(first), float(last), float(least)))


def _tested(
    test: Observation, noise: Noise, model: JointFit, model_error: np.ndarray | None, channels: str
) -> tuple[float, int, tuple[float, float]]:
    """Compute chi-square of held-out postures under a fit to the others.

    Parameters of the held-out postures that the fit does not contain (the swing foot's pose) are projected
    out. Those that it estimates with an error (base parameters, weight) widen the expected residual.

    Returns:
        chi-square, its degrees of freedom, and the sum of squares of channel A and of its noise [m2].
    """
    trained = model.linear
    explained = model_error @ with_constant(model.terms) if model_error is not None and model.terms else None
    # Readings are smoothed with the effects removed; under the wrong model, smoothing would take off signal.
    about = linear_model(
        remove_terms(test, test, model.terms),
        noise,
        propagation=propagation(test, model.terms) if model.terms else None,
        explained=explained,
    )
    smoothed = unpacked(test, packed(test) - (packed(about.observed) - packed(about.smoothed)))
    clean = remove_terms(test, test, model.terms)
    still = remove_terms(smoothed, smoothed, model.terms)
    derivative = propagation(smoothed, model.terms) if model.terms else None
    white = whitening(still, trained.theta, noise, channels, derivative)
    raw = residuals(clean, trained.theta)
    if explained is not None:
        raw = raw - explained
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


def _shared(linear: LinearModel, p: int) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the base parameters and the weight error by a fit.

    Args:
        p: number of base parameters.

    Returns:
        their covariance, (p + 1, p + 1), and their last step, (p + 1,).
    """
    smoothed = linear.smoothed
    columns = nuisances(smoothed, "AFTC")
    whole = np.vstack([linear.whitening(columns), weighing(smoothed)[None]])
    used = np.abs(whole).max(axis=0) > 0
    shared = np.append(np.arange(p), whole.shape[1] - 1)
    places = np.setdiff1d(np.flatnonzero(used), shared)
    basis = np.linalg.qr(whole[:, places])[0]
    known = whole[:, shared] - basis @ (basis.T @ whole[:, shared])
    start = np.append(linear.whitening(residuals(linear.observed, linear.theta)), 0.0)
    spread = np.linalg.pinv(known.T @ known, hermitian=True)
    return spread, -spread @ (known.T @ start)
