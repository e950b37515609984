"""All laws of the grammar as candidates, ranked by linear columns.

A reading that errs as a function of a quantity changes the residuals by their sensitivity to the reading,
times the function. So the sensitivities are whitened and projected once for each reading, one column per
posture, and the column of a law is their combination by its function.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import CandidateColumns, candidate_columns
from tulip_testbed.discovery.evidence import fitted_and_counted, ranked
from tulip_testbed.effects.laws import LAW, Sentence, law_effect
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import sentences_in
from tulip_testbed.effects.laws.misread import POSE, quantity, readings
from tulip_testbed.effects.laws.shapes import basis, choices, learned_range, range_names
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, fields
from tulip_testbed.measurements.cells import PLATES

DRAWS = 100  # of noise, for the number of tests among thousands of columns
KEPT_POINTS = 3  # of a law's grid, with which it is judged


def law_candidates(observed: Observation) -> list[Candidate]:
    """List all laws of the grammar that an experiment may show and the catalogue does not say.

    Each has the price of its kind: ln of the number of sentences about one thing that errs.
    """
    found = [
        one
        for one in sentences_in(observed.nominal.robot, observed.measurements.contacts)
        if not one.catalogued
    ]
    alike: dict[str, int] = defaultdict(int)
    for one in found:
        alike[one.what] += 1
    known: dict[tuple[str, ...], np.ndarray] = {}
    return [_candidate(observed, one, float(np.log(alike[one.what])), known) for one in found]


def _candidate(
    observed: Observation, sentence: Sentence, price: float, known: dict[tuple[str, ...], np.ndarray]
) -> Candidate:
    """Make a candidate with the grid and the range of the experiment's readings; `known` collects these."""
    effect = law_effect(str(sentence))
    if sentence.kind == g.FORCE:
        tail = np.linspace(0.1, 0.9, 9)[:, None] if sentence.form == g.STEP else np.zeros((1, 0))
        return Candidate(effect, str(sentence), np.hstack([np.zeros((len(tail), 3)), tail]), price)
    x = _of_all_readings(observed, sentence, known)
    ends = learned_range(sentence, x)
    fixed = choices(sentence, x)
    sizes = np.zeros((len(fixed), len(effect.sizes)))
    settings = np.hstack([sizes, fixed, np.tile(ends, (len(fixed), 1))])
    return Candidate(effect, str(sentence), settings, price)


def _of_all_readings(
    observed: Observation, sentence: Sentence, known: dict[tuple[str, ...], np.ndarray]
) -> np.ndarray:
    """Return the quantity of all readings that err one after the other, (k m, d)."""
    key = (sentence.what, sentence.of)
    if key not in known:
        each = [quantity(observed, sentence, at) for at in readings(observed, sentence)]
        known[key] = np.concatenate(each)
    return known[key]


def ranked_laws(linear: LinearModel, laws: list[Candidate]) -> list[Fitted]:
    """Fit each law alone to the residual of a linear model; the best first."""
    return ranked(_columns(linear, laws), linear.residual)


def ranked_and_counted(
    linear: LinearModel, laws: list[Candidate], rng: np.random.Generator
) -> tuple[list[Fitted], float]:
    """Rank laws, and estimate the effective number of independent tests among them and their grids."""
    fits, tests = fitted_and_counted(_columns(linear, laws), linear.residual, rng, DRAWS)
    return sorted(fits, key=lambda one: -one.log_bayes_factor), tests


def _columns(linear: LinearModel, laws: list[Candidate]) -> Iterator[CandidateColumns]:
    by_what: dict[str, list[Candidate]] = defaultdict(list)
    for law in laws:
        by_what[law.target.partition("/")[0]].append(law)
    known: dict[tuple[str, ...], np.ndarray] = {}
    for alike in by_what.values():
        sentence = _sentence(alike[0])
        if sentence.kind == g.FORCE:
            yield candidate_columns(linear, alike)
        else:
            yield _of_readings(linear, alike, _sensitivities(linear, sentence), known)


def _sensitivities(linear: LinearModel, sentence: Sentence) -> np.ndarray:
    """Differentiate the residuals by what errs, posture by posture, whitened and projected, (r + e, k m)."""
    observed, slope, at = linear.smoothed, linear.whitening.sensitivity, fields(linear.observed)
    if sentence.kind == g.PLATE:
        first = at["plates"].start + len(POSE) * PLATES.index(sentence.place)
        columns = [first + k for k in range(len(POSE))]
    else:
        first = at["angles" if sentence.kind in (g.ENCODER, g.ENCODERS) else "cells"].start
        columns = [first + k for k in readings(observed, sentence)]
    m = len(observed)
    raw = np.zeros((m, SIZE, len(columns), m))
    every = np.arange(m)
    raw[every, :, :, every] = slope[:, :, columns]
    return linear.project(linear.whitening(raw.reshape(m, SIZE, -1)))


def _of_readings(
    linear: LinearModel,
    laws: list[Candidate],
    sensitivities: np.ndarray,
    known: dict[tuple[str, ...], np.ndarray],
) -> CandidateColumns:
    """Compute the columns of laws about the same reading or readings."""
    observed = linear.smoothed
    functions = [_functions(observed, law, known) for law in laws]
    flat = [one for each in functions for one in each]
    whole = sensitivities @ np.concatenate(flat, axis=1)
    parts = iter(np.split(whole, np.cumsum([one.shape[1] for one in flat])[:-1], axis=1))
    return CandidateColumns(laws, [[next(parts) for _ in each] for each in functions])


def _functions(
    observed: Observation, law: Candidate, known: dict[tuple[str, ...], np.ndarray]
) -> list[np.ndarray]:
    """Compute the errors of all readings one after the other by a unit of each size, (k m, s), by grid."""
    sentence = _sentence(law)
    x = _of_all_readings(observed, sentence, known)
    first, ends = len(law.effect.sizes), len(range_names(sentence))
    out = []
    for row in law.settings:
        found = basis(sentence, x, row[first : len(row) - ends], row[len(row) - ends :])
        if sentence.scales:
            found = found * observed.cell_forces[:, readings(observed, sentence)].T.reshape(-1, 1)
        out.append(np.kron(np.eye(len(POSE)), found) if sentence.kind == g.PLATE else found)
    return out


def with_best_points(law: Fitted) -> Fitted:
    """Return a law whose grid is its best point and the neighbours of that, at the same price in all."""
    candidate, count = law.candidate, len(law.candidate.settings)
    if count <= KEPT_POINTS:
        return law
    first = min(max(law.point - KEPT_POINTS // 2, 0), count - KEPT_POINTS)
    kept = replace(
        candidate,
        settings=candidate.settings[first : first + KEPT_POINTS],
        price=candidate.price + float(np.log(count / KEPT_POINTS)),
    )
    return replace(law, candidate=kept, point=law.point - first)


def is_law(one: Candidate) -> bool:
    """Return whether a candidate is a law."""
    return one.effect.name == LAW


def _sentence(law: Candidate) -> Sentence:
    return Sentence(*law.target.split("/"))
