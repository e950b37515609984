"""A discovery as one JSON document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.discovery.discover import AMBIGUOUS, Discovery, instance_of
from tulip_testbed.discovery.linear_model import Linear
from tulip_testbed.discovery.proposals import Proposal, proposals
from tulip_testbed.discovery.ranking import Rival
from tulip_testbed.effects.instance import EffectInstance, split_label
from tulip_testbed.experiments.identify import Identification


def next_experiments(found: Discovery) -> list[Proposal]:
    """For what is ambiguous; empty else."""
    if found.verdict != AMBIGUOUS:
        return []
    linear: Linear = found.explanation.before.linear
    out: list[Proposal] = []
    for rivals in found.rivals:
        if len(rivals) > 1:
            out += proposals(linear, [rival.term for rival in rivals])
    return sorted({p.words: p for p in out}.values(), key=lambda p: -p.separation)


def discovery_document(
    found: Discovery,
    next_experiment: list[Proposal],
    told: list[str],
    rig: Path | None,
    before: Identification | None = None,
    after: Identification | None = None,
    check: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """What `tulip discover --json` prints.

    Args:
        told: `story`. rig: folder of the adopted model. before, after: base parameters without and with it.
        check: of the adopted model in full dynamics.
    """
    factors = [rivals[0].log_bayes_factor for rivals in found.rivals]
    adopted = [
        instance.document() | {"log_bayes_factor": factor}
        for instance, factor in zip(found.adopted, factors, strict=False)
    ]
    return {
        "verdict": found.verdict,
        "effects": adopted,
        "candidates": [_candidate(found, k, rival) for k, r in enumerate(found.rivals) for rival in r],
        "undetectable": [
            {
                "name": name,
                "target": target or None,
                "parameter": u.parameter or None,
                "bias_mm_per_prior_sd": 1e3 * u.bias if u.parameter else None,
            }
            for u in found.unseen
            for name, target in [split_label(u.label)]
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
        "alarm_p": found.explanation.alarm,
        "left": [{"channel": p.channel, "pattern": p.words, "p": p.p} for p in found.left],
        "story": told,
        "check": check,
        "rig": None if rig is None else str(rig),
        "wall_s": found.wall_s,
    }


def _candidate(found: Discovery, k: int, rival: Rival) -> dict[str, Any]:
    adopted = rival.label == found.found.terms[k].candidate.label
    instance = (
        instance_of(found.found.terms[k], found.found, k)
        if adopted
        else EffectInstance(rival.term.candidate.effect, rival.term.candidate.target, rival.term.values)
    )
    return {"gap": k + 1} | instance.document() | {"log_bayes_factor": rival.log_bayes_factor}


def _gap(found: Discovery) -> dict[str, Any]:
    """By channel, whitened r.m.s. on held-out placements: 1 is the noise; floor: 97.5 % by chance."""
    held = found.heldout
    if held is None:
        return {
            g.channel: {"before": float(np.sqrt(g.chi_square / g.freedom)), "after": None, "floor": 1.0}
            for g in found.explanation.gaps
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
