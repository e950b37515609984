"""An effect on a target with values: how it is written, read, checked, simulated and removed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from pydantic import ConfigDict, GetCoreSchemaHandler, with_config
from pydantic_core import CoreSchema, core_schema
from typing_extensions import TypedDict

from tulip_testbed.base.arguments import expect
from tulip_testbed.base.errors import InputError, listed, look_up, shortened, warn
from tulip_testbed.base.numbers import number
from tulip_testbed.effects.catalogue import catalogue, every_effect
from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.lasting import arranged, check_everywhere, split_target
from tulip_testbed.effects.laws import LAW, law_effect
from tulip_testbed.effects.targets import check_target
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import moved_by
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot

MOST_PRIORS = 100.0  # a value of more prior standard deviations than this is refused as a wrong unit
DOUBTFUL_PRIORS = 10.0  # a value of more is doubtful
OF_LOADS = ("joint-compliance", "sole-compliance", "foot-compliance")  # by which parts yield to their loads
LEANING = ("sole-compliance", "foot-compliance", "foot-damping")  # effects by which feet lean


@with_config(ConfigDict(extra="forbid", strict=True))
class ParameterDocument(TypedDict):
    """A parameter's value in SI units, with its 95 % interval or None."""

    name: str
    value: float
    unit: str
    low95: float | None
    high95: float | None


@with_config(ConfigDict(extra="forbid", strict=True))
class EffectDocument(TypedDict):
    """An effect on a target in JSON; target None: the effect acts on the whole."""

    name: str
    target: str | None
    parameters: list[ParameterDocument]


def effect_named(name: str, target: str, where: str, among: Mapping[str, Effect] | None = None) -> Effect:
    """Return an effect of the catalogue, or of other ones, or the one that a law's target says."""
    if name == LAW:
        return law_effect(target, where)
    among = catalogue() if among is None else among
    return among[look_up("effect", name, [*among, LAW], where)]


def effect_label(name: str, target: str | None) -> str:
    """Join the name of an effect and its target, if there is one, to `name:target`."""
    return f"{name}:{target}" if target else name


def split_label(label: str) -> tuple[str, str]:
    """Split `name:target` into the name of the effect and its target, "" if there is none."""
    name, _, target = label.partition(":")
    return name, target


