"""`tulip atlas`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import DEFAULT_SEED, Json, Plan, PlateSensors, RobotFile, Seed
from tulip_testbed.sim.shipped import TULIP


def atlas_command(
    plan: Plan = None,
    /,
    *,
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FOLDER", help="write a page, atlas.json, bias.csv, a heat map"),
    ] = None,
    preset: PlateSensors = "wii",
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Predict which effects a plan can detect and distinguish.

    No data are needed. The screen shows one row for each kind of effect. The page atlas.html in the folder
    shows every effect with the bias that it causes if it is not modelled; it has a search box.

    Example: tulip atlas --preset force-plate --out atlas
    """
    import numpy as np

    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import print_json, say, show, working_on
    from tulip_testbed.experiments.atlases.atlas_tables import atlas_summary
    from tulip_testbed.experiments.atlases.effect_atlas import atlas, document
    from tulip_testbed.experiments.atlases.planned_experiment import planned
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for

    if out is not None:
        check_new(out)
    described = described_robot(robot)
    made = plan_for(described, plan)
    check_plan(described, made, str(plan or DEFAULT_PLAN))
    with working_on("solving the plan and predicting every effect"):
        found = atlas(planned(made, preset, described, seed), np.random.default_rng(seed))
    said = {"preset": preset, "seed": seed, **document(found)}
    if out is not None:
        from tulip_testbed.pages.atlas_page import PAGE, write_atlas  # plotly loads slowly

        write_atlas(out, found, said)
        say(f"Atlas: {out / PAGE}")
    if as_json:
        print_json(said)
    else:
        show(*atlas_summary(found))
    return 0
