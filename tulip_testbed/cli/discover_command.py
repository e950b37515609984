"""`tulip discover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import CORES, FOLDERS, Json, RobotFile, TolerancesOf, Workers
from tulip_testbed.sim.shipped import TULIP

NEW = Annotated[Path | None, tyro.conf.arg(help="run folder to write; runs/discover-DATE-TIME if not given")]
NoCheck = Annotated[
    bool,
    tyro.conf.arg(
        help="do not simulate the adopted physics in the full dynamics (saves up to two minutes; faults of "
        "instruments are never simulated, because they are predicted exactly)"
    ),
]


def discover_command(
    folder: Annotated[tuple[Path, ...], tyro.conf.Positional, FOLDERS],
    /,
    *,
    out: NEW = None,
    no_check: NoCheck = False,
    seed: Annotated[int, tyro.conf.arg(help="seed of the bootstrap that calibrates the level")] = 0,
    tolerance: TolerancesOf = (),
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Find physical effects that the model lacks.

    The command reports where the model disagrees with the measurements and which effect explains
    it. The verdict is
    `none`, `calibrated` (ordinary imperfections explain it), `named`, `described` (by a law composed of what
    errs, as a function of what, in which shape), `ambiguous` or `unknown`. The effects found are added to the
    model: the rig in the run folder can be given to `--corrections` of other commands.

    Example: tulip discover data/first --out runs/found

    Example: tulip discover data/monday data/tuesday
    """
    from contextlib import ExitStack
    from datetime import datetime

    from tulip_testbed.base.files import check_new
    from tulip_testbed.calibration.families import read_tolerances
    from tulip_testbed.cli.terminal import print_json, progress, say, show, show_verdict
    from tulip_testbed.experiments.check_folder import warn_of_faults
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.discovering import discover_effects
    from tulip_testbed.experiments.discovery_record import discovery_record, write_discovery
    from tulip_testbed.experiments.discovery_tables import discovery_summary
    from tulip_testbed.measurements.joined import read_experiments, separate

    out = out or Path("runs") / f"discover-{datetime.now():%Y%m%d-%H%M%S-%f}"
    check_new(out)
    described = described_robot(robot)
    measurements, stated = read_experiments(folder), read_tolerances(tolerance)
    source = ", ".join(map(str, folder))
    with ExitStack() as bars:
        found = discover_effects(
            measurements,
            described,
            seed,
            not no_check,
            workers,
            source,
            stated,
            lambda what, total: bars.enter_context(progress(what, total)),
        )
    for one, where in zip(separate(measurements), folder, strict=True):
        warn_of_faults(one, described, source=str(where), tolerances=stated)
    record = write_discovery(out, discovery_record(found, source, seed, no_check))
    document = record.report.plain()
    if as_json:
        print_json(document)
        return 0
    show_verdict(found.verdict)
    show(*discovery_summary(document, found.story))
    say(f"Run folder: {out}")
    return 0
