"""The inputs of a search for effects: candidates in order of promise, and the evidence for a choice."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tulip_testbed.base.budget import ROWS, Budget
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.linearisation import ResidualCovariance
from tulip_testbed.calibration.self_calibration import ROUNDS as AFRESH
from tulip_testbed.calibration.self_calibration import STANDS, self_calibrate
from tulip_testbed.discovery.candidates import Candidate, Fitted, candidates, change_times, log_choices
from tulip_testbed.discovery.columns import CandidateColumns, Changes, candidate_blocks, whitened_columns
from tulip_testbed.discovery.evidence import marginal_fits, ranked
from tulip_testbed.discovery.joint_fit import Data, JointFit, gauss_newton, joint_fit, log_share_of_positive
from tulip_testbed.discovery.loose_parts import hidden_joints, loosest, speaks_of
from tulip_testbed.discovery.pairs import ranked_pairs
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_noise import noise_of, with_cell_noise

MOST_TERMS = 5  # effects in one explanation
DECISIVE = 3.0  # ln of the Bayes factor, below which two explanations are equivalent
JUDGED = 3  # candidates, at most, that are judged of each ranking
GROSS = 100.0  # ln of the Bayes factor by linear columns, from where the best of several kinds are judged
PAIRS = 2  # of candidates, at most, that are judged of each ranking
NEAR = 10.0  # ln of the Bayes factor by linear columns, within which candidates are judged
ROUNDS = 4  # linearisations of a judgement
RESTS = 0.5  # s.e. by which the last of them may move a number, or as many are taken once more
TRIES = 2
LOOKS = 2  # linearisations of a glance, at most
LONGEST = 12
WITHIN = 15.0  # ln of the Bayes factor by linear columns, of candidates that are shortlisted
TIMES = 60  # between postures, at most, that are tried for a change in time
GLANCED_NEAR = 15.0  # ln of the evidence at a glance, by which others that are judged may lie below the best
GLANCED = 0.2  # of the best gain at a glance: by so much more
KEPT_CHANGES = 3  # sets of effects of which the candidates' changes are kept
KEPT_FITS, KEPT_ROWS = 4, 6000  # calibrations whose fits are kept; rows of all calibrations that are kept
ZERO_WITHIN = 2.0  # s.e., by which noise may make a size negative that is zero
ORDINARY = 1.0  # tolerances: the largest spread of a family in the search
Key = tuple[tuple[str, tuple[float, ...]], ...]  # labels and values of effects


@dataclass(frozen=True)
class CandidateSearch:
    """The data that are searched, and the candidates.

    Attributes:
        tolerances: of families, in place of those that fit the sensors [SI]; zero: exact.
        candidates: effects that may be the cause.
        widest: prior s.d. of the spread of a family [tolerances]: half a normal.
        budget: when it is spent, nothing more is judged.
        kept: `fits` about the last calibrations. known: these and others, by what was asked.
        changes: of the candidates, by the labels of the effects that were removed before.
    """

    observed: Observation
    tolerances: Mapping[str, float] | None
    candidates: list[Candidate]
    widest: float = np.inf
    budget: Budget = field(default_factory=lambda: Budget(0))
    kept: list[tuple[SelfCalibration, Key, tuple[JointFit, JointFit]]] = field(default_factory=list)
    known: dict[Hashable, tuple[Any, SelfCalibration]] = field(default_factory=dict)
    changes: dict[tuple[str, ...], Changes] = field(default_factory=dict)

    @staticmethod
    def of(observed: Observation, tolerances: Mapping[str, float] | None = None) -> CandidateSearch:
        """Return the search for all effects of the catalogue."""
        observed = with_cell_noise(observed)
        return CandidateSearch(observed, tolerances, candidates(observed), budget=Budget(len(observed)))

    def glanced(self, terms: Sequence[Fitted], start: SelfCalibration) -> Judged | None:
        """Judge by one linearisation about a start that is steady; None: it does not converge.

        Where members of the start hold the same fault, it moves so far that it says nothing: others follow
        and the best of all is returned.
        """
        best, found = None, start
        for _ in range(LOOKS):
            try:
                found = self.calibration(terms, found, start.linear.covariance, 1)
            except np.linalg.LinAlgError:
                break
            judged = Judged(at_estimate(terms, found), found, self.evidence(found, terms, start))
            if best is None or judged.evidence > best.evidence:
                best = judged
            if found.steady:
                break
        return best

    def calibration(
        self,
        terms: Sequence[Fitted],
        start: SelfCalibration | None,
        covariance: ResidualCovariance | None = None,
        rounds: int = ROUNDS,
        absent: tuple[str, ...] | None = None,
    ) -> SelfCalibration:
        """Calibrate with some effects, see `self_calibrate`, or recall what was found before."""
        key = key_of(terms), id(start), id(covariance), rounds, absent
        if key not in self.known:
            instances = [term.instance for term in terms]
            how = start, covariance, rounds, absent
            found = self_calibrate(self.observed, self.tolerances, instances, *how)
            while len(self.known) * len(self.observed) > KEPT_ROWS:
                del self.known[next(iter(self.known))]
            self.known[key] = (start, covariance), found
        return self.known[key][1]

    def evidence(self, found: SelfCalibration, terms: Sequence[Fitted], start: SelfCalibration) -> float:
        """Compute ln of the evidence for effects; the prior of positive sizes is half of `size_prior`.

        Args:
            start: about which all that it is compared with were calibrated.
        """
        out = found.log_evidence_about(start)
        out -= sum(log_choices(term.candidate, self.observed) for term in terms)
        for one, error in zip(found.effects, found.effect_errors, strict=True):
            sizes = np.array([one.values[k] for k in one.effect.sizes])
            positive = np.array([one.effect.parameters[k].positive for k in one.effect.sizes], bool)
            out += log_share_of_positive(sizes, error, positive)
        return out - 0.5 * sum((one.spread / self.widest) ** 2 for one in found.families)

    def tried(
        self,
        terms: Sequence[Fitted],
        start: SelfCalibration,
        begin: SelfCalibration | None = None,
        afresh: bool = False,
    ) -> Judged | None:
        """Calibrate with some effects in addition to the families; comparable with others of the same start.

        Args:
            begin: where the linearisations begin, if not at the start. afresh: they begin from nothing.

        Returns:
            None: with these effects the calibration does not converge.
        """
        covariance = start.linear.covariance
        if not (afresh or begin) and start.moved < RESTS and key_of(terms) == key_of(start.effects):
            glance = self.glanced(terms, start)
            if glance is not None and glance.calibration.moved < STANDS:
                return glance  # more linearisations would end at once
        try:
            found = begin or start
            if afresh:  # what is compared has the same families
                found = self.calibration(terms, None, None, AFRESH, start.absent)
            for _ in range(TRIES):
                found = self.calibration(terms, found, covariance)
                if found.moved < RESTS:
                    break
        except np.linalg.LinAlgError:
            return None
        return Judged(at_estimate(terms, found), found, self.evidence(found, terms, start))

    def judged_of(
        self,
        terms: tuple[Fitted, ...],
        near: list[Fitted],
        afresh: list[Fitted],
        start: SelfCalibration,
        best: float = -np.inf,
    ) -> list[Judged]:
        """Judge what is promising at a glance, each in addition to some terms.

        A glance is the first linearisation of a judgement. About a start at rest it misses the evidence by 3
        at most where the gap is small, by a small part of the gain where it is large. Other starts it does
        not serve.

        Args:
            afresh: candidates that are judged without the members of the start, which a missing effect may
                have distorted, unless a judgement with them came to rest within the bounds of all families
                and they promise no decisively better one at a glance.
            best: ln of the evidence for the best of what they compete with.
        """
        every = [(*terms, one) for one in (*near, *afresh)]
        glances: list[Judged | None] = [None] * len(every)
        if start.moved < RESTS:
            plain = self.glanced(terms, start)
            before = -np.inf if plain is None else plain.evidence
            for k, several in enumerate(every):  # what holds no promise is forgotten for the sake of memory
                if self.budget.spent:
                    return []
                glances[k] = self.glanced(several, start)
                best = max([best, *(one.evidence for one in glances if one)])
                least = max(before, best - GLANCED_NEAR - GLANCED * max(best - before, 0.0))
                glances = [one if one and one.evidence > least else None for one in glances]
        out, at_rest = [], dict[Hashable, float]()
        for k, (several, glance) in enumerate(zip(every, glances, strict=True)):
            key = several[-1].key
            if self.budget.spent:
                break
            if glance is None and start.moved < RESTS:
                continue
            enough = at_rest.get(key, -np.inf) + DECISIVE
            if k >= len(near) and key in at_rest and (glance is None or glance.evidence < enough):
                continue
            begin = None if glance is None else glance.calibration
            judged = self.tried(several, start, begin, k >= len(near))
            if judged is not None and judged.possible:
                out.append(judged)
                if judged.steady and not judged.calibration.at_bound:
                    at_rest[key] = judged.evidence
        return out

    def calibrated(self, judged: Judged) -> SelfCalibration:
        """Calibrate again with the covariance of the residuals that belongs to the result."""
        try:
            return self.calibration(judged.terms, judged.calibration)
        except np.linalg.LinAlgError:
            return judged.calibration

    def ranked(self, adopted: JointFit) -> list[Fitted]:
        """Rank all other candidates in addition to the adopted terms."""
        others, known = self._others(adopted)
        linear = adopted.partialled_out
        return ranked(candidate_blocks(linear, others, known), linear.residual)

    def pairs(
        self,
        calibration: SelfCalibration,
        terms: tuple[Fitted, ...],
        kinds: Sequence[str] = (),
        count: int = PAIRS,
    ) -> list[Judged]:
        """Judge the most promising pairs, of any candidates or of one of some kinds, beyond some terms."""
        near: dict[tuple[str, str], tuple[Fitted, Fitted]] = {}
        for fit in self.fits(calibration, terms):
            others, known = self._others(fit)
            some = [one for one in others if not kinds or one.effect.name in kinds]
            for first, second in ranked_pairs(fit, some, known, DECISIVE, count, bool(kinds)):
                near.setdefault((first.label, second.label), (first, second))
        out = []
        for pair in near.values():
            judged = None if self.budget.spent else self.tried((*terms, *pair), calibration)
            if judged is not None and judged.possible and judged.steady:
                out.append(judged)
        return out

    def _others(self, adopted: JointFit) -> tuple[list[Candidate], Changes]:
        """Return the candidates that were not adopted, and where their changes are kept."""
        hidden = hidden_joints(adopted.linear.smoothed, adopted.terms)
        others = [
            candidate
            for candidate in self.candidates
            if candidate.label not in adopted.labels and not speaks_of(candidate, hidden)
        ]
        key = tuple(sorted(adopted.labels))
        kept = KEPT_CHANGES if len(self.observed) <= ROWS else 1
        if key not in self.changes and len(self.changes) == kept:
            del self.changes[next(iter(self.changes))]
        return others, self.changes.setdefault(key, {})

    def of_part(self, observed: Observation, rows: np.ndarray) -> CandidateSearch:
        """Return the search in some postures of an experiment."""
        parts = {
            key: {which: replace(one, values=one.values[rows]) for which, one in known.items()}
            for key, known in self.changes.items()
        }
        return replace(self, observed=observed.take(rows), kept=[], known={}, changes=parts)

    def best(self, calibration: SelfCalibration, terms: Sequence[Fitted]) -> list[Fitted]:
        """List the candidates that may explain most in addition to the terms, the best first.

        They are searched for twice: with the spreads and the noise as estimated, which a missing effect may
        have widened, and with none larger than usual.
        """
        out: dict[Hashable, Fitted] = {}
        for fit in self.fits(calibration, terms):
            for fitted in self.shortest(fit):
                out.setdefault(fitted.key, fitted)
        return list(out.values())

    def fits(self, calibration: SelfCalibration, terms: Sequence[Fitted]) -> tuple[JointFit, JointFit]:
        """Fit terms with the spreads and the noise as estimated, and with none larger than usual.

        Some are kept: the search for laws begins where the selection began, and where it ended.
        """
        for about, key, both in self.kept:
            if about is calibration and key == key_of(terms):
                return both
        data = calibrated_data(self.observed, calibration)
        stated, found = noise_of(self.observed), calibration.noise
        usual = replace(
            found,
            encoder=min(stated.encoder, found.encoder),
            cell=min(stated.cell, found.cell),
            plates=np.minimum(stated.plates, found.plates),
        )
        fit = joint_fit(data, terms)
        capped = joint_fit(replace(data, noise=usual, background=calibration.background(ORDINARY)), terms)
        self.kept.append((calibration, key_of(terms), (fit, capped)))
        if len(self.kept) > (KEPT_FITS if len(self.observed) <= ROWS else 1):
            del self.kept[1 if len(self.kept) > 2 else 0]  # the first is asked for again
        return fit, capped

    def without_idle(self, judged: Judged, start: SelfCalibration) -> Judged:
        """Eliminate terms that are not decisive in addition to the others, the least decisive first.

        The newest has just been judged.
        """
        while len(judged.terms) > 1 and not self.budget.spent:
            terms = judged.terms
            fewer = [self.tried(terms[:k] + terms[k + 1 :], start) for k in range(len(terms) - 1)]
            sure = [one for one in fewer if one is not None and (one.steady or not judged.steady)]
            best = max(sure, key=lambda one: one.evidence, default=None)
            if best is None or judged.evidence - best.evidence >= DECISIVE:
                break
            judged = best
        return judged

    def shortest(self, adopted: JointFit) -> list[Fitted]:
        """List the few candidates that explain most in addition to the adopted terms, the best first.

        Linear columns rank badly what a gross gap needs. Then others are listed too: the loosest part, the
        best of other kinds, and the best that is undone exactly, as exchanged cells.
        """
        key = tuple(candidate.label for candidate in self.candidates)
        if key not in adopted.ranked:
            adopted.ranked[key] = self._shortest(adopted)
        return adopted.ranked[key]

    def _shortest(self, adopted: JointFit) -> list[Fitted]:
        order = self.ranked(adopted)
        short = shortlist(adopted, order)
        least = max(short[0].log_bayes_factor - NEAR, 0.0) if short else 0.0
        near = [fitted for fitted in short if fitted.log_bayes_factor > least][:JUDGED]
        if not near or near[0].log_bayes_factor < GROSS:
            return near
        known, (candidates_left, _) = {one.label for one in near}, self._others(adopted)
        loose = loosest(adopted.partialled_out, candidates_left)
        near += [one for one in loose if one.log_bayes_factor > least and one.label not in known]
        best: dict[str, Fitted] = {}
        for one in order:
            if one.log_bayes_factor > 0:
                best.setdefault(one.candidate.effect.name, one)
        found = {one.candidate.effect.name for one in near}
        others = [one for kind, one in best.items() if kind not in found]
        room = max(JUDGED - len(found), 0)
        first, rest = others[:room], others[room:]
        exact = [one for one in rest if one.candidate.effect.exchanges]
        return near + [fit_in_addition(adopted, one) for one in first + exact[:1]]


def key_of(terms: Sequence[Fitted | EffectInstance]) -> Key:
    """Return labels and values of effects."""
    return tuple((str(term.label), term.values) for term in terms)


@dataclass(frozen=True)
class Judged:
    """Some effects, with ln of the evidence for them."""

    terms: tuple[Fitted, ...]
    calibration: SelfCalibration
    evidence: float

    @property
    def possible(self) -> bool:
        """Return whether no size is negative that cannot be.

        Next to another of the same effect, one may be negative by as much as noise makes of zero.
        """
        for term, errors in zip(self.terms, self.calibration.effect_errors, strict=True):
            positive = term.candidate.positive
            sizes = term.sizes[positive]
            if sizes.size and (sizes.max() <= 0 or (sizes < -ZERO_WITHIN * errors[positive]).any()):
                return False
        return True

    @property
    def steady(self) -> bool:
        """Return whether its linearisations came to rest, so that its evidence can be believed."""
        return self.calibration.moved < RESTS


def at_estimate(terms: Sequence[Fitted], found: SelfCalibration) -> tuple[Fitted, ...]:
    """Return the terms with the sizes that a calibration found."""
    return tuple(
        replace(term, sizes=np.array([one.values[k] for k in one.effect.sizes]))
        for term, one in zip(terms, found.effects, strict=True)
    )


def first_calibration(
    observed: Observation,
    tolerances: Mapping[str, float] | None = None,
    effects: Sequence[EffectInstance] = (),
    start: SelfCalibration | None = None,
) -> SelfCalibration:
    """Calibrate with these effects; if a gross fault lets it diverge, with the usual spreads and noise."""
    try:
        return self_calibrate(observed, tolerances, effects, start)
    except np.linalg.LinAlgError:
        return self_calibrate(observed, tolerances, effects, rounds=1)


def part_of(calibration: SelfCalibration, rows: np.ndarray) -> SelfCalibration:
    """Return a calibration as the start of one of some of its postures alone."""
    linear = replace(calibration.linear, smooth=calibration.linear.smooth.take(rows))
    return replace(calibration, observed=calibration.observed.take(rows), linear=linear)


def calibrated_data(observed: Observation, calibration: SelfCalibration) -> Data:
    """Return an experiment without its ordinary imperfections, and what is still uncertain about them."""
    return Data(calibration.without_members(observed), calibration.noise, calibration.background())


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
    if not term.candidate.effect.sizes and term.candidate.effect.mechanism.unsure is not None:
        return term  # there is nothing to fit, and its noise is in the Bayes factor already
    linear = adopted.partialled_out
    found = gauss_newton(linear, (term,))
    return replace(
        found.terms[0], log_bayes_factor=found.log_bayes_factor - log_choices(term.candidate, linear.observed)
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
    flat = whitened_columns(linear, [finer])
    whole = linear.project(np.concatenate(flat, axis=1))
    projected = np.split(whole - basis @ (basis.T @ whole), len(flat), axis=1)
    return marginal_fits(CandidateColumns([finer], [projected]), adopted.residual)[0]
