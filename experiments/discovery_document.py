"""A discovery as one JSON document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.discover import AMBIGUOUS, Discovery
from tulip_testbed.discovery.effect_intervals import with_intervals
from tulip_testbed.discovery.proposals import Proposal, proposals
from tulip_testbed.experiments.identify import Identification


def next_experiments(found: Discovery) -> list[Proposal]:
    """Propose experiments that would separate the equivalent explanations of an ambiguous discovery."""
    if found.verdict != AMBIGUOUS:
        return []
    out: list[Proposal] = []
    for explanations in found.equivalents:
        if len(explanations) > 1:
            out += proposals(found.selection.null.linear, explanations)
    return sorted({p.words: p for p in out}.values(), key=lambda p: -p.separation)


def discovery_document(
    found: Discovery,
    next_experiment: list[Proposal],
    sentences: list[str],
    rig: Path | None,
    before: Identification | None = None,
    after: Identification | None = None,
    check: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what `tulip discover --json` prints.

    Args:
        sentences: of `story`. rig: folder of the adopted model.
        before, after: base parameters without and with it. check: of the adopted model in full dynamics.
    """
    factors = [explanations[0].log_bayes_factor for explanations in found.equivalents]
    adopted = [
        instance.document() | {"log_bayes_factor": factor}
        for instance, factor in zip(found.adopted, factors, strict=False)
    ]
    return {
        "verdict": found.verdict,
        "effects": adopted,
        "candidates": [
            _candidate(found, k, one) for k, several in enumerate(found.equivalents) for one in several
        ],
        "undetectable": [
            {
                "name": u.candidate.effect.name,
                "target": u.candidate.target or None,
                "parameter": u.parameter or None,
                "bias_mm_per_prior_sd": 1e3 * u.bias if u.parameter else None,
            }
            for u in found.undetectable
        ],
        "where": found.where,
        "gap": _gap(found),
        "next_experiment": [{"do": p.words, "separation_gain": p.gain} for p in next_experiment],
        "parameters": _parameters(before, after),
        "repeats": {
            "pairs": found.repeats.pairs,
            "chi_square_per_freedom": found.repeats.ratio,
            "p": found.repeats.p,
        },
        "noise": {
            "encoder_sd": found.noise.encoder,
            "cell_sd": found.noise.cell,
            "placement_sd": found.noise.plates.tolist(),
            "not_as_stated": list(found.noise.assumed),
        },
        "alarm_p": found.selection.p,
        "left": [{"channel": p.channel, "pattern": p.words, "p": p.p} for p in found.patterns],
        "story": sentences,
        "check": check,
        "rig": None if rig is None else str(rig),
        "wall_s": found.wall_s,
    }


def _candidate(found: Discovery, k: int, explanation: Fitted) -> dict[str, Any]:
    adopted = explanation.label == found.fit.terms[k].label
    instance = with_intervals(found.fit, k) if adopted else explanation.instance
    return {"gap": k + 1, **instance.document(), "log_bayes_factor": explanation.log_bayes_factor}


def _gap(found: Discovery) -> dict[str, Any]:
    """Return the whitened r.m.s. on held-out placements by channel, and its 97.5 % quantile by chance."""
    held = found.heldout
    if held is None:
        return {
            test.channel: {"before": float(np.sqrt(test.chi_square / test.dof)), "after": None, "floor": 1.0}
            for test in found.selection.lack_of_fit
        } | {"heldout_rms_mm": None}
    document: dict[str, Any] = {
        channel: {"before": held.before[channel], "after": held.after[channel], "floor": held.floor[channel]}
        for channel in "AFTC"
        if channel in held.before
    }
    document["all"] = {
        "before": held.before["AFTC"],
        "after": held.after["AFTC"],
        "floor": held.floor["AFTC"],
    }
    first, last, floor = held.millimetres
    document["heldout_rms_mm"] = {"before": first, "after": last, "floor": floor}
    return document


def _parameters(before: Identification | None, after: Identification | None) -> list[dict[str, Any]]:
    if before is None:
        return []
    old, new = before.full, (after or before).full
    errors = np.sqrt(np.diag(new.clustered_covariance))
    return [
        {
            "number": int(number),
            "name": name,
            "before_mm": 1e3 * float(a),
            "after_mm": 1e3 * float(b),
            "standard_error_mm": 1e3 * float(s),
            "moved_in_standard_errors": float((b - a) / s),
        }
        for number, name, a, b, s in zip(new.numbers, new.names, old.value, new.value, errors, strict=True)
    ]
