"""An effect as a JSON document, and explained for the terminal."""

from __future__ import annotations

from typing import Any

from tulip_testbed.effects.catalogue import explanation
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.sim.robot import Robot


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
        f"--effect {effect.usage}",
        *(f"  {p.placeholder} [{p.unit or '-'}]: {p.plausible}" for p in effect.parameters),
        *([f"  {effect.targets.word}: {targets}"] if effect.targets.word else []),
        f"Laboratory: {where}",
    ]
