"""A discovery in sentences for the laboratory."""

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.calibration.calibration_result import HALF_95
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.detectability import by_kind
from tulip_testbed.discovery.discover import (
    ADOPTED,
    AMBIGUOUS,
    CALIBRATED,
    DESCRIBED,
    NAMED,
    NONE,
    UNKNOWN,
    Discovery,
)
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.discovery.next_experiment import NextExperiment
from tulip_testbed.effects.instance import EffectInstance

MANY = 2  # effects that often occur together
LARGE = 5.0  # prior s.d., beyond which predictions were not tested
WORTHWHILE = 0.1  # share of the doubt, from which an experiment is proposed
SHOWN = 0.01  # p-value of a channel's lack of fit that is reported
SHOWN_MEMBERS = 4  # ordinary imperfections
SHOWN_TARGETS = 4  # of one kind of effect
SHOWN_EXPLANATIONS = 4  # of one gap; the table has all
PLACES = {
    "A": "the centre of pressure",
    "F": "the sum of the vertical forces",
    "T": "the twist of the plates or, under the feet, the force's direction",
    "C": "the closure of the legs",
}


def story(found: Discovery, ranking: Sequence[NextExperiment]) -> list[str]:
    """Tell a discovery in sentences, the verdict first.

    Args:
        ranking: experiments that would settle it, the best first.
    """
    lines = [_headline(found)]
    lines.append(_size_of_experiment(found) if found.verdict == NONE else _channels(found))
    if found.heldout is not None:
        before, after, floor = (
            number(by_channel["AFTC"], ".2f")
            for by_channel in (found.heldout.before, found.heldout.after, found.heldout.floor)
        )
        before_mm, after_mm, noise_mm = (number(value, ".2f") for value in found.heldout.millimetres)
        lines.append(
            "On placements that took no part in the fit, the root mean square of the residuals goes from "
            f"{before} to {after} times the noise (by chance up to {floor}), that of the centre of pressure "
            f"from {before_mm} to {after_mm} mm (noise {noise_mm} mm)."
        )
    if found.verdict in (*ADOPTED, AMBIGUOUS):
        lines.append("Ordinary imperfections of all families are estimated together with it.")
    lines += _crowd(found.verdict, len(found.adopted))
    lines += _implausible(found)
    if found.negligible and found.verdict != UNKNOWN:  # there terms may have lost their evidence
        lines.append(f"Seen too, but far smaller than is plausible for a fault: {_listed(found.negligible)}.")
    if found.verdict == AMBIGUOUS:
        lines.append(_next_experiment(ranking))
    if found.noise.assumed:
        lines.append(f"Noise that is not taken from a data sheet: {'; '.join(found.noise.assumed)}.")
    if found.repeats.pairs == 0:
        lines.append("No posture was repeated within a set-up, so nothing checks the stated noise.")
    if found.verdict != NONE:
        lines += _undetectable(found)
    return lines


def _next_experiment(ranking: Sequence[NextExperiment]) -> str:
    """Tell which experiment would separate the explanations."""
    if not ranking or ranking[0].settled < WORTHWHILE:
        return (
            "No experiment that was weighed is expected to separate these explanations: measure the quantity "
            "in question directly."
        )
    best = ranking[0]
    return (
        f"To separate them, measure again ({best.words}): {len(best.plan)} postures in about "
        f"{best.minutes:.0f} min are expected to settle {100 * best.settled:.0f} % of the doubt."
    )


def _crowd(verdict: str, count: int) -> list[str]:
    """Doubt several effects at once, laws from two on: each of them describes what the catalogue lacks."""
    if verdict not in ADOPTED or count <= (MANY if verdict == NAMED else 1):
        return []
    return [
        f"{count} effects at once are rare. A single fault that the catalogue lacks, such as a tilted joint "
        "axis, can look like several effects: look for a common cause."
    ]


def _implausible(found: Discovery) -> list[str]:
    """Warn of sizes far beyond their prior."""
    if found.verdict not in (*ADOPTED, AMBIGUOUS):
        return []
    return [
        f"{term.label}: {parameter.text(value)} is {abs(value) / parameter.prior:.0f} times the plausible "
        f"size ({parameter.text(parameter.prior)}). Predictions are not tested at such sizes and the "
        "interval may be too narrow: remove the cause and measure again."
        for term in found.fit.terms
        for parameter, value in zip(
            term.candidate.effect.parameters_on(term.candidate.target), term.values, strict=True
        )
        if parameter.prior and abs(value) > LARGE * parameter.prior
    ]


