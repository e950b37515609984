"""Which explanations are as good as the adopted ones, once the laboratory has been asked about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.discovery.fit import Fit, Term, fit
from tulip_testbed.discovery.ranking import Rival, worth
from tulip_testbed.discovery.refit import refit
from tulip_testbed.discovery.selection import DECISIVE
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_noise import Noise

NEAR = 10.0  # ln of the Bayes factor by formulas, within which others are fitted too
ASKED = 4  # of one gap, through the laboratory, at most


def alike(rivals: tuple[Rival, ...], adopted: Term) -> tuple[Rival, ...]:
    """Explanations within `DECISIVE` of the best.

    The adopted one is always of its own set: if another is better by far, that must be observed.
    """
    least = rivals[0].log_bayes_factor - DECISIVE
    label = adopted.candidate.label
    return tuple(r for r in rivals if r.log_bayes_factor > least or r.label == label)


def settle(
    observed: Observation, noise: Noise, found: Fit, rivals: tuple[tuple[Rival, ...], ...]
) -> tuple[Fit, np.ndarray, tuple[tuple[Rival, ...], ...]]:
    """Fit anew through the laboratory, for every gap with the explanation that is best there.

    Args:
        rivals: for every term, by formulas, see `steps.Explanation`.

    Returns:
        the fit, what its predictions miss there (see `laboratory.refit`), and for every term the
        explanations that are as good.
    """
    best, bend = _better(observed, noise, fit(observed, noise, found.terms))
    sets = []
    for k, near in enumerate(rivals):
        mine = best.terms[k]
        others = fit(observed, noise, best.terms[:k] + best.terms[k + 1 :])
        rest = worth(_better(observed, noise, others)[0] if others.terms else others)
        judged = [Rival(mine, worth(best) - rest)]
        for rival, formula in _fitted(observed, noise, best, k, near):
            exact, more = _better(observed, noise, formula) if len(judged) <= ASKED else (formula, bend)
            judged.append(replace(rival, log_bayes_factor=worth(exact) - rest))
            if len(judged) <= ASKED + 1 and worth(exact) > worth(best):
                best, bend = exact, more
        judged.sort(key=lambda rival: -rival.log_bayes_factor)
        sets.append(alike(tuple(judged), best.terms[k]))
    return best, bend, tuple(sets)


def _better(observed: Observation, noise: Noise, formula: Fit) -> tuple[Fit, np.ndarray]:
    """Through the laboratory, unless the formula explains more: which end a joint's free play rests at, say,
    is an accident in both. Half of what the laboratory changes in a size is the s.d. of what both miss.
    """
    exact, bend = refit(observed, noise, formula)
    sizes = [np.concatenate([term.sizes for term in one.terms]) for one in (exact, formula)]
    missed = np.diag(((sizes[0] - sizes[1]) / 2) ** 2)
    best, bend = (exact, bend) if worth(exact) >= worth(formula) else (formula, np.zeros_like(bend))
    return replace(best, covariance=best.covariance + missed), bend


def _fitted(
    observed: Observation, noise: Noise, found: Fit, k: int, rivals: tuple[Rival, ...]
) -> list[tuple[Rival, Fit]]:
    """Near rivals of term k in its place, the best first."""
    least = rivals[0].log_bayes_factor - NEAR
    have = {term.candidate.label for term in found.terms}
    near = [r for r in rivals if r.log_bayes_factor > least and r.label not in have]
    tried = [(r, fit(observed, noise, (*found.terms[:k], r.term, *found.terms[k + 1 :]))) for r in near]
    return sorted(tried, key=lambda pair: -worth(pair[1]))
