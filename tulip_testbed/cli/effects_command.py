"""`tulip effects`."""

from __future__ import annotations

from typing import Annotated, Any

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.cli.terminal import print_json, show, show_whole
from tulip_testbed.effects.catalogue import HEADERS, Catalogue, catalogue, explanation
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.table import Column, Table
from tulip_testbed.sim.errors import listed, look_up
from tulip_testbed.sim.robot import TULIP, Robot


def effects_command(
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None,
    /,
    *,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """List the physical effects that can be simulated and discovered, or explain one in full.

    Example: tulip effects encoder-offset
    """
    described = described_robot(robot)
    if name is not None:
        look_up("effect", name, catalogue(), "effects")
    chosen = catalogue() if name is None else Catalogue({name: catalogue()[name]})
    if as_json:
        print_json({"effects": [_document(effect, described) for effect in chosen.values()]})
    elif name is None:
        show(Table("Effects; values are given in SI units", tuple(map(Column, HEADERS)), chosen.rows()))
    else:
        show_whole(_explanation(chosen[name], described))
    return 0


def _targets(effect: Effect, robot: Robot) -> list[str]:
    """Return the valid targets; none if the effect has none or only an experiment has them."""
    return [target for target in effect.targets.of(robot, ()) if target]


def _document(effect: Effect, robot: Robot) -> dict[str, Any]:
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
        "targets": _targets(effect, robot),
        "statics": effect.statics,
        "explanation": explanation(effect.name),
    }


def _explanation(effect: Effect, robot: Robot) -> list[str]:
    where = "static laboratory and full dynamics" if effect.statics else "full dynamics only"
    named = effect.targets is PLACEMENTS
    targets = "the experiment's placements" if named else listed(_targets(effect, robot))
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
