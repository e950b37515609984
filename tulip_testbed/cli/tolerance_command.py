"""`tulip tolerance`."""

from __future__ import annotations

from tulip_testbed.cli.options import DEFAULT_SEED, Json, Plan, PlateSensors, RobotFile, Seed
from tulip_testbed.sim.shipped import TULIP


def tolerance_command(
    plan: Plan = None,
    /,
    *,
    preset: PlateSensors = "wii",
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Compute how accurately a laboratory must be set up.

    Errors of plates, floor, encoders and cells bias the parameters; the biases are predicted and simulated.

    Example: tulip tolerance --preset force-plate
    """
    from tulip_testbed.cli.terminal import print_json, progress, show, working_on
    from tulip_testbed.experiments.atlases.planned_experiment import planned
    from tulip_testbed.experiments.atlases.tolerance import document, sources, tolerance
    from tulip_testbed.experiments.atlases.tolerance_tables import tolerance_report
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for

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
