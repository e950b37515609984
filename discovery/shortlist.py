"""The best candidates of a ranking, fitted without linearising."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.discovery.candidates import Fitted, change_times, log_choices
from tulip_testbed.discovery.columns import CandidateColumns, whitened_columns
from tulip_testbed.discovery.evidence import marginal_fits
from tulip_testbed.discovery.joint_fit import JointFit, gauss_newton, joint_fit

LONGEST = 12
WITHIN = 15.0  # ln of the Bayes factor by linear columns, of candidates that are shortlisted
CLOSE = 10.0  # ln of the Bayes factor, of candidates that are fitted with their own noise covariance
KINDS = 4  # of effects, at most, that are fitted so
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


def best_addition(
    adopted: JointFit, ranked: list[Fitted], model_error: np.ndarray | None = None
) -> tuple[Fitted, JointFit | None] | None:
    """Return the best of a ranking, and its joint fit with the adopted terms if there was need of it.

    Of different kinds that are close to one another, it is the one with the highest evidence in a joint fit.

    Args:
        model_error: of the adopted terms' predictions, see `gauss_newton`.
    """
    short = shortlist(adopted, ranked)
    kinds: dict[str, Fitted] = {}
    for one in short:
        if one.log_bayes_factor > short[0].log_bayes_factor - CLOSE:
            kinds.setdefault(one.candidate.effect.name, one)
    near = list(kinds.values())[:KINDS]
    if len(near) < 2:
        return (near[0], None) if near else None
    data, terms = adopted.data, adopted.terms
    before = adopted.repeated if model_error is None else joint_fit(data, terms, model_error)
    tried = [joint_fit(data, (*terms, one), _extended(model_error, one)) for one in near]
    best = int(np.argmax([fit.log_evidence for fit in tried]))
    factor = tried[best].log_evidence - before.log_evidence
    return replace(near[best], log_bayes_factor=factor), tried[best] if model_error is None else None


def _extended(model_error: np.ndarray | None, term: Fitted) -> np.ndarray | None:
    """Extend the model error by a term whose prediction holds."""
    if model_error is None:
        return None
    own = np.zeros((*model_error.shape[:2], len(term.sizes)))
    return np.concatenate([model_error[..., :-1], own, model_error[..., -1:]], axis=-1)


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