def _headline(found: Discovery) -> str:
    if found.verdict == NONE:
        return "No gap: the nominal model and the stated noise explain the measurements."
    if found.verdict in ADOPTED:
        return " ".join([*(instance.finding for instance in found.adopted), *_also(found)])
    if found.verdict == AMBIGUOUS:
        return " ".join(
            f"This experiment cannot distinguish these explanations: {_listed(several)}."
            if len(several) > 1
            else with_intervals(found.fit, k).finding
            for k, several in enumerate(found.equivalents)
            if k in found.effects
        )
    if found.verdict == CALIBRATED:
        wide = [
            f"{one.family.name} ({number(one.spread, '.1f')} times its tolerance)"
            for one in found.families
            if one.spread95[0] > 1
        ]
        return (
            "Ordinary imperfections explain the gap; no single cause stands out. The clearest of each kind: "
            + " ".join(_largest(found))
            + (f" Larger than usual: {', '.join(wide)}." if wide else "")
        )
    closest = ", ".join(found.fit.labels)
    closest = f" The closest explanation is not sufficient: {closest}." if closest else ""
    return (
        f"There is a gap that neither ordinary imperfections nor an effect of the catalogue explain. "
        f"{' '.join(found.reasons)}{closest}"
    )


def _also(found: Discovery) -> list[str]:
    """Tell the laws that do as well as those that were adopted."""
    if found.verdict != DESCRIBED:
        return []
    return [
        f"As good (ln BF {number(one.log_bayes_factor - best, '+.1f')}): {one.instance.finding}"
        for k in found.effects
        for best in [
            next(t.log_bayes_factor for t in found.equivalents[k] if t.label == found.fit.terms[k].label)
        ]
        for one in found.equivalents[k]
        if one.label != found.fit.terms[k].label
    ]


def _largest(found: Discovery) -> list[str]:
    """Tell the ordinary imperfections that differ most from zero, one of each family."""
    sized = [(max(map(_errors, one.values, one.intervals)), str(one.label), one) for one in found.calibrated]
    clearest: dict[str, EffectInstance] = {}
    for errors, _, one in sorted(sized, key=lambda each: -each[0]):
        if errors > HALF_95 or not clearest:
            clearest.setdefault(one.effect.name, one)
    return [one.finding for one in clearest.values()][:SHOWN_MEMBERS]


def _errors(value: float, interval: tuple[float, float] | None) -> float:
    """Return the size of a value in standard errors."""
    return 0.0 if interval is None else abs(value) / max((interval[1] - interval[0]) / (2 * HALF_95), 1e-300)


def _listed(explanations: Sequence[Fitted]) -> str:
    shown = ", ".join(
        f"{e.label} ({_sizes(e)}; ln BF {number(e.log_bayes_factor, '.1f')})"
        for e in explanations[:SHOWN_EXPLANATIONS]
    )
    left = len(explanations) - SHOWN_EXPLANATIONS
    return f"{shown} and {left} more" if left > 0 else shown


def _sizes(fitted: Fitted) -> str:
    parameters = fitted.candidate.effect.parameters_on(fitted.candidate.target)
    return ", ".join(p.text(value) for p, value in zip(parameters, fitted.values, strict=True))


def _channels(found: Discovery) -> str:
    """Say in which channels the gap shows."""
    after = found.heldout.after if found.heldout is not None else {}
    parts = []
    for test in found.selection.lack_of_fit:
        if test.p < SHOWN:
            ratio = number(test.chi_square / test.dof, ".2g")
            if test.channel in after:
                ratio = f"from {ratio} to {number(after[test.channel] ** 2, '.2g')}"
            parts.append(f"{PLACES[test.channel]} (chi-square per degree of freedom {ratio})")
    if parts:
        return f"The gap shows in {', '.join(parts)}."
    return (
        "No channel by itself shows the gap, but the test of all effects of the catalogue does "
        f"(p = {number(found.selection.p, '.2g')})."
    )


def _size_of_experiment(found: Discovery) -> str:
    m = found.observed.measurements
    size = (
        f"The experiment has {len(np.unique(m.posture))} postures in {len(np.unique(found.observed.stance))} "
        f"set-ups, {len(m)} readings in all."
    )
    return " ".join([size, *_undetectable(found), *_weak(found)])


def _undetectable(found: Discovery) -> list[str]:
    """Name the effects that leave no residual, with their targets where others can be detected."""
    alike: dict[tuple[str, ...], list[str]] = {}
    names = []
    for name, targets in by_kind([u.candidate for u in found.undetectable], found.observed).items():
        if targets:
            alike.setdefault(tuple(targets), []).append(name)
        else:
            names.append(f"`{name}`")
    for targets, kinds in alike.items():
        more = f" and {len(targets) - SHOWN_TARGETS} more" if len(targets) > SHOWN_TARGETS else ""
        names.append(f"`{', '.join(kinds)}: {', '.join(targets[:SHOWN_TARGETS])}{more}`")
    if not names:
        return []
    *several, last = names
    return [f"These postures cannot detect {', '.join(several)}{' or ' if several else ''}{last}."]


def _weak(found: Discovery) -> list[str]:
    """Name the effects that a plausible size may hide."""
    names = [f"`{name}`" for name in sorted({one.candidate.effect.name for one in found.selection.weak})]
    if not names:
        return []
    return [f"On some targets or all, these would show only if larger than plausible: {', '.join(names)}."]
