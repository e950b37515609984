"""Cross-validation over placements: do the effects predict placements that took no part in the fit?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel, linear_model, nuisances, weighing
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.joint_fit import (
    Data,
    JointFit,
    joint_fit,
    propagation,
    remove_terms,
    with_constant,
)
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import ROWS, packed, residuals, unpacked
from tulip_testbed.identification.residual_noise import Whitening, whitening
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
    sums, squares, count = {key: np.zeros(3) for key in CHANNELS}, np.zeros(3), 0
    for k in range(FOLDS):
        inside = fold == k
        null = Data(rows_of(observed, ~inside), noise).null
        plain = fitted = _prediction(rows_of(observed, inside), null, None)
        if terms:
            others = Data(rows_of(corrected, ~inside), noise)
            model = joint_fit(others, general, general_error[~inside] if general else None)
            fitted = _prediction(rows_of(corrected, inside), model, general_error[inside])
        for key in CHANNELS:
            (before, _), (after, dof) = plain.chi_square(key), fitted.chi_square(key)
            sums[key] += before, after, dof
        squares += plain.squares[0], *fitted.squares
        count += 2 * int(inside.sum())
    sums = {key: total for key, total in sums.items() if total[2] > 0}
    first, last, least = 1e3 * np.sqrt(squares / count)
    return HeldOut(
        before={key: float(np.sqrt(before / dof)) for key, (before, _, dof) in sums.items()},
        after={key: float(np.sqrt(after / dof)) for key, (_, after, dof) in sums.items()},
        floor={key: float(np.sqrt(1 + 1.96 * np.sqrt(2 / dof))) for key, (_, _, dof) in sums.items()},
        millimetres=(float(first), float(last), float(least)),
    )


@dataclass(frozen=True)
class _Prediction:
    """Held-out postures under a fit to the others.

    Attributes:
        residual: with the effects removed, (m, 11).
        columns: of the base parameters and the weight error, (m, 11, p + 1). covariance: of their estimates.
        poses: columns of the swing foot's pose in each stance, (m, 11, k).
        whitening: of the residuals in all channels, without the error of the estimates.
    """

    residual: np.ndarray
    columns: np.ndarray
    covariance: np.ndarray
    poses: np.ndarray
    whitening: Whitening

    def chi_square(self, channels: str) -> tuple[float, int]:
        """Compute chi-square of some channels and its degrees of freedom.

        Parameters of the held-out postures that the fit does not contain (the swing foot's pose) are
        projected out. Those that it estimates with an error widen the expected residual.
        """
        white = self.whitening if channels == "AFTC" else self.whitening.of_channels(channels)
        start, reach, poses = white(self.residual), white(self.columns), white(self.poses)
        poses = poses[:, np.abs(poses).max(axis=0) > 0] if poses.size else poses
        basis = np.linalg.qr(poses)[0]
        start, reach = start - basis @ (basis.T @ start), reach - basis @ (basis.T @ reach)
        covariance = np.eye(len(start)) + reach @ self.covariance @ reach.T
        return float(start @ np.linalg.solve(covariance, start)), len(start) - basis.shape[1]

    @property
    def squares(self) -> tuple[float, float]:
        """Return the sum of squares of channel A's residuals and of their noise [m2]."""
        levers = self.whitening.levers
        own = (self.whitening.own + levers @ levers.mT)[:, :2, :2]
        wide = self.columns[:, ROWS["A"]]
        own = own + wide @ self.covariance @ wide.mT
        noise = float(np.trace(own, axis1=1, axis2=2).sum())
        return float((self.residual[:, ROWS["A"]] ** 2).sum()), noise


def _prediction(test: Observation, model: JointFit, model_error: np.ndarray | None) -> _Prediction:
    """Remove the effects of a fit from held-out postures.

    Args:
        model_error: of its terms' predictions for these postures.
    """
    trained, terms, noise = model.linear, model.terms, model.data.noise
    explained = model_error @ with_constant(terms) if model_error is not None and terms else None
    clean = remove_terms(test, test, terms)
    # Readings are smoothed with the effects removed; under the wrong model, smoothing would take off signal.
    about = linear_model(
        clean,
        noise,
        propagation=propagation(test, terms) if terms else None,
        explained=explained,
    )
    smoothed = unpacked(test, packed(test) - (packed(about.observed) - packed(about.smoothed)))
    still = remove_terms(smoothed, smoothed, terms)
    derivative = propagation(smoothed, terms) if terms else None
    residual = residuals(clean, trained.theta)
    if explained is not None:
        residual = residual - explained
    columns, p = nuisances(still, "AFTC"), len(trained.theta)
    shared = np.append(np.arange(p), columns.shape[-1] - 1)
    covariance, step = _shared(trained, p)
    return _Prediction(
        residual=residual + columns[..., shared] @ step,
        columns=columns[..., shared],
        covariance=covariance,
        poses=np.delete(columns, shared, axis=-1),
        whitening=whitening(still, trained.theta, noise, "AFTC", derivative),
    )


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
