"""Which explanations are as good as the adopted ones, judged through the static laboratory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.discovery.candidate_search import DECISIVE
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.joint_fit import JointFit, joint_fit
from tulip_testbed.discovery.refit import refit

SHARED = 0.5  # of the change that the laboratory makes in a size: s.d. of the error that it shares
NEAR = 10.0  # ln of the Bayes factor by predictions, within which alternatives are fitted
MOST_REFITS = 4  # alternatives of one term that are fitted through the laboratory


def equivalent(alternatives: tuple[Fitted, ...], adopted: Fitted) -> tuple[Fitted, ...]:
    """Return the alternatives within `DECISIVE` of the best, and the adopted one in any case.

    Args:
        alternatives: the best first.
    """
    least = alternatives[0].log_bayes_factor - DECISIVE
    return tuple(a for a in alternatives if a.log_bayes_factor > least or a.label == adopted.label)


def refit_with_alternatives(
    found: JointFit, alternatives: tuple[tuple[Fitted, ...], ...]
) -> tuple[JointFit, np.ndarray, np.ndarray, tuple[tuple[Fitted, ...], ...]]:
    """Fit again through the laboratory, with the alternative of each term that is best there.

    Args:
        alternatives: of each term, by their predictions, see `Selection`.

    Returns:
        the fit, the model error of its predictions, the s.d. of the error that laboratory and predictions
        share, (s,), and the equivalent explanations of each term.
    """
    best, model_error, shared = refit_if_better(found.repeated)
    sets = []
    for k, near in enumerate(alternatives):
        mine = best.terms[k]
        others = best.without(k)
        rest = (refit_if_better(others)[0] if others.terms else others).log_evidence
        judged = [replace(mine, log_bayes_factor=best.log_evidence - rest)]
        for alternative, formula in _in_place_of(best, k, near):
            asked = len(judged) <= MOST_REFITS
            exact, errors, doubt = refit_if_better(formula) if asked else (formula, model_error, shared)
            judged.append(replace(alternative, log_bayes_factor=exact.log_evidence - rest))
            if asked and exact.log_evidence > best.log_evidence:
                best, model_error, shared = exact, errors, doubt
        judged.sort(key=lambda one: -one.log_bayes_factor)
        sets.append(equivalent(tuple(judged), best.terms[k]))
    return best, model_error, shared, tuple(sets)


def refit_if_better(formula: JointFit) -> tuple[JointFit, np.ndarray, np.ndarray]:
    """Fit through the laboratory, unless the prediction explains more.

    At which end of its free play a joint rests, for example, is an accident in both. Half of the change that
    the laboratory makes in a size counts as a standard deviation of the error that both share.
    """
    exact, model_error = refit(formula)
    shared = SHARED * np.abs(exact.sizes - formula.sizes)
    better = exact.log_evidence >= formula.log_evidence
    best, errors = (exact, model_error) if better else (formula, np.zeros_like(model_error))
    return replace(best, covariance=best.covariance + np.diag(shared**2)), errors, shared


def _in_place_of(found: JointFit, k: int, alternatives: tuple[Fitted, ...]) -> list[tuple[Fitted, JointFit]]:
    """Fit the near alternatives of term k in its place, the best first."""
    least = alternatives[0].log_bayes_factor - NEAR
    near = [a for a in alternatives if a.log_bayes_factor > least and a.label not in found.labels]
    tried = [(a, joint_fit(found.data, (*found.terms[:k], a, *found.terms[k + 1 :]))) for a in near]
    return sorted(tried, key=lambda pair: -pair[1].log_evidence)
