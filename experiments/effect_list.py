"""The effects that can be simulated: listed, or one explained."""

from dataclasses import dataclass
from inspect import cleandoc
from typing import Any

from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table, Verbatim
from tulip_testbed.effects import laws
from tulip_testbed.effects.catalogue import Catalogue, catalogue, explanation
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.laws import LAW, law_effect
from tulip_testbed.effects.laws.grammar import VALID, quantities, shapes_of, whats
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.sim.robot import Robot

EXAMPLES = (
    "encoder:right_knee/own-angle/sine",
    "cells:left/plate-load/quadratic-gain",
    "cell:left.rear_left/time/step",
)


@dataclass(frozen=True, repr=False)
class EffectList(Result):
    """Effects with their targets on a robot: one by its name, their grammar "law", or all (None)."""

    name: str | None
    robot: Robot

    @property
    def effects(self) -> Catalogue:
        """Return the effects that are listed; none if the grammar is explained."""
        every = catalogue()
        return Catalogue([every[name] for name in every if self.name in (None, name)])

    def tables(self) -> list[Table | str]:
        if self.name is None:
            law = "`tulip atlas effects law` explains how an effect is composed that is not in the list."
            return [self.effects.table(), law]
        lines = (
            law_lines(self.robot) if self.name == LAW else effect_lines(self.effects[self.name], self.robot)
        )
        return [*map(Verbatim, lines)]

    def to_json(self) -> dict[str, Any]:
        document: dict[str, Any] = {
            "effects": [
                {
                    "name": effect.name,
                    "sentence": effect.sentence,
                    "usage": effect.usage,
                    "parameters": [
                        {"name": p.name, "unit": p.unit, "prior_sd": p.prior if p.prior > 0 else None}
                        | {"positive": p.positive, "grid": list(p.grid)}
                        for p in effect.parameters
                    ],
                    "target": effect.targets.word or None,
                    "targets": target_names(effect, self.robot),
                    "statics": effect.statics,
                    "explanation": explanation(effect.name),
                }
                for effect in self.effects.values()
            ]
        }
        if self.name == LAW:
            pairs = [(what, of) for what in whats(self.robot) for of in quantities(self.robot, what)]
            kinds = {pair: [part.partition(":")[0] for part in pair] for pair in pairs}
            document["laws"] = [
                {"what": what, "of": of, "shapes": list(shapes_of(*kinds[what, of]))} for what, of in pairs
            ]
        return document


def target_names(effect: Effect, robot: Robot) -> list[str]:
    """Return the valid targets; none if the effect has none or only an experiment has them."""
    return [target for target in effect.targets.of(robot, ()) if target]


def law_lines(robot: Robot) -> list[str]:
    lines = [
        "law: an effect composed of what errs, as a function of what, in which shape.",
        "",
        *cleandoc(laws.__doc__ or "").splitlines(),
        "",
        "Usage: law:WHAT/OF/SHAPE=SIZE,...[,NUMBER OF THE SHAPE][,FROM,TO]",
        "  For example:",
    ]
    sizes = {text: ",".join(p.placeholder for p in law_effect(text).parameters) for text in EXAMPLES}
    lines += [f"    law:{text}={names}" for text, names in sizes.items()]
    lines += ["  FROM and TO are the ends of the range in which the law was learned, in SI units.", ""]
    for kind, allowed in VALID.items():
        places = [what.partition(":")[2] for what in whats(robot) if what.partition(":")[0] == kind]
        lines.append(f"{kind}:NAME, one of {', '.join(places)}")
        lines += [f"  {of}: {', '.join(shapes_of(kind, of))}" for of in allowed]
    return lines


def effect_lines(effect: Effect, robot: Robot) -> list[str]:
    where = "static laboratory and full dynamics" if effect.statics else "full dynamics only"
    named = effect.targets is PLACEMENTS
    targets = "the experiment's placements" if named else ", ".join(target_names(effect, robot))
    return [
        f"{effect.name}: {effect.sentence}",
        "",
        *explanation(effect.name).splitlines(),
        "",
        f"Usage: {effect.usage}",
        *(f"  {p.placeholder} [{p.unit or '-'}]: {p.plausible}" for p in effect.parameters),
        *([f"  {effect.targets.word}: {targets}"] if effect.targets.word else []),
        f"Laboratory: {where}",
    ]
