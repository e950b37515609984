"""`tulip export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import DEFAULT_SEED, Json, RobotFile, Seed
from tulip_testbed.sim.shipped import TULIP


def export_command(
    run: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="run folder or measurement folder")
    ],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="MODEL.xml|MODEL.urdf", help="new model file")],
    source: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="published MJCF or URDF of which `tulip robot` made the robot: its inertias are replaced",
        ),
    ] = None,
    samples: Annotated[
        int, tyro.conf.arg(help="random robots that the measurements allow, in MODEL-samples.npz; 0: none")
    ] = 200,
    seed: Seed = DEFAULT_SEED,
    lengths: Annotated[
        bool, tyro.conf.arg(help="put the link lengths that RUN adopted into the file")
    ] = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Write the identified robot as a model file (MJCF or URDF).

    RUN is the folder of a validation, of a discovery or of measurements. Base parameters and total mass are
    the identified ones; what statics cannot see is as near to CAD as physical consistency allows. Only the
    <inertial> elements of the robot's own file change.

    Example: tulip export runs/first --out identified.xml
    """
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, show, working_on
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.export.export_model import Export, export_model
    from tulip_testbed.experiments.export.identified_run import identified_run

    check_new(out)
    described = described_robot(robot)
    with working_on("identifying the robot"):
        found, measurements, adopted = identified_run(run, described)
    with working_on("looking for the consistent robot"):
        made = export_model(
            found, described, Export(out, source, samples, seed, adopted, lengths), measurements.weighed_mass
        )
    if as_json:
        print_json(made.plain())
    else:
        show(*made.parts())
    return 0
