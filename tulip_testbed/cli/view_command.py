"""`tulip view`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP

Save = Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd", help="write the view instead of showing it")]
Serve = Annotated[bool, tyro.conf.arg(help="serve it to a browser of this machine (127.0.0.1) alone")]


def view_command(
    folder: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="FOLDER", help="folder of a run, a plan or measurements"),
    ],
    /,
    *,
    save: Save = None,
    serve: Serve = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Show a plan, measurements or a run in rerun.

    The view shows postures, forces and errors.

    Example: tulip view runs/first
    """
    from tulip_testbed.base.errors import InputError, listed
    from tulip_testbed.cli.terminal import print_json, say
    from tulip_testbed.experiments.description import described_robot

    if save is not None and serve:
        raise InputError("--save, --serve: found both, expected one of them")
    described = described_robot(robot)
    from tulip_testbed.viewer import window  # rerun takes half a second to load
    from tulip_testbed.viewer.record_view import folder_view
    from tulip_testbed.viewer.robot_view import undrawn

    view = folder_view(folder, described)
    if save is None and not serve:
        with _or_served():
            window.check_display()
    if bare := undrawn(described.visual_model):
        say(
            f"{described.model_file.name}: no geom shows the links {listed(bare)}; "
            "their frames and masses stand alone"
        )
    if save is not None:
        size = window.save(save, view.title, view.log)
        if as_json:
            print_json({"view": str(save), "bytes": size})
        say(f"View: {save} ({size / 1e6:.1f} MB); open it by `rerun {save}`")
    elif serve:

        def announce(address: str) -> None:
            if as_json:
                print_json({"address": address})
            say(f"Open {address} in a browser; Ctrl-C ends it.")

        window.serve(view.title, view.log, announce)
    else:
        with _or_served():
            window.show(view.title, view.log)
    return 0


@contextmanager
def _or_served() -> Iterator[None]:
    """Add to a refusal of the library what only the command can do without a window."""
    from tulip_testbed.base.errors import InputError

    try:
        yield
    except InputError as error:
        raise InputError(f"{error}, `--serve` shows it in a browser") from None
