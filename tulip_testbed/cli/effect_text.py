"""An effect as a JSON document, and explained for the terminal."""

from __future__ import annotations

from inspect import cleandoc
from typing import Any

from tulip_testbed.effects import laws
from tulip_testbed.effects.catalogue import explanation
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.laws import law_effect
from tulip_testbed.effects.laws.grammar import VALID, quantities, shapes_of, whats
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.sim.robot import Robot

EXAMPLES = (
    "encoder:right_knee/own-angle/sine",
    "cells:left/plate-load/quadratic-gain",
    "cell:left.rear_left/time/step",
)


def target_names(effect: Effect, robot: Robot) -> list[str]:
    """Return the valid targets; none if the effect has none or only an experiment has them."""
    return [target for target in effect.targets.of(robot, ()) if target]


def effect_document(effect: Effect, robot: Robot) -> dict[str, Any]:
    """Return the JSON document of an effect."""
    return {
        "name": effect.name,
        "sentence": effect.sentence,
        "usage": effect.usage,
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "prior_sd": p.prior if p.prior > 0 else None,
                "positive": p.positive,
                "grid": list(p.grid),
            }
            for p in effect.parameters
        ],
        "target": effect.targets.word or None,
        "targets": target_names(effect, robot),
        "statics": effect.statics,
        "explanation": explanation(effect.name),
    }


def law_document(robot: Robot) -> list[dict[str, Any]]:
    """Return the grammar of laws as JSON: what errs, as a function of what, and the shapes."""
    return [
        {"what": what, "of": of, "shapes": list(shapes_of(what.partition(":")[0], of.partition(":")[0]))}
        for what in whats(robot)
        for of in quantities(robot, what)
    ]


def law_lines(robot: Robot) -> list[str]:
    """Explain the grammar of laws in full."""
    lines = [
        "law: an effect composed of what errs, as a function of what, in which shape.",
        "",
        *cleandoc(laws.__doc__ or "").splitlines(),
        "",
        "--effects law:WHAT/OF/SHAPE=SIZE,...[,NUMBER OF THE SHAPE][,FROM,TO]",
        "  For example:",
    ]
    lines += [f"    law:{text}={','.join(names)}" for text in EXAMPLES for names in [_placeholders(text)]]
    lines += ["  FROM and TO are the ends of the range in which the law was learned, in SI units.", ""]
    for kind, allowed in VALID.items():
        places = [what.partition(":")[2] for what in whats(robot) if what.partition(":")[0] == kind]
        lines.append(f"{kind}:NAME, one of {', '.join(places)}")
        lines += [f"  {of}: {', '.join(shapes_of(kind, of))}" for of in allowed]
    return lines


def _placeholders(text: str) -> list[str]:
    return [p.placeholder for p in law_effect(text).parameters]


def effect_lines(effect: Effect, robot: Robot) -> list[str]:
    """Explain an effect in full."""
    where = "static laboratory and full dynamics" if effect.statics else "full dynamics only"
    named = effect.targets is PLACEMENTS
    targets = "the experiment's placements" if named else ", ".join(target_names(effect, robot))
    return [
        f"{effect.name}: {effect.sentence}",
        "",
        *explanation(effect.name).splitlines(),
        "",
        f"--effects {effect.usage}",
        *(f"  {p.placeholder} [{p.unit or '-'}]: {p.plausible}" for p in effect.parameters),
        *([f"  {effect.targets.word}: {targets}"] if effect.targets.word else []),
        f"Laboratory: {where}",
    ]
