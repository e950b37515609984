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

    `law` explains the grammar by which effects are composed that the list lacks: what errs, as a function of
    what, in which shape.

    Example: tulip effects encoder-offset
    """
    from tulip_testbed.base.errors import look_up
    from tulip_testbed.cli.effect_text import effect_document, effect_lines, law_document, law_lines
    from tulip_testbed.cli.terminal import print_json, show, show_whole
    from tulip_testbed.effects.catalogue import Catalogue, catalogue
    from tulip_testbed.effects.laws import LAW
    from tulip_testbed.experiments.description import described_robot

    described = described_robot(robot)
    if name == LAW:
        if as_json:
            print_json({"effects": [], "laws": law_document(described)})
        else:
            show_whole(law_lines(described))
        return 0
    if name is not None:
        look_up("effect", name, [*catalogue(), LAW], "effects")
    chosen = catalogue() if name is None else Catalogue([catalogue()[name]])
    if as_json:
        print_json({"effects": [effect_document(effect, described) for effect in chosen.values()]})
    elif name is None:
        show(
            chosen.table(), "`tulip effects law` explains how an effect is composed that is not in the list."
        )
    else:
        show_whole(effect_lines(chosen[name], described))
    return 0
