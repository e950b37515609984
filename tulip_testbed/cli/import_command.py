"""`tulip import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP


def import_command(
    table: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE", help="CSV or Parquet file")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="new measurement folder")],
    robot: RobotFile = TULIP,
    stated: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(
            name="map",
            metavar="FILE.toml | NAME=COLUMN:UNIT:SIGN",
            help="what the table does not say: contacts, columns, units, signs, constant joints",
        ),
    ] = (),
    as_json: Json = False,
) -> int:
    """Make a measurement folder of your own table.

    The table keeps its names, units and signs; the manifest maps them to the contract's. Columns are found by
    their names, units in brackets. Units that no column name gives have to be stated. Signs are +1
    unless stated, and are
    checked against the robot where closed legs, weight and centre of pressure determine them.
    Exit code 0: written, though perhaps with problems to look at; 1: something necessary is missing.

    Example: tulip import standing.csv --robot my/robot/robot.toml --map contacts.toml --out data/standing
    """
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, say, show
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.table_import.import_map import read_map
    from tulip_testbed.experiments.table_import.table_import import import_table

    check_new(out)
    found = import_table(table, described_robot(robot), out, read_map(stated))
    if as_json:
        print_json(found.plain())
    else:
        show(*found.parts())
    if found.folder is None:
        say("No folder was written; state what is missing with --map")
        return 1
    say(f"Measurement folder: {out}")
    return 0
