"""discovery.json: what was found, as `tulip discover --json` prints it."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from tulip_testbed.base.document import Document, Figure
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.discover import Discovery
from tulip_testbed.discovery.law_candidates import is_law
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectDocument, EffectInstance, ParameterDocument, effect_label
from tulip_testbed.effects.laws import Sentence, sentence_of
from tulip_testbed.experiments.family_tables import family_documents
from tulip_testbed.experiments.findings import Findings
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.proposed_experiment import ProposedExperiment, proposed
from tulip_testbed.measurements.bounds import MOST_FORCE

Channel = Literal["A", "F", "T", "C"]
Gap = Channel | Literal["all", "heldout_rms_mm"]


def _known(name: str) -> str:
    if name not in catalogue():
        raise ValueError(f"one of {', '.join(catalogue())}")
    return name


def _sized(name: str) -> str:
    if not catalogue()[_known(name)].sizes:
        raise ValueError("an effect that has a size")
    return name


EffectName = Annotated[str, AfterValidator(_known)]
SizedName = Annotated[str, AfterValidator(_sized)]
Deviation = Annotated[float, Field(ge=0, le=MOST_FORCE)]


class AdoptedEffect(EffectDocument):
    """An effect that was added to the model, with its evidence."""

    log_bayes_factor: float


class CandidateRow(Document):
    """An effect that explains a gap; gap: the number of the gap, from 1."""

    gap: int
    name: str
    target: str | None
    parameters: list[ParameterDocument]
    log_bayes_factor: float

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return effect_label(self.name, self.target)

    @property
    def effect(self) -> EffectDocument:
        """Return the effect alone."""
        return EffectDocument(name=self.name, target=self.target, parameters=self.parameters)


class RunnerUp(Document):
    """An effect that explains a gap less well, by its predictions alone."""

    gap: int
    name: str
    target: str | None
    log_bayes_factor: float


class OtherLaw(Document):
    """Another law that does as well: what errs, as a function of what."""

    what: str
    of: str
    shape: str
    log_bayes_factor: float


class LawReport(Document):
    """A law: what errs, as a function of what, in which shape; also: those that do as well."""

    what: str
    of: str
    shape: str
    sentence: str
    parameters: list[ParameterDocument]
    also: list[OtherLaw]


class FamilySpread(Document):
    """A family of ordinary imperfections and the spread of its members, in tolerances [SI]."""

    name: SizedName
    tolerance: Annotated[float, Field(gt=0)]
    spread: Annotated[float, Field(ge=0)]
    low95: Annotated[float, Field(ge=0)]
    high95: Annotated[float, Field(ge=0)]


class Undetectable(Document):
    """An effect that these postures cannot detect; parameter: number of the one that it biases most."""

    name: EffectName
    target: str | None
    parameter: int | None
    bias_mm_per_prior_sd: Figure


class WeaklyDetectable(Document):
    """An effect that would show only if larger than plausible: least size in prior s.d. and in SI units."""

    name: SizedName
    target: str | None
    least_over_prior: float
    least: Figure
    unit: str | None


class Ratio(Document):
    """Residuals on held-out placements over their noise; floor: what `after` may be by chance."""

    before: float
    after: Figure
    floor: float


class MovedParameter(Document):
    """A base parameter identified without corrections and, if effects were adopted, with them removed [mm].

    Both by the self-calibrating estimator; the standard error is that of the last.
    """

    number: int
    name: str
    before_mm: float
    after_mm: float | None
    standard_error_mm: float
    moved_in_standard_errors: float | None


class Repeats(Document):
    """Repeated postures against the stated noise, by channel."""

    pairs: int
    chi_square_per_freedom: dict[Channel, float]
    p: dict[Channel, float]

    @model_validator(mode="after")
    def _has_the_same_channels(self) -> Self:
        if self.p.keys() != self.chi_square_per_freedom.keys():
            raise ValueError("expected the same channels in 'p' as in 'chi_square_per_freedom'")
        return self


class StatedNoise(Document):
    """Standard deviations of encoders [rad], cells [N] and plate poses [m, m, rad]."""

    encoder_sd: Deviation
    cell_sd: Deviation
    placement_sd: Annotated[list[Deviation], Field(min_length=6, max_length=6)]
    not_as_stated: list[str]


class LeftPattern(Document):
    """A pattern in the residuals that are left."""

    channel: str
    pattern: str
    p: float


class Check(Document):
    """The adopted effects simulated in the full dynamics; reason: why nothing could be compared."""

    postures: int
    tried: int
    left_over_noise: Figure
    cells_rms_N: dict[Literal["before", "after"], Figure]  # noqa: N815, as the key has it
    reason: str | None


class DiscoveryReport(Document):
    """discovery.json."""

    verdict: Literal["none", "calibrated", "named", "described", "ambiguous", "unknown"]
    effects: list[AdoptedEffect]
    calibrated: list[EffectDocument] = Field(default_factory=list)
    families: list[FamilySpread] = Field(default_factory=list)
    laws: list[LawReport] = Field(default_factory=list)
    candidates: list[CandidateRow]
    runners_up: list[RunnerUp] = Field(default_factory=list)
    undetectable: list[Undetectable]
    weakly_detectable: list[WeaklyDetectable] = Field(default_factory=list)
    where: str
    gap: dict[Gap, Ratio | None]
    next_experiment: list[ProposedExperiment]
    parameters: list[MovedParameter]
    repeats: Repeats
    noise: StatedNoise
    alarm_p: Figure
    left: list[LeftPattern]
    story: Annotated[list[str], Field(min_length=1)]
    check: Check | None
    rig: str | None
    wall_s: float


def discovery_report(result: Findings, rig: str | None = None) -> DiscoveryReport:
    """Report a discovery.

    Args:
        rig: folder of the adopted model; None: there is none.
    """
    found = result.discovery
    factors = [found.equivalents[k][0].log_bayes_factor for k in found.effects]
    content: dict[str, Any] = {
        "verdict": found.verdict,
        "effects": [
            instance.document() | {"log_bayes_factor": factor}
            for instance, factor in zip(found.adopted, factors, strict=False)
        ],
        "calibrated": [instance.document() for instance in found.calibrated],
        "families": family_documents(found.families),
        "laws": [
            _law(found, k, one)
            for k, one in zip(found.effects, found.adopted, strict=False)
            if is_law(found.fit.terms[k].candidate)
        ],
        "candidates": [
            {"gap": one.gap, **one.instance.document(), "log_bayes_factor": one.log_bayes_factor}
            for one in found.explanations
        ],
        "runners_up": [_runner_up(k, one) for k in found.effects for one in found.runners_up(k)],
        "undetectable": [
            {
                "name": u.candidate.effect.name,
                "target": u.candidate.target or None,
                "parameter": u.parameter or None,
                "bias_mm_per_prior_sd": 1e3 * u.bias if u.parameter else None,
            }
            for u in found.undetectable
        ],
        "weakly_detectable": [weak.document() for weak in found.selection.weak],
        "where": found.where,
        "gap": _gap(found),
        "next_experiment": [proposed(experiment) for experiment in result.ranking],
        "parameters": _moved(result.before, result.after),
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
        "story": result.story,
        "check": None if result.check is None else result.check.document(),
        "rig": rig,
        "wall_s": found.wall_s,
    }
    return DiscoveryReport.model_validate(content)


def _law(found: Discovery, k: int, adopted: EffectInstance) -> dict[str, Any]:
    sentence = sentence_of(adopted.target)
    others = [one for one in found.equivalents[k] if is_law(one.candidate) and one.label != adopted.label]
    return {
        **_said(sentence),
        "sentence": adopted.finding,
        "parameters": adopted.document()["parameters"],
        "also": [
            _said(sentence_of(one.candidate.target)) | {"log_bayes_factor": one.log_bayes_factor}
            for one in others
        ],
    }


def _said(sentence: Sentence) -> dict[str, str]:
    return {"what": sentence.what, "of": sentence.of, "shape": sentence.shape}


def _runner_up(k: int, one: Fitted) -> dict[str, Any]:
    target = one.candidate.target or None
    return {
        "gap": k + 1,
        "name": one.candidate.effect.name,
        "target": target,
        "log_bayes_factor": one.log_bayes_factor,
    }


def _gap(found: Discovery) -> dict[str, Any]:
    """Return the whitened r.m.s. on held-out placements by channel, and what chance explains."""
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


def _moved(before: Identification, after: Identification | None) -> list[dict[str, Any]]:
    old, new = before.full, (after or before).full
    errors = np.sqrt(np.diag(new.clustered_covariance))
    return [
        {
            "number": int(number),
            "name": name,
            "before_mm": 1e3 * float(first),
            "after_mm": None if after is None else 1e3 * float(last),
            "standard_error_mm": 1e3 * float(error),
            "moved_in_standard_errors": None if after is None else float((last - first) / error),
        }
        for number, name, first, last, error in zip(
            new.numbers, new.names, old.value, new.value, errors, strict=True
        )
    ]
