"""Which explanations are as good as the adopted ones, once the laboratory has been asked about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.discovery.fit import Fit, Term, fit
from experiments.discovery.laboratory import refit
from experiments.discovery.noise import Noise
from experiments.discovery.steps import DECISIVE, Rival
from experiments.effects.seen import Seen

NEAR = 7.0  # ln of the Bayes factor by formulas, from which the laboratory is not asked any more
ASKED = 4  # of one gap, at most


def alike(rivals: tuple[Rival, ...], adopted: Term) -> tuple[Rival, ...]:
    """Explanations within `DECISIVE` of the best.

    The adopted one is always of its own set: if another is better by far, that must be seen.
    """
    least = rivals[0].log_bayes_factor - DECISIVE
    label = adopted.candidate.label
    return tuple(r for r in rivals if r.log_bayes_factor > least or r.label == label)


def settle(
    seen: Seen, noise: Noise, found: Fit, rivals: tuple[tuple[Rival, ...], ...]
) -> tuple[Fit, np.ndarray, tuple[tuple[Rival, ...], ...]]:
    """Fit anew through the laboratory, for every gap with the explanation that is best there.

    Args:
        rivals: for every term, by formulas, see `steps.Explanation`.

    Returns:
        the fit, what its predictions miss there (see `laboratory.refit`), and for every term the
        explanations that are as good.
    """
    formula = fit(seen, noise, found.terms)
    best, bend = refit(seen, noise, formula)
    sets = []
    for k, near in enumerate(rivals):
        label = best.terms[k].candidate.label
        near = tuple(
            r for r in near if r.log_bayes_factor > near[0].log_bayes_factor - NEAR or r.label == label
        )
        gained = best.log_bayes_factor - formula.log_bayes_factor
        judged = [replace(r, log_bayes_factor=r.log_bayes_factor + gained) for r in near if r.label == label]
        for rival in [r for r in near if r.label != label]:
            if len(judged) > ASKED:
                judged.append(rival)
                continue
            other = fit(seen, noise, (*best.terms[:k], rival.term, *best.terms[k + 1 :]))
            exact, more = refit(seen, noise, other)
            gained = exact.log_bayes_factor - other.log_bayes_factor
            judged.append(replace(rival, log_bayes_factor=rival.log_bayes_factor + gained))
            if judged[-1].log_bayes_factor > max(r.log_bayes_factor for r in judged[:-1]):
                best, formula, bend = exact, other, more
        judged.sort(key=lambda rival: -rival.log_bayes_factor)
        sets.append(alike(tuple(judged), best.terms[k]))
    return best, bend, tuple(sets)
