"""The uncertainty of corrections that were removed from measurements, carried to the base parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.calibration_result import HALF_95, SelfCalibration
from tulip_testbed.calibration.families import families_in
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.effects.instance import EffectInstance, effect_label, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import residuals_in_use, sensitivity

YIELDING = ("joint-compliance", "sole-compliance")


def but_for_compliances(
    observed: Observation,
    corrections: Sequence[EffectInstance],
    tolerances: Mapping[str, float] | None = None,
) -> Observation:
    """Return an experiment with effects removed, but for compliances whose families are estimated.

    The noise of the loads passes through a compliance into the residuals, so the calibration has to know it.

    Args:
        tolerances: see `self_calibrate`.
    """
    families = families_in(observed, usual_tolerances(observed, tolerances))
    members = {effect_label(one.name, t) for one in families if one.name in YIELDING for t in one.targets}
    others = [one for one in corrections if one.label not in members]
    compliances = {one.label: one.values for one in corrections if one.label in members}
    return removed(observed, others).changed(compliances=compliances)


def changes_by_corrections(calibration: SelfCalibration, corrections: Sequence[EffectInstance]) -> np.ndarray:
    """Differentiate the residuals by the sizes that were removed before, times their s.e., (m, 11, s).

    Sizes without an interval are exact.

    Args:
        calibration: of all base parameters. corrections: effects that were removed from its measurements.
    """
    smooth = calibration.linear.smooth
    free = [FreeEffect(one) for one in corrections if one.intervals]
    used = residuals_in_use(smooth)[..., None]
    slope = used * sensitivity(smooth, calibration.theta)
    columns = [used * member_columns(smooth, calibration.theta, slope, one) for one in free]
    errors = np.array([error for one in free for error in _standard_errors(one)])
    return np.concatenate([slope[..., :0], *columns], axis=2) * errors


def with_uncertain_corrections(calibration: SelfCalibration, changes: np.ndarray) -> SelfCalibration:
    """Return a calibration whose covariance holds the uncertainty of what was removed before.

    The sizes stay as they are (the "consider" parameters of Schmidt 1966). Where they were found in the same
    measurements together with the base parameters, the sum of both parts is the covariance of that joint
    estimate; where they come from others, it is that of an estimate that trusts them. Different sizes are
    taken as independent.

    Args:
        changes: see `changes_by_corrections`.
    """
    if not changes.any():
        return calibration
    problem, solved = calibration.problem, calibration.solved
    changes = changes if problem.in_time is None else problem.in_time(changes)
    problem = problem.decorrelated()
    weighted = problem.noise.weights(np.log(solved.scales))(changes)
    width = problem.whole.shape[2] - 1
    pull = problem.whole[..., :-1].reshape(-1, width).T @ weighted.reshape(-1, changes.shape[2])
    shift = (solved.conditional @ pull)[: len(calibration.theta)]
    covariance = calibration.covariance + shift @ shift.T
    part = (shift**2).sum(axis=1) / np.diag(covariance)
    return replace(
        calibration,
        covariance=covariance,
        sources=(*calibration.sources, "corrections"),
        shares=np.vstack([calibration.shares * (1 - part), part]),
    )


def _standard_errors(free: FreeEffect) -> list[float]:
    """Return the s.e. of every size; that of a positive one by the longer half of its interval."""
    start = free.start
    known = ((start.values[k], start.intervals[k] or (start.values[k],) * 2) for k in free.effect.sizes)
    return [max(high - at, at - low) / HALF_95 for at, (low, high) in known]
