"""All laws of the grammar as candidates, ranked by linear columns.

A reading that errs as a function of a quantity changes the residuals by their sensitivity to the reading,
times the function. A fit needs the products of the columns only, and these follow from the functions and the
products of the sensitivities, which differ from zero within a placement alone. So the columns of laws are
never made: time and memory grow with the postures, not with their square.
"""

from collections import defaultdict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import Columns, Moments, candidate_columns
from tulip_testbed.discovery.evidence import fitted_and_counted, ranked
from tulip_testbed.effects.laws import LAW, Sentence, law_effect
from tulip_testbed.effects.laws import grammar as g
from tulip_testbed.effects.laws.grammar import sentence_of, sentences_in
from tulip_testbed.effects.laws.misread import POSE, quantity, readings
from tulip_testbed.effects.laws.shapes import basis, choices, learned_range, range_names
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, fields
from tulip_testbed.measurements.cells import PLATES

DRAWS = 100  # of noise, for the number of tests among thousands of columns
Known = dict[tuple[Hashable, ...], np.ndarray]  # quantities and functions that were computed before
AT_ONCE = 50  # laws whose functions are held together
KEPT_POINTS = 3  # of a law's grid, with which it is judged


def law_candidates(observed: Observation) -> list[Candidate]:
    """List all laws of the grammar that an experiment may show and the catalogue does not say.

    Each has the price of its kind: ln of the number of sentences about one thing that errs. Joints that are
    not logged have no readings that err, nor angles of which anything could be a function.
    """
    constant = observed.measurements.constant_joints
    found = [
        one
        for one in sentences_in(observed.nominal.robot, observed.measurements.contacts)
        if not one.catalogued
        and one.joint not in constant
        and not (one.kind == g.ENCODER and one.place in constant)
    ]
    alike: dict[str, int] = defaultdict(int)
    for one in found:
        alike[one.what] += 1
    known: Known = {}
    return [_candidate(observed, one, float(np.log(alike[one.what])), known) for one in found]


def _candidate(observed: Observation, sentence: Sentence, price: float, known: Known) -> Candidate:
    """Make a candidate with the grid and the range of the experiment's readings; `known` collects these."""
    effect = law_effect(str(sentence))
    if sentence.kind == g.FORCE:
        tail = np.linspace(0.1, 0.9, 9)[:, None] if sentence.form == g.STEP else np.zeros((1, 0))
        return Candidate(effect, str(sentence), np.hstack([np.zeros((len(tail), 3)), tail]), price)
    x = _of_all_readings(observed, sentence, known)
    key = id(x), sentence.quantity, sentence.form
    if key not in known:
        known[key] = choices(sentence, x)
    ends, fixed = learned_range(sentence, x), known[key]
    sizes = np.zeros((len(fixed), len(effect.sizes)))
    settings = np.hstack([sizes, fixed, np.tile(ends, (len(fixed), 1))])
    return Candidate(effect, str(sentence), settings, price)


def _of_all_readings(observed: Observation, sentence: Sentence, known: Known) -> np.ndarray:
    """Return the quantity of all readings that err one after the other, (k m, d)."""
    key = (sentence.what, sentence.of)
    if key not in known:
        each = [quantity(observed, sentence, at) for at in readings(observed, sentence)]
        found = np.concatenate(each)
        # Others may err as a function of the same: then what follows is computed once.
        known[key] = known.setdefault((found.tobytes(),), found)
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


def _columns(linear: LinearModel, laws: list[Candidate]) -> Iterator[Columns]:
    by_what: dict[str, list[Candidate]] = defaultdict(list)
    for law in laws:
        by_what[law.target.partition("/")[0]].append(law)
    known: Known = {}
    for alike in by_what.values():
        sentence = sentence_of(alike[0].target)
        if sentence.kind == g.FORCE:
            yield candidate_columns(linear, alike)
            continue
        sensitivities = _sensitivities(linear, sentence)
        for k in range(0, len(alike), AT_ONCE):
            some = alike[k : k + AT_ONCE]
            functions = [_functions(linear.smoothed, law, known) for law in some]
            yield _LawColumns(some, linear.basis, sensitivities, functions)


