"""`tulip campaign`."""

from __future__ import annotations

from typing import Annotated

import tyro

from tulip_testbed.cli.options import (
    DEFAULT_SEED,
    Imperfections,
    Json,
    Plan,
    RigFolder,
    RobotFile,
    RunFolder,
    Seed,
    Sensors,
)
from tulip_testbed.cli.simulate_command import Effects
from tulip_testbed.sim.shipped import TULIP


def campaign_command(
    plan: Plan = None,
    /,
    *,
    out: RunFolder,
    preset: Sensors = "wii",
    seed: Seed = DEFAULT_SEED,
    experiments: Annotated[int, tyro.conf.arg(help="largest number of experiments")] = 3,
    minutes: Annotated[
        float | None, tyro.conf.arg(help="minutes of laboratory time at most (assumed times)")
    ] = None,
    effect: Effects = (),
    imperfections: Imperfections = 0.0,
    rig: RigFolder = None,
    dynamics: Annotated[
        bool, tyro.conf.arg(help="hold every posture in the full dynamics instead of its equilibrium")
    ] = False,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate experiments until one explanation is left.

    The command begins with the plan in a virtual laboratory with hidden effects. While several explanations
    are left, it carries out the experiment that settles most per minute. The same command goes on where it
    was stopped.
    `tulip report` writes the campaign's page, `tulip view` shows it.

    Example: tulip campaign --preset force-plate --effect cell-tare:right.front_left=0.8 --out runs/campaign
    """
    from tulip_testbed.cli.laboratory_options import laboratory_and_plan
    from tulip_testbed.cli.terminal import print_json, say, show, show_verdict
    from tulip_testbed.experiments.campaigns.campaign_run import campaign, campaign_settings

    laboratory, made = laboratory_and_plan(robot, preset, plan, rig, effect, seed, not dynamics)
    engine = "dynamics" if dynamics else "statics"
    settings = campaign_settings(seed, engine, experiments, minutes, imperfections)
    found = campaign(laboratory, made, settings, out, lambda what: say(f"{what[0].upper()}{what[1:]}"))
    if as_json:
        print_json({"verdict": found.verdict, "steps": [step.plain() for step in found.steps]})
        return 0
    show_verdict(found.verdict)
    show(*found.parts())
    say(f"Run folder: {out}")
    return 0