@dataclass(frozen=True)
class EffectInstance:
    """One effect on one target, written `name:target=values`.

    Attributes:
        target: "" where the effect acts on the whole.
        values: of the effect's parameters, in order [SI].
        intervals: 95 % interval of each value, None for a value that was not estimated; empty: none was.
    """

    effect: Effect
    target: str
    values: Values
    intervals: tuple[tuple[float, float] | None, ...] = ()

    @classmethod
    def parse(
        cls, text: str, robot: Robot, placements: Sequence[int] | None = None, where: str = "effect"
    ) -> Self:
        """Read `name:target=value,value`, with values in SI units and choices by name.

        Args:
            placements: numbers of the experiment's placements; None: unknown, so any number is accepted.
            where: place of the text, for messages.

        Raises:
            InputError: with what is wrong and what is valid.
        """
        label, equals, tail = text.rpartition("=") if "=" in text else (text, "", "")
        name, target = split_label(label)
        effect = effect_named(name, target, where)
        where = f"{where} {shortened(text)}"
        values = tail.split(",") if equals else []
        if len(values) != len(effect.parameters):
            raise InputError(
                f"{where}: found {len(values)} values, expected {len(effect.parameters)}: {effect.usage}"
            )
        numbers = [_number(v, p, where) for v, p in zip(values, effect.parameters, strict=True)]
        found = cls(effect, target, tuple(numbers))
        check_everywhere(target, where)
        check_instance(found, robot, placements, where)
        return found

    def __str__(self) -> str:
        texts = (_written(v, p) for v, p in zip(self.values, self.effect.parameters, strict=True))
        return f"{self.label}={','.join(texts)}"

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return effect_label(self.effect.name, self.target)

    @property
    def named_values(self) -> dict[str, float]:
        """Return every number by its name, `effect:target` or `effect:target, parameter` [SI]."""
        parameters = self.effect.parameters
        several = len(parameters) > 1
        return {
            self.label + (f", {parameter.name}" if several else ""): value
            for parameter, value in zip(parameters, self.values, strict=True)
        }

    @property
    def finding(self) -> str:
        """Return the effect as a sentence, with values ± half of their 95 % intervals."""
        target, first = split_target(self.target)
        said = self.effect.told(target, self.values, self.intervals)
        return said if first is None else f"From experiment {first} on: {said[0].lower()}{said[1:]}"

    @property
    def doubts(self) -> list[str]:
        """Return a warning for every implausible value: most often another unit was meant."""
        return [
            f"{self.label}: {p.name} {_with_unit(number(value), p)} ({p.text(value)}) is "
            f"{abs(value) / p.prior:.0f} times what is plausible ({_with_unit(number(p.prior, '.3g'), p)}); "
            "values are in SI units"
            for p, value in zip(self.effect.parameters_on(self.target), self.values, strict=True)
            if p.prior and abs(value) > DOUBTFUL_PRIORS * p.prior
        ]

    @property
    def choices(self) -> list[float]:
        """Return the values that choose one of several things."""
        return [v for p, v in zip(self.effect.parameters, self.values, strict=True) if p.choices]

    def document(self) -> EffectDocument:
        ends = [interval or (None, None) for interval in self.intervals or (None,) * len(self.values)]
        return {
            "name": self.effect.name,
            "target": self.target or None,
            "parameters": [
                {"name": p.name, "value": value, "unit": p.unit, "low95": low, "high95": high}
                for p, value, (low, high) in zip(self.effect.parameters, self.values, ends, strict=True)
            ],
        }

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let documents hold effects; who reads them checks by `check_instance` that the robot has them."""
        read = core_schema.no_info_after_validator_function(
            cls.from_document, handler.generate_schema(EffectDocument)
        )
        return core_schema.json_or_python_schema(
            read,
            core_schema.is_instance_schema(cls),
            serialization=core_schema.plain_serializer_function_ser_schema(cls.document),
        )

    @classmethod
    def from_document(cls, document: EffectDocument) -> Self:
        """Read what `document` returned; `check_instance` tells whether a robot has this effect."""
        target = document["target"] or ""
        effect = effect_named(document["name"], target, "effects", every_effect())
        parameters = document["parameters"]
        expected = [(parameter.name, parameter.unit) for parameter in effect.parameters]
        written = [(parameter["name"], parameter["unit"]) for parameter in parameters]
        if written != expected:
            raise InputError(
                f"{effect.name}: found parameters {shortened(listed(written), 120)}, "
                f"expected {listed(expected)} (name, unit)"
            )
        intervals = []
        for parameter in parameters:
            value, low, high = parameter["value"], parameter["low95"], parameter["high95"]
            intervals.append(None if low is None or high is None else (low, high))
            if low is not None and high is not None and not low <= value <= high:
                raise InputError(
                    f"{effect.name}, {parameter['name']}: found {value:g} outside of its interval "
                    f"[{low:g}, {high:g}], expected it inside, and low95 up to high95"
                )
        values = tuple(parameter["value"] for parameter in parameters)
        return cls(effect, target, values, tuple(intervals) if any(intervals) else ())


Effects = EffectInstance | str | Sequence[EffectInstance | str]


def several(effects: Effects, where: str = "effects") -> tuple[EffectInstance | str, ...]:
    """Return one effect or many as a tuple; refuse something else."""
    expect(where, effects, Effects)
    return (effects,) if isinstance(effects, EffectInstance | str) else tuple(effects)


def instances_of(effects: Effects, robot: Robot, where: str = "effects") -> tuple[EffectInstance, ...]:
    """Return effects, of which texts are read, with a warning for every implausible value."""
    found = tuple(
        EffectInstance.parse(e, robot) if isinstance(e, str) else e for e in several(effects, where)
    )
    check_instances(found, robot, where)
    for doubt in (text for instance in found for text in instance.doubts):
        warn(doubt)
    return found


def check_instances(found: Sequence[EffectInstance], robot: Robot, where: str) -> None:
    """Refuse effects that a robot does not have: made for another one, or of impossible values."""
    for instance in found:
        check_instance(instance, robot, None, f"{where}: {instance.label}")


def check_different(found: Sequence[EffectInstance], where: str) -> None:
    """Refuse an effect that would be corrected for twice."""
    seen: dict[tuple[object, ...], EffectInstance] = {}
    for instance in found:
        grid = [
            v for p, v in zip(instance.effect.parameters, instance.values, strict=True) if p.grid or p.choices
        ]
        key = (instance.label, *grid)
        if key in seen:
            raise InputError(
                f"{where}: found {instance.label} twice ({seen[key]} and {instance}), expected it once"
            )
        seen[key] = instance


def _number(text: str, parameter: Parameter, where: str) -> float:
    if parameter.choices:
        return float(parameter.choices.index(look_up(parameter.name, text.strip(), parameter.choices, where)))
    try:
        return float(text)
    except ValueError:
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        raise InputError(
            f"{where}: {parameter.name}: found '{shortened(text)}', expected a number{unit}"
        ) from None


def _with_unit(text: str, parameter: Parameter) -> str:
    return f"{text} {parameter.unit}".strip()


def _written(value: float, parameter: Parameter) -> str:
    """Write a value so that `_number` reads the same value again."""
    return parameter.choices[round(value)] if parameter.choices else repr(float(value)).removesuffix(".0")


def check_instance(found: EffectInstance, robot: Robot, placements: Sequence[int] | None, where: str) -> None:
    """Refuse a target or a value that makes no sense; placements as in `EffectInstance.parse`."""
    effect = found.effect
    if len(found.values) != (count := len(effect.parameters)) or len(found.intervals) not in (0, count):
        raise InputError(
            f"{where}: found {len(found.values)} values and {len(found.intervals)} intervals, "
            f"expected {count} values, and an interval for each or for none: {effect.usage}"
        )
    check_target(effect.targets, split_target(found.target)[0], robot, placements, where)
    for parameter, value in zip(effect.parameters_on(found.target), found.values, strict=True):
        here = f"{where}: {effect.name}, {parameter.heading}: found {value:g}"
        if not np.isfinite(value):
            raise InputError(f"{here}, expected a finite number")
        if parameter.positive and value < 0:
            raise InputError(f"{here}, expected 0 or more")
        if parameter.choices:
            if value not in range(len(parameter.choices)):
                raise InputError(f"{here}, expected 0 to {len(parameter.choices) - 1}")
        elif parameter.grid and not min(parameter.grid) <= value <= max(parameter.grid):
            raise InputError(f"{here}, expected within [{min(parameter.grid):g}, {max(parameter.grid):g}]")
        if parameter.prior > 0 and abs(value) > MOST_PRIORS * parameter.prior:
            most = MOST_PRIORS * parameter.prior
            raise InputError(f"{here}, expected at most {most:.3g} in size (SI units: rad, m, N, kg)")
    if why := effect.refusal(found.values):
        raise InputError(f"{where}: {why}")
    if len(chosen := found.choices) > len(set(chosen)):
        raise InputError(f"{where}: {effect.name}: found the same choice twice, expected different ones")


def check_laboratory(found: EffectInstance, statics: bool, where: str) -> None:
    """Refuse an effect that the laboratory cannot simulate if it is static."""
    if statics and not found.effect.statics:
        known = listed(effect.name for effect in catalogue().values() if effect.statics)
        raise InputError(
            f"{where}: found {found.effect.name}, which only the full dynamics can simulate; "
            f"the static laboratory can simulate {known}"
        )


def injected(rig: Rig, instances: Sequence[EffectInstance]) -> Rig:
    """Return the laboratory with these effects, applied in the order of their stages."""
    for found in _in_order(instances):
        check_everywhere(found.target, str(found))
        rig = found.effect.inject(rig, found.target, found.values)
    return rig


def removed(observed: Observation, instances: Sequence[EffectInstance]) -> Observation:
    """Return the observation with these effects removed, in the reverse order of their stages."""
    if observed.upright and (leaning := [one for one in instances if one.effect.name in LEANING]):
        others = [one for one in instances if one not in leaning]
        out = rest = removed(observed, others)
        for one in leaning:
            out = one.effect.remove(out, one.target, one.values)
        return misread_in_feet(observed, others, rest, out)
    for found in reversed(_in_order(instances)):
        observed = found.effect.remove(observed, found.target, found.values)
    return observed


def removed_at(
    smooth: Observation | None, observed: Observation, instances: Sequence[EffectInstance]
) -> Observation:
    """Return the observation with these effects removed, which change it as they change another one.

    Args:
        smooth: the other one, with less noise; None: the observation itself.
    """
    if smooth is None:
        return removed(observed, instances)
    return moved_by(observed, smooth, removed(smooth, instances))


def misread_in_feet(
    observed: Observation,
    others: Sequence[EffectInstance],
    rest: Observation,
    leaning: Observation,
    smooth: Observation | None = None,
) -> Observation:
    """Return the observation of feet that lean, with what the sensors misread removed in the feet's axes.

    Software turned the readings to the world's axes after the sensors had misread them. So they are turned
    back first, as far as the feet are found to lean.

    Args:
        others: effects that were removed from `observed` to give `rest`. leaning: `rest` with feet that lean.
        smooth: at which they were removed, see `removed_at`.
    """
    if not others or not observed.upright:
        return leaning
    tilts = [np.stack([one.stance_tilt, one.swing_tilt], axis=1) for one in (rest, leaning)]

    def turned_back(one: Observation) -> Observation:
        return one.changed(cell_forces=one.seen_from(tilts[1] - tilts[0]))

    quiet = None if smooth is None else turned_back(smooth)
    return leaning.changed(cell_forces=removed_at(quiet, turned_back(observed), others).cell_forces)


def as_manipulated(instances: Sequence[EffectInstance], experiment: Experiment) -> tuple[EffectInstance, ...]:
    """Return effects as they act where instruments that were zeroed, tared or surveyed again are exact."""
    out = []
    for one in instances:
        check_everywhere(one.target, str(one))
        if one.effect.lasting.ended(one.target, experiment.arrangement):
            continue
        if (act := arranged(one.effect, one.target, one.values, experiment)) is not None:
            out.append(replace(one, target=act[0], values=act[1], intervals=()))
    return tuple(out)


def _in_order(instances: Sequence[EffectInstance]) -> list[EffectInstance]:
    """Sort effects by their stages.

    Parts that yield to loads come first: their loads are known once everything else is removed. Gravity turns
    next, that of the masses that are added later too.
    """

    def order(one: EffectInstance) -> tuple[int, bool, bool]:
        name = one.effect.name
        return one.effect.stage, name not in (*OF_LOADS, "backlash"), name != "tilt"

    return sorted(instances, key=order)
