"""The best candidates of a ranking, fitted without linearising."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.discovery.candidates import Fitted, change_times, log_choices
from tulip_testbed.discovery.columns import CandidateColumns, whitened_columns
from tulip_testbed.discovery.evidence import marginal_fits
from tulip_testbed.discovery.joint_fit import JointFit, gauss_newton

LONGEST = 12
WITHIN = 15.0  # ln of the Bayes factor by linear columns, of candidates that are shortlisted
TIMES = 60  # between postures, at most, that are tried for a change in time


def shortlist(adopted: JointFit, ranked: list[Fitted]) -> list[Fitted]:
    """Fit the best of a ranking without linearising.

    Args:
        adopted: the fit in addition to which they explain the experiment.

    Returns:
        at most `LONGEST`, the best first.
    """
    if not ranked or not ranked[0].detectable:
        return []
    least = 0.8 * ranked[0].log_bayes_factor - WITHIN
    near = [one for one in ranked if one.log_bayes_factor > least and one.detectable]
    out = [fit_in_addition(adopted, at_best_time(adopted, one)) for one in near[:LONGEST]]
    return sorted(out, key=lambda one: -one.log_bayes_factor)


def fit_in_addition(adopted: JointFit, term: Fitted) -> Fitted:
    """Fit one more term without linearising, while the sizes of the adopted ones may change.

    Its Bayes factor is that of its best point; ln of the number of times or points is subtracted.
    """
    linear = adopted.partialled_out
    found = gauss_newton(linear, (term,))
    return replace(
        found.terms[0],
        log_bayes_factor=found.log_bayes_factor - log_choices(term.candidate, linear.observed),
        gain=linear.chi_square - found.chi_square,
    )


def at_best_time(adopted: JointFit, one: Fitted) -> Fitted:
    """Move a change in time to the two postures between which it explains most.

    The grid of the catalogue is too coarse to tell them.
    """
    linear, candidate, timed = adopted.linear, one.candidate, one.candidate.time_parameter
    times = change_times(candidate, linear.observed)
    if timed is None or not len(times):
        return one
    chosen = candidate.settings[one.point]
    near = times[np.argsort(np.abs(times - chosen[timed]))[:TIMES]]
    settings = np.repeat(chosen[None], len(near), axis=0)
    settings[:, timed] = near
    finer = replace(candidate, settings=settings)
    basis = np.linalg.qr(adopted.columns)[0]
    points = [linear.project(column) for column in whitened_columns(linear, [finer])]
    projected = [column - basis @ (basis.T @ column) for column in points]
    return marginal_fits(CandidateColumns([finer], [projected]), adopted.residual)[0]
