"""`tulip tolerance`."""

from __future__ import annotations

from tulip_testbed.cli.options import Json, Plan, Preset, RobotFile, Seed
from tulip_testbed.cli.terminal import print_json, progress, show, working_on
from tulip_testbed.experiments.atlas.planned_experiment import planned
from tulip_testbed.experiments.atlas.tolerance import document, sources, tolerance
from tulip_testbed.experiments.atlas.tolerance_tables import tolerance_report
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import DEFAULT_SEED
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for
from tulip_testbed.sim.errors import at_least
from tulip_testbed.sim.robot import TULIP


def tolerance_command(
    plan: Plan = None,
    /,
    *,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """How exactly plates, floor, encoders and cells must be set up for parameters without bias.

    The biases are predicted and simulated. Example: tulip tolerance --preset force-plate
    """
    at_least("seed", seed, 0)
    described = described_robot(robot)
    made = plan_for(described, plan)
    check_plan(described, made, str(plan or DEFAULT_PLAN))
    with working_on("solving the plan"):
        solved_plan = planned(made, preset, described, seed)
    with progress("simulating errors", len(sources(solved_plan))) as advance:
        found = tolerance(solved_plan, advance)
    if as_json:
        print_json({"preset": preset, "seed": seed, **document(found)})
    else:
        show(*tolerance_report(found))
    return 0
