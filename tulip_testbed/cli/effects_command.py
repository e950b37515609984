"""`tulip effects`."""

from __future__ import annotations

from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP


def effects_command(
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None,
    /,
    *,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """List the physical effects that can be simulated, or explain one.

    Example: tulip effects encoder-offset
    """
    from tulip_testbed.cli.effect_text import effect_document, effect_lines
    from tulip_testbed.cli.terminal import print_json, show, show_whole
    from tulip_testbed.effects.catalogue import Catalogue, catalogue
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.sim.errors import look_up

    described = described_robot(robot)
    if name is not None:
        look_up("effect", name, catalogue(), "effects")
    chosen = catalogue() if name is None else Catalogue([catalogue()[name]])
    if as_json:
        print_json({"effects": [effect_document(effect, described) for effect in chosen.values()]})
    elif name is None:
        show(chosen.table())
    else:
        show_whole(effect_lines(chosen[name], described))
    return 0
