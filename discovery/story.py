"""A discovery in words that a laboratory understands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.discovery.discover import AMBIGUOUS, NAMED, NONE, Discovery, crowded, instance_of
from tulip_testbed.discovery.proposals import Proposal
from tulip_testbed.discovery.ranking import Rival
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.wording import spoken, told

MANY = 2  # effects, that are often there at once
LARGE = 5.0  # prior s.d.: beyond, predictions were not tested
PLACES = {
    "A": "the centre of pressure",
    "F": "the sum of the cells",
    "T": "the twist of the plates",
    "C": "the closure of the legs",
}


def story(found: Discovery, next_experiment: list[Proposal]) -> list[str]:
    """Sentences, the verdict first."""
    lines = [_headline(found)]
    if found.verdict == NONE:
        lines.append(_sensitivity(found))
    else:
        lines += _seen_in(found)
    if found.heldout is not None and found.found.terms and found.verdict != NONE:
        before, after, floor = found.heldout.millimetres
        lines.append(
            f"On placements that took no part in the fit the residuals go from "
            f"{found.heldout.before['AFTC']:.2f} to {found.heldout.after['AFTC']:.2f} times the noise "
            f"(up to {found.heldout.floor['AFTC']:.2f} by chance), "
            f"the centre of pressure from {before:.2f} to {after:.2f} mm (noise {floor:.2f} mm)."
        )
    if found.found.terms and found.verdict in (NAMED, AMBIGUOUS) and found.left[0].p < LEVEL:
        lines.append(f"A little is left that this does not explain: {found.left[0].words}.")
    if found.verdict == NAMED and len(found.adopted) > MANY:
        lines.append(
            f"{len(found.adopted)} effects at once are rare; one fault that the catalogue lacks, such as "
            "an axis that is askew, can look like several. Look for a common cause."
        )
    lines += _large(found)
    if found.verdict == AMBIGUOUS and not next_experiment:
        lines.append(
            "Nothing that could be done with the placements would tell them apart by these channels: "
            "measure what is in question itself."
        )
    lines += [f"To tell them apart: {p.words} ({p.gain:.3g} times the separation)" for p in next_experiment]
    if found.noise.assumed:
        lines.append(f"Noise that is not a data sheet's: {'; '.join(found.noise.assumed)}.")
    if found.repeats.pairs == 0:
        lines.append("No posture was repeated in one set-up: nothing checks the stated noise.")
    if found.verdict != NONE and (names := _unseen(found)):
        lines.append(f"Whatever it is, these postures cannot show: {names}.")
    return lines


def _large(found: Discovery) -> list[str]:
    """Sizes that nobody expects, and what that means for them."""
    if found.verdict not in (NAMED, AMBIGUOUS):
        return []
    out = []
    for term in found.found.terms:
        effect = term.candidate.effect
        for parameter, value in zip(effect.parameters, term.values, strict=True):
            if parameter.prior and abs(value) > LARGE * parameter.prior:
                times = abs(value) / parameter.prior
                out.append(
                    f"{term.candidate.label}: {spoken(parameter, value)} is {times:.0f} times what is "
                    f"plausible ({spoken(parameter, parameter.prior)}). Predictions are not tested there, "
                    "the interval may be too narrow: mend it and measure again."
                )
    return out


def _headline(found: Discovery) -> str:
    if found.verdict == NONE:
        return "No gap: what was measured is what the nominal model and the stated noise explain."
    if found.verdict == NAMED:
        return " ".join(told(instance) for instance in found.adopted)
    if found.verdict == AMBIGUOUS:
        parts = []
        for k, (term, rivals) in enumerate(zip(found.found.terms, found.rivals, strict=True)):
            if len(rivals) > 1:
                parts.append(f"One of these, which this experiment cannot tell apart: {_labels(rivals)}.")
            else:
                parts.append(told(instance_of(term, found.found, k)))
        return " ".join(parts)
    tried = ", ".join(term.candidate.label for term in found.found.terms)
    closest = f" Closest, but not enough: {tried}." if tried else ""
    if crowded(found.found):
        closest = f" It takes two effects on one target ({tried}): rather one that the catalogue lacks."
    return f"There is a gap that no effect of the catalogue closes: {found.where}.{closest}"


def _labels(rivals: Sequence[Rival]) -> str:
    return ", ".join(f"{r.label} ({_values(r)}; ln BF {r.log_bayes_factor:.1f})" for r in rivals)


def _values(rival: Rival) -> str:
    parameters = rival.term.candidate.effect.parameters
    return ", ".join(spoken(p, value) for p, value in zip(parameters, rival.term.values, strict=True))


def _seen_in(found: Discovery) -> list[str]:
    """In which channels it was observed."""
    after = found.heldout.after if found.heldout is not None else {}
    parts = []
    for gap in found.explanation.gaps:
        if gap.p < 0.01:
            closed = f" -> {after[gap.channel] ** 2:.2g}" if gap.channel in after else ""
            ratio = f"{gap.chi_square / gap.freedom:.2g}{closed}"
            parts.append(f"{PLACES[gap.channel]} (chi2 per degree of freedom {ratio})")
    if parts:
        return [f"Seen in {', '.join(parts)}."]
    return [
        f"No channel alone shows it; along its direction it stands out (p = {found.explanation.alarm:.2g} "
        "over the catalogue)."
    ]


def _sensitivity(found: Discovery) -> str:
    names = _unseen(found)
    hidden = f" These postures cannot show: {names}." if names else ""
    m = found.observed.measurements
    return (
        f"{len(np.unique(m.posture))} postures in {len(np.unique(found.observed.stance))} set-ups of the "
        f"feet, {len(m)} readings.{hidden}"
    )


def _unseen(found: Discovery) -> str:
    return ", ".join(sorted({u.label.split(":")[0] for u in found.unseen}))
