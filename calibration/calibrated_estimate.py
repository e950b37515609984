"""The self-calibrating estimator: base parameters of the full and the simplified model."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.families import TOLERANCES
from tulip_testbed.calibration.self_calibration import as_log_shows, least_determined, self_calibrate
from tulip_testbed.calibration.uncertain_corrections import changes_by_corrections, with_uncertain_corrections
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.regressor import Regression, with_cad_where_needed
from tulip_testbed.identification.residual_channels import residuals

Calibrate = Callable[[Observation, Mapping[str, float] | None], SelfCalibration]

SELF_CALIBRATING = "self-calibrating"
SUMMARY = "Base parameters and ordinary imperfections in one estimate, with all channels of the data."


@one_blas_thread
def calibrated_estimates(
    observed: Observation,
    data: Regression,
    kept: Sequence[int],
    tolerances: Mapping[str, float] | None = None,
    calibrate: Calibrate = self_calibrate,
    corrections: Sequence[EffectInstance] = (),
) -> tuple[Estimate, Estimate, SelfCalibration]:
    """Estimate the full and the simplified model with all families of ordinary imperfections.

    Args:
        observed: the experiment. data: its regression.
        kept: numbers of the simplified model's parameters.
        tolerances: see `self_calibrate`.
        calibrate: `self_calibrate`, or what does the same in gross faults too.
        corrections: effects that were removed from the experiment; how uncertain they are counts.

    Raises:
        InputError: the data say nothing about the base parameters, or an impossible tolerance.
    """
    observed = with_cad_where_needed(observed, data)
    try:
        observed, found = as_log_shows(observed, tolerances)
        known = calibrate if found is None else lambda *_: found
        return _estimates(observed, data, kept, tolerances, known, corrections)
    except np.linalg.LinAlgError:
        excess = _in_excess(observed, data, kept, tolerances, calibrate)
        families = "" if not excess else f" with all families; leave out {listed(excess)} (tolerance 0), or"
        raise InputError(
            f"{data.source}: found {len(observed)} postures, too few or too much alike (or a stated noise "
            f"that is too small) for estimator {SELF_CALIBRATING}{families or ';'} choose another estimator"
        ) from None


def _estimates(
    observed: Observation,
    data: Regression,
    kept: Sequence[int],
    tolerances: Mapping[str, float] | None,
    calibrate: Calibrate = self_calibrate,
    corrections: Sequence[EffectInstance] = (),
) -> tuple[Estimate, Estimate, SelfCalibration]:
    plain = calibrate(observed, tolerances)
    changes = changes_by_corrections(plain, corrections)
    calibration = with_uncertain_corrections(plain, changes)
    full = estimate_of(calibration, data)
    if len(kept) == len(data.numbers) or observed.cad is not None:
        return full, full, calibration
    columns = [int(np.flatnonzero(data.numbers == number)[0]) for number in kept]
    simplified = with_uncertain_corrections(plain.keep(columns), changes)
    return full, estimate_of(simplified, data.keep(list(kept))), calibration


def _in_excess(
    observed: Observation,
    data: Regression,
    kept: Sequence[int],
    tolerances: Mapping[str, float] | None,
    calibrate: Calibrate,
) -> tuple[str, ...]:
    """Find families without which the estimate succeeds: one if that suffices, the least determined first.

    Returns:
        their names; empty if not even a laboratory without any imperfection can be estimated.
    """
    names = [name for name in least_determined(observed, tolerances) if name in TOLERANCES]
    several = [tuple(names[: k + 1]) for k in range(1, len(names))]
    for chosen in [*((name,) for name in names), *several]:
        try:
            _estimates(observed, data, kept, {**(tolerances or {}), **dict.fromkeys(chosen, 0.0)}, calibrate)
        except np.linalg.LinAlgError:
            continue
        return chosen
    return ()


def estimate_of(calibration: SelfCalibration, data: Regression) -> Estimate:
    """Return the estimate of the base parameters as the other estimators give it.

    Residuals are those of the centre of pressure with the members removed.
    """
    theta = np.zeros(calibration.observed.geometry.regressor.shape[2])
    theta[data.numbers - 1] = calibration.theta
    residual = residuals(calibration.observed, theta)[:, :2].ravel()
    cad = calibration.observed.cad
    shares = None if cad is None else cad.direction_shares(calibration.covariance)
    dof = len(residual) - (len(calibration.theta) if shares is None else round(float(shares.sum())))
    right, left = (float(np.sqrt((sd[:2] ** 2).mean())) for sd in calibration.noise.plates.reshape(2, 3))
    return Estimate(
        numbers=data.numbers,
        names=data.names,
        value=calibration.theta,
        covariance=calibration.covariance,
        clustered_covariance=calibration.covariance,
        residual=residual,
        sigma=float(np.sqrt(residual @ residual / dof)),
        placement_sd=(right, left),
        dof=dof,
        interval_dof=calibration.interval_dof,
        joint_dof=calibration.joint_dof,
        condition_number=float(np.linalg.cond(data.matrix)),
        unseen=calibration.unseen,
        data_share=None if cad is None else cad.data_share(calibration.covariance),
        direction_shares=shares,
        cad_scales=None if cad is None else cad.scales,
    )
