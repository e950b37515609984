"""Select the effects that explain an experiment beyond its ordinary imperfections.

Forward selection with backward elimination. Candidates are ranked by linear columns; the best are judged by
the evidence of a self-calibration in which the spreads of all families and the scales of the noise are
estimated anew. A family whose spread grew because of one member thus competes with that member as an effect
of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.calibration.self_calibration import HALF_95, SelfCalibration, self_calibrate
from tulip_testbed.discovery.candidates import Candidate, Fitted, candidates, log_choices
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.evidence import effective_tests, ranked, sidak
from tulip_testbed.discovery.joint_fit import Data, JointFit, joint_fit
from tulip_testbed.discovery.pure_error import pure_error, widened
from tulip_testbed.discovery.shortlist import at_best_time, fit_in_addition, shortlist
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.identification.distributions import chi2_sf, normal_logcdf
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_noise import Noise, noise_of, with_cell_noise

LEVEL = 0.005  # of the test of all effects, and of that of the four channels: 0.01 in all
DECISIVE = 3.0  # ln of the Bayes factor, below which two explanations are equivalent
MOST_TERMS = 5
JUDGED = 3  # candidates, at most, that are judged of each ranking
GROSS = 100.0  # ln of the Bayes factor by linear columns, from where the best of several kinds are judged
NEAR = 10.0  # ln of the Bayes factor by linear columns, within which candidates are judged
ROUNDS = 4  # linearisations of a judgement
STANDS_OUT = 3.0  # largest of its family's spread and tolerance, beyond which a member is an effect
NORMAL_SD = 1.4826  # s.d. of a normal distribution over the median of its absolute value
ORDINARY = 1.0  # tolerances: the largest spread of a family in the search


@dataclass(frozen=True)
class LackOfFit:
    """The chi-square test of one channel.

    Attributes:
        chi_square, dof, p: of its residuals alone, with the base parameters fitted to it.
    """

    channel: str
    chi_square: float
    dof: int
    p: float


@dataclass(frozen=True)
class Selection:
    """The effects that were selected.

    Attributes:
        calibration: ordinary imperfections beside the selected effects. tolerances: as asked for.
        complete: whether no further candidate is decisive.
        fit: of the selected effects, with the ordinary imperfections as background. null: without either.
        alternatives: what else might explain each term, by predictions, the best first; itself among them.
        lack_of_fit: of each channel if everything were exact.
        p: probability of as strong an effect among noise alone, over all candidates.
        tests: effective number of independent tests among the candidates.
        undetectable: candidates that the experiment cannot show.
    """

    calibration: SelfCalibration
    tolerances: Mapping[str, float] | None
    complete: bool
    fit: JointFit
    null: JointFit
    alternatives: tuple[tuple[Fitted, ...], ...]
    lack_of_fit: tuple[LackOfFit, ...]
    p: float
    tests: float
    undetectable: tuple[Candidate, ...]

    @property
    def lacks_fit(self) -> bool:
        """Whether noise alone does not explain the experiment, at 1 % in all."""
        least = min(test.p for test in self.lack_of_fit)
        return self.p < LEVEL or least < LEVEL / len(self.lack_of_fit)


def lack_of_fit(data: Data) -> tuple[LackOfFit, ...]:
    """Test each channel by itself."""
    out = []
    for channel in "AFTC":
        linear = linear_model(data.observed, data.noise, channel)
        if linear.dof > 0:
            p = float(chi2_sf(linear.chi_square, linear.dof))
            out.append(LackOfFit(channel, linear.chi_square, linear.dof, p))
    return tuple(out)


def select(
    search: Search, rng: np.random.Generator, progress: Callable[[int], None] = lambda count: None
) -> Selection:
    """Select the effects of an experiment.

    Args:
        rng: for the number of independent tests.
        progress: called with 1 after every step.
    """
    observed = search.observed
    calibration = _first_calibration(search)
    stated = _scattered(noise_of(observed), calibration.noise)
    repeats = pure_error(calibration.observed, calibration.theta, stated)
    exact = Data(observed, widened(calibration.observed, stated, repeats))
    null = exact.null
    columns = candidate_columns(null.linear, search.candidates)
    first = ranked(columns, null.residual)
    tests = effective_tests(columns, rng)
    selection = Selection(
        calibration=calibration,
        tolerances=search.tolerances,
        complete=True,
        fit=null,
        null=null,
        alternatives=(),
        lack_of_fit=lack_of_fit(exact),
        p=min((sidak(one.p, tests) for one in first), default=1.0),
        tests=tests,
        undetectable=tuple(one.candidate for one in first if not one.detectable),
    )
    progress(1)
    if selection.lacks_fit:
        calibration, terms, complete = _forward(search, null, calibration, tests, progress)
        calibration, terms = _with_unusual_members(search, calibration, terms)
        fit = joint_fit(calibrated_data(observed, calibration), terms)
        selection = replace(
            selection,
            calibration=calibration,
            complete=complete,
            fit=fit,
            alternatives=tuple(_alternatives(search, fit, k) for k in range(len(terms))),
        )
    progress(1)
    return selection


def _first_calibration(search: Search, terms: Sequence[Fitted] = ()) -> SelfCalibration:
    """Calibrate with these effects; if a gross fault lets it diverge, with the usual spreads and noise."""
    instances = [term.instance for term in terms]
    try:
        return self_calibrate(search.observed, search.tolerances, instances)
    except np.linalg.LinAlgError:
        return self_calibrate(search.observed, search.tolerances, instances, rounds=1)


def calibrated_data(observed: Observation, calibration: SelfCalibration) -> Data:
    """Return an experiment without its ordinary imperfections, and what is still uncertain about them."""
    return Data(calibration.without_members(observed), calibration.noise, calibration.background())


def _scattered(stated: Noise, found: Noise) -> Noise:
    """Return the stated noise, with placements that scatter as much as they do."""
    return replace(stated, plates=np.maximum(stated.plates, found.plates))


@dataclass(frozen=True)
class Search:
    """What is searched, and for what.

    Attributes:
        tolerances: of families, in place of those that fit the sensors [SI]; zero: exact.
        candidates: effects that may be the cause.
    """

    observed: Observation
    tolerances: Mapping[str, float] | None
    candidates: list[Candidate]

    @staticmethod
    def of(
        observed: Observation,
        tolerances: Mapping[str, float] | None = None,
        effects: dict[str, Effect] | None = None,
    ) -> Search:
        """Return the search for all effects of a catalogue, or of the whole one if None."""
        observed = with_cell_noise(observed)
        return Search(observed, tolerances, candidates(observed, effects))

    def judged(self, terms: Sequence[Fitted], start: SelfCalibration, afresh: bool = False) -> Judged:
        """Calibrate with some effects beside the families; comparable with others of the same start.

        Args:
            afresh: begin without the members of the start, which a missing effect may have distorted.
        """
        instances = [term.instance for term in terms]
        first = self_calibrate(self.observed, self.tolerances, instances) if afresh else start
        found = self_calibrate(
            self.observed, self.tolerances, instances, first, start.linear.covariance, ROUNDS
        )
        return Judged(_at_estimate(terms, found), found, _evidence(found, terms, self.observed))

    def tried(self, terms: Sequence[Fitted], start: SelfCalibration, afresh: bool = False) -> Judged | None:
        """Judge as `judged` does; None: with these effects the calibration does not converge."""
        try:
            return self.judged(terms, start, afresh)
        except np.linalg.LinAlgError:
            return None

    def calibrated(self, judged: Judged) -> SelfCalibration:
        """Calibrate anew with the covariance of the residuals that belongs to the result."""
        instances = [term.instance for term in judged.terms]
        try:
            return self_calibrate(
                self.observed, self.tolerances, instances, judged.calibration, rounds=ROUNDS
            )
        except np.linalg.LinAlgError:
            return judged.calibration

    def ranked(self, adopted: JointFit) -> list[Fitted]:
        """Rank all other candidates in addition to the adopted terms."""
        others = [candidate for candidate in self.candidates if candidate.label not in adopted.labels]
        linear = adopted.partialled_out
        return ranked(candidate_columns(linear, others), linear.residual)

    def best(self, calibration: SelfCalibration, terms: Sequence[Fitted]) -> list[Fitted]:
        """List the candidates that may explain most in addition to the terms, the best first.

        They are sought twice: with the spreads and the noise as estimated, which a missing effect may have
        widened, and with none larger than usual.
        """
        data = calibrated_data(self.observed, calibration)
        stated, found = noise_of(self.observed), calibration.noise
        usual = replace(
            found,
            encoder=min(stated.encoder, found.encoder),
            cell=min(stated.cell, found.cell),
            plates=np.minimum(stated.plates, found.plates),
        )
        out: dict[str, Fitted] = {}
        for one in (data, replace(data, noise=usual, background=calibration.background(ORDINARY))):
            for fitted in self.shortest(joint_fit(one, terms)):
                out.setdefault(fitted.label, fitted)
        return list(out.values())

    def shortest(self, adopted: JointFit) -> list[Fitted]:
        """List the few candidates that explain most in addition to the adopted terms, the best first.

        Linear columns rank badly what a gross gap needs: then the best of other kinds are listed too.
        """
        order = self.ranked(adopted)
        short = shortlist(adopted, order)
        least = max(short[0].log_bayes_factor - NEAR, 0.0) if short else 0.0
        near = [fitted for fitted in short if fitted.log_bayes_factor > least][:JUDGED]
        if not near or near[0].log_bayes_factor < GROSS:
            return near
        best: dict[str, Fitted] = {}
        for one in order:
            if one.log_bayes_factor > 0:
                best.setdefault(one.candidate.effect.name, one)
        found = {one.candidate.effect.name for one in near}
        others = [one for kind, one in best.items() if kind not in found]
        return near + [fit_in_addition(adopted, one) for one in others[: JUDGED - len(found)]]


@dataclass(frozen=True)
class Judged:
    """Some effects, with ln of the evidence for them."""

    terms: tuple[Fitted, ...]
    calibration: SelfCalibration
    evidence: float

    @property
    def possible(self) -> bool:
        """Return whether no size is negative that cannot be."""
        return all(
            size > 0 or not positive
            for term in self.terms
            for size, positive in zip(term.sizes, term.candidate.positive, strict=True)
        )


def _evidence(found: SelfCalibration, terms: Sequence[Fitted], observed: Observation) -> float:
    """Compute ln of the evidence for effects, whose positive sizes have half a normal as their prior."""
    out = found.solved.log_evidence - sum(log_choices(term.candidate, observed) for term in terms)
    for one, error in zip(found.effects, found.effect_errors, strict=True):
        sizes = np.array([one.values[k] for k in one.effect.sizes])
        positive = np.array([one.effect.parameters[k].positive for k in one.effect.sizes], bool)
        out += float((normal_logcdf(sizes / error) + np.log(2))[positive].sum())
    return out


def _at_estimate(terms: Sequence[Fitted], found: SelfCalibration) -> tuple[Fitted, ...]:
    """Return the terms with the sizes that a calibration found."""
    return tuple(
        replace(term, sizes=np.array([one.values[k] for k in one.effect.sizes]))
        for term, one in zip(terms, found.effects, strict=True)
    )


def _forward(
    search: Search,
    null: JointFit,
    calibration: SelfCalibration,
    tests: float,
    progress: Callable[[int], None],
) -> tuple[SelfCalibration, tuple[Fitted, ...], bool]:
    """Add the best candidate while it is decisive; after each step eliminate terms that are not.

    Returns:
        the calibration, the terms, and whether no further candidate is decisive.
    """
    terms: tuple[Fitted, ...] = ()
    before = []
    while len(terms) < MOST_TERMS:
        plain = search.tried(terms, calibration)
        before_all = _evidence(calibration, terms, search.observed) if plain is None else plain.evidence
        tried = [(one, False) for one in search.best(calibration, terms)]
        if not terms:  # a large effect distorts the members so far that it hides among them
            tried += [(one, True) for one in search.shortest(null)]
        every = [search.tried((*terms, one), calibration, afresh) for one, afresh in tried]
        progress(1)
        possible = [one for one in every if one is not None and one.possible]
        if not possible:
            return calibration, terms, True
        best = max(possible, key=lambda one: one.evidence)
        gain = best.evidence - before_all
        if gain < DECISIVE or _chance(best.calibration, gain, tests) > LEVEL:
            return calibration, terms, True
        best = _backward(search, best, calibration)
        if {term.label for term in best.terms} in before:
            break
        before.append({term.label for term in best.terms})
        calibration, terms = _at_best_times(search, search.calibrated(best), best.terms)
    return calibration, terms, False


def _at_best_times(
    search: Search, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> tuple[SelfCalibration, tuple[Fitted, ...]]:
    """Seek all times again beside everything that is known by now, until none moves.

    A time was chosen when other effects were still missing, which a wrong time imitates.

    Args:
        calibration: with the terms.
    """
    terms = _at_estimate(terms, calibration)
    for _ in range(MOST_TERMS):
        data = calibrated_data(search.observed, calibration)
        moved = terms
        for k, term in enumerate(terms):
            if (timed := term.candidate.time_parameter) is None:
                continue
            again = at_best_time(joint_fit(data, moved[:k] + moved[k + 1 :]), term)
            if again.values[timed] != term.values[timed]:
                moved = (*moved[:k], again, *moved[k + 1 :])
        if moved is terms:
            break
        before, after = search.tried(terms, calibration), search.tried(moved, calibration)
        if before is None or after is None or not after.possible or after.evidence <= before.evidence:
            break
        calibration = search.calibrated(after)
        terms = _at_estimate(after.terms, calibration)
    return calibration, terms


def _chance(found: SelfCalibration, gain: float, tests: float) -> float:
    """Compute the probability that noise alone would gain as much with the last effect, over all candidates.

    Args:
        gain: of ln of the evidence.
    """
    effect, error = found.effects[-1].effect, found.effect_errors[-1]
    prior = np.array([effect.parameters[k].prior for k in effect.sizes])
    likelihood = gain + float(np.log(np.maximum(prior / error, 1.0)).sum())
    return sidak(float(chi2_sf(2 * max(likelihood, 0.0), max(len(prior), 1))), tests)


def _with_unusual_members(
    search: Search, calibration: SelfCalibration, terms: tuple[Fitted, ...]
) -> tuple[SelfCalibration, tuple[Fitted, ...]]:
    """Add the members that are too large for the others of their family, the largest first.

    A few members say little about the spread of a family: it grows with one of them, and the evidence hardly
    prefers an effect of its own, still less if there are two. What is usual is said by the tolerance and the
    other members then. Those of one family are added together, or else the largest alone.
    """
    refused: set[str] = set()
    while True:
        found = [one for one in _unusual_members(search, calibration) if one.label not in refused]
        if not found or len(terms) >= MOST_TERMS:
            return calibration, terms
        plain = search.tried(terms, calibration)
        if plain is None:
            return calibration, terms
        alike = [one for one in found if one.candidate.effect is found[0].candidate.effect]
        together = alike[: MOST_TERMS - len(terms)]
        for added in [together, together[:1]] if len(together) > 1 else [together]:
            tried = search.tried((*terms, *added), calibration)
            if tried is not None and tried.possible and tried.evidence > plain.evidence - DECISIVE:
                calibration = search.calibrated(tried)
                terms = _at_estimate(tried.terms, calibration)
                break
        refused.add(found[0].label)


def _unusual_members(search: Search, calibration: SelfCalibration) -> list[Fitted]:
    """List the members that are too large for the others of their family, the largest first.

    The data determine them, and their 95 % intervals lie beyond what is usual.
    """
    out = []
    for one in calibration.families:
        targets = one.family.targets
        sizes = one.value.reshape(len(targets), -1) / one.family.tolerance
        errors = one.standard_error.reshape(sizes.shape) / one.family.tolerance
        known = one.determined.reshape(sizes.shape)
        for k, target in enumerate(targets):
            others = np.delete(sizes, k, axis=0)
            # The median, since several that stand out would hide one another in a mean square.
            usual = max(1.0, NORMAL_SD * float(np.median(np.abs(others)))) if others.size else 1.0
            least = np.where(known[k], np.abs(sizes[k]) - HALF_95 * errors[k], 0.0)
            ratio = float((np.abs(sizes[k]) * (least > usual)).max()) / (STANDS_OUT * usual)
            label = effect_label(one.family.name, target)
            candidate = next((c for c in search.candidates if c.label == label), None)
            if ratio > 1 and candidate is not None:
                out.append((ratio, Fitted(candidate, 0, sizes[k] * one.family.tolerance)))
    return [fitted for _, fitted in sorted(out, key=lambda each: -each[0])]


def chosen_again(search: Search, terms: Sequence[Fitted]) -> tuple[tuple[Fitted, ...], SelfCalibration]:
    """Choose every one of some effects anew, the others being kept, and fit them all.

    Another effect takes its place if the evidence for it is decisively better.

    Returns:
        the effects and the calibration with them.
    """
    out = tuple(terms)
    found = _first_calibration(search, out)
    data = calibrated_data(search.observed, found)
    for k in range(len(out)):
        adopted = joint_fit(data, out[:k] + out[k + 1 :])
        short = shortlist(adopted, search.ranked(adopted))
        own = fit_in_addition(adopted, out[k])
        if short and short[0].log_bayes_factor > own.log_bayes_factor + DECISIVE:
            out = (*out[:k], short[0], *out[k + 1 :])
    if [term.label for term in out] != [term.label for term in terms]:
        try:
            return out, self_calibrate(search.observed, search.tolerances, [term.instance for term in out])
        except np.linalg.LinAlgError:  # another choice by linear columns that no calibration bears out
            return tuple(terms), found
    return out, found


def _backward(search: Search, found: Judged, start: SelfCalibration) -> Judged:
    """Eliminate the terms that are not decisive in addition to the others, the least decisive first."""
    while len(found.terms) > 1:
        newest = len(found.terms) - 1  # it has just been judged
        fewer = [search.tried(found.terms[:k] + found.terms[k + 1 :], start) for k in range(newest)]
        best = max((one for one in fewer if one is not None), key=lambda one: one.evidence, default=None)
        if best is None or found.evidence - best.evidence >= DECISIVE:
            break
        found = best
    return found


def _alternatives(search: Search, found: JointFit, k: int) -> tuple[Fitted, ...]:
    """List what else would explain what term k explains, with the other terms kept; the best first."""
    others, term = found.without(k), found.terms[k]
    out = shortlist(others, search.ranked(others))
    if term.label not in [one.label for one in out]:
        out.append(replace(term, log_bayes_factor=fit_in_addition(others, term).log_bayes_factor))
    return tuple(sorted(out, key=lambda one: -one.log_bayes_factor))
