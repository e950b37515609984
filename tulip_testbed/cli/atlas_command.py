"""`tulip atlas`."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from tulip_testbed.cli.options import Json, Plan, Preset, RobotFile, Seed
from tulip_testbed.cli.terminal import print_json, say, show, working_on
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlas.atlas_tables import atlas_report
from tulip_testbed.experiments.atlas.effect_atlas import Atlas, atlas, document
from tulip_testbed.experiments.atlas.isolability import ISOLABLE, order
from tulip_testbed.experiments.atlas.planned_experiment import planned
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import DEFAULT_SEED
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for
from tulip_testbed.sim.errors import at_least
from tulip_testbed.sim.files import check_new, new_folder, write_text
from tulip_testbed.sim.measurements.table_files import finite, write_json
from tulip_testbed.sim.robot import TULIP


def atlas_command(
    plan: Plan = None,
    /,
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help="write atlas.json, bias.csv and a heat map")
    ] = None,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Before any data: which effects a plan would show, which it could not tell apart, which it would hide.

    Example: tulip atlas --preset force-plate --out atlas
    """
    if out is not None:
        check_new(out)
    at_least("seed", seed, 0)
    described = described_robot(robot)
    made = plan_for(described, plan)
    check_plan(described, made, str(plan or DEFAULT_PLAN))
    with working_on("solving the plan and looking at every effect"):
        found = atlas(planned(made, preset, described, seed), np.random.default_rng(seed))
    said = {"preset": preset, "seed": seed, **document(found)}
    if out is not None:
        with new_folder(out) as working:
            write_json(working / "atlas.json", finite(said))
            write_text(working / "bias.csv", biases(found))
            write_text(working / "separation.html", separation(found, preset))
    if as_json:
        print_json(said)
    else:
        show(*atlas_report(found))
    if out is not None:
        say(f"Atlas: {out}")
    return 0


def biases(found: Atlas) -> str:
    """Bias of every parameter by every effect at its plausible size, as CSV [mm] and [standard errors]."""
    numbers = range(1, len(found.planned.standard_errors) + 1)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    columns = [f"{number}_{unit}" for unit in ("mm", "se") for number in numbers]
    table.writerow(["effect", "target", "parameter", *columns])
    for row in found.rows:
        both = np.concatenate([1e3 * row.bias, row.bias / found.planned.standard_errors])
        name = row.candidate.effect.name
        table.writerow([name, row.candidate.target, row.name, *(f"{value:.4g}" for value in both)])
    return text.getvalue()


def separation(found: Atlas, preset: str) -> str:
    """Heat map of the angles, one placement standing for all."""
    from tulip_testbed.pages.heat_map_figures import heat_map  # plotly takes half a second

    kept = _once(found)
    chosen = [kept[k] for k in order(found.angle[np.ix_(kept, kept)])]
    degrees = np.degrees(found.angle[np.ix_(chosen, chosen)])
    bound = float(np.degrees(ISOLABLE))
    title = f"Angle between effects, preset {preset}: below {bound:.0f} deg (brown) they cannot be told apart"
    return heat_map(degrees, [found.shown[k].label for k in chosen], title, "deg", 90.0, bound)


def _once(found: Atlas) -> list[int]:
    """Numbers of the candidates, of those that concern one placement the first alone."""
    placed = [k for k, c in enumerate(found.shown) if c.effect.targets is PLACEMENTS]
    return [k for k in range(len(found.shown)) if k not in placed[1:]]