# Basis of the nuisance columns times the derivatives of the residuals by the errors of k readings, (n, k m);
# of every placement the coordinates, the numbers of these errors, and the derivatives.
_Sensitivities = tuple[np.ndarray, list[tuple[slice, np.ndarray, np.ndarray]]]


def _sensitivities(linear: LinearModel, sentence: Sentence) -> _Sensitivities:
    """Differentiate the residuals by what errs, posture by posture, whitened."""
    observed, slope, at = linear.smoothed, linear.whitening.sensitivity, fields(linear.observed)
    if sentence.kind == g.PLATE:
        first = at["plates"].start + len(POSE) * PLATES.index(sentence.place)
        columns = [first + k for k in range(len(POSE))]
    else:
        first = at["angles" if sentence.kind in (g.ENCODER, g.ENCODERS) else "cells"].start
        columns = [first + k for k in readings(observed, sentence)]
    m, blocks = len(observed), []
    nuisance = np.zeros((linear.basis.shape[1], len(columns) * m))
    for where, numbers, factor in linear.whitening.blocks:
        inside = np.unique(numbers // SIZE)
        raw = np.zeros((len(inside), SIZE, len(columns), len(inside)))
        every = np.arange(len(inside))
        raw[every, :, :, every] = slope[inside][:, :, columns]
        place = np.searchsorted(inside, numbers // SIZE) * SIZE + numbers % SIZE
        derivative = factor @ raw.reshape(len(inside) * SIZE, -1)[place]
        errors = (np.arange(len(columns))[:, None] * m + inside).ravel()
        nuisance[:, errors] = linear.basis[where].T @ derivative
        blocks.append((where, errors, derivative))
    return nuisance, blocks


@dataclass(frozen=True)
class _LawColumns:
    """The columns of laws about the same readings, as far as their fits need them.

    Attributes:
        basis: orthonormal, of the nuisance columns, (r + e, n).
        functions: errors of all readings by a unit of each size, by law and grid, (k m, s) each.
    """

    candidates: list[Candidate]
    basis: np.ndarray
    sensitivities: _Sensitivities
    functions: list[list[np.ndarray]]

    @property
    def count(self) -> int:
        """Return the number of rows, r + e."""
        return len(self.basis)

    def moments(self, whitened: np.ndarray) -> list[list[Moments]]:
        """Multiply columns by themselves and by others, (r + e, d), see `CandidateColumns`."""
        nuisance, blocks = self.sensitivities
        whitened = whitened - self.basis @ (self.basis.T @ whitened)
        flat = [one for each in self.functions for one in each]
        whole = np.concatenate(flat, axis=1)
        image, pull = np.empty_like(whole), np.empty((len(whole), whitened.shape[1]))
        for where, errors, derivative in blocks:
            image[errors] = derivative.T @ (derivative @ whole[errors])
            pull[errors] = derivative.T @ whitened[where]
        image -= nuisance.T @ (nuisance @ whole)
        ends, pulls = np.cumsum([one.shape[1] for one in flat]).tolist(), whole.T @ pull
        parts = [slice(end - one.shape[1], end) for one, end in zip(flat, ends, strict=True)]
        each = iter([(f.T @ image[:, at], pulls[at]) for f, at in zip(flat, parts, strict=True)])
        return [[next(each) for _ in points] for points in self.functions]


def _functions(observed: Observation, law: Candidate, known: Known) -> list[np.ndarray]:
    """Compute the errors of all readings one after the other by a unit of each size, (k m, s), by grid."""
    sentence = sentence_of(law.target)
    x = _of_all_readings(observed, sentence, known)
    first, ends = len(law.effect.sizes), len(range_names(sentence))
    out = []
    for row in law.settings:
        key = id(x), sentence.quantity, sentence.form, row[first:].tobytes()
        if key not in known:
            known[key] = basis(sentence, x, row[first : len(row) - ends], row[len(row) - ends :])
        found = known[key]
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
