"""Judge laws and effects, at a glance first; and compare the base parameters of those that do as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.discovery.candidate_search import DECISIVE, RESTS, Judged, Search
from tulip_testbed.discovery.candidates import Candidate, Fitted

NEAR = 15.0  # ln of the evidence at a glance, by which others that are judged may lie below the best
GLANCED = 0.2  # of the best gain at a glance: by so much more


@dataclass(frozen=True)
class LawSearch:
    """A search for laws.

    Attributes:
        alone: the laws ranked as if everything else were exact.
        start: without laws or effects.
        tests: effective number of independent tests among the candidates of the catalogue and the laws.
        known: what was judged before in addition to some terms, by their labels.
    """

    search: Search
    laws: list[Candidate]
    alone: list[Fitted]
    start: SelfCalibration
    tests: float
    known: dict[tuple[str, ...], list[Judged]] = field(default_factory=dict)


def judged(
    every: LawSearch, terms: tuple[Fitted, ...], near: list[tuple[Fitted, bool]], best: float = -np.inf
) -> list[Judged]:
    """Judge what is promising at a glance, each in addition to some terms.

    A glance costs a fifth of a judgement. About a start at rest it misses the evidence by 3 at most where
    the gap is small, by a small part of the gain where it is large. Other starts it does not serve.

    Args:
        near: with each, whether it is judged without the members of the start.
        best: ln of the evidence for the best of what they compete with.
    """
    search = every.search
    if every.start.moved < RESTS:
        plain = search.glanced(terms, every.start)
        seen = [search.glanced((*terms, one), every.start) for one, _ in near]
        best = max([best, *seen])
        least = max(plain, best - NEAR - GLANCED * max(best - plain, 0.0))
        near = [one for one, evidence in zip(near, seen, strict=True) if evidence > least]
    tried = [search.tried((*terms, one), every.start, afresh) for one, afresh in near]
    return [one for one in tried if one is not None and one.possible]


def as_good(every: LawSearch, found: Judged) -> list[Judged]:
    """List what was judged to do as well with as many terms, all but one of them the same."""
    labels = {term.label for term in found.terms}
    return [
        one
        for several in every.known.values()
        for one in several
        if one.steady
        and one.evidence > found.evidence - DECISIVE
        and len(one.terms) == len(found.terms)
        and len(labels - {term.label for term in one.terms}) <= 1
    ]


def disagreement(found: Judged, others: Sequence[Judged]) -> float:
    """Compute how far others' base parameters lie from those that were found.

    Returns:
        the largest root mean square, in standard errors; 0: there are no others.
    """
    error = np.sqrt(np.diag(found.calibration.covariance))
    off = [(one.calibration.theta - found.calibration.theta) / error for one in others]
    return max((float(np.sqrt((one**2).mean())) for one in off), default=0.0)
