"""`tulip tolerance`."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from tulip_testbed.cli.options import Json, Plan, Preset, RobotFile, Seed
from tulip_testbed.experiments.atlas.planned_experiment import planned
from tulip_testbed.experiments.atlas.tolerance import (
    ALLOWED,
    CHECKED,
    UNITS,
    Tolerance,
    document,
    sources,
    tolerance,
)
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import DEFAULT_SEED
from tulip_testbed.experiments.terminal import ERR, console, print_json, print_table, progress
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for
from tulip_testbed.sim.errors import at_least
from tulip_testbed.sim.robot import TULIP

LARGE = 1000.0  # units: more than anybody would call a tolerance


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
    with ERR.status("solving the plan"):
        solved_plan = planned(made, preset, described, seed)
    with progress("simulating errors", len(sources(solved_plan))) as advance:
        found = tolerance(solved_plan, advance)
    if as_json:
        print_json({"preset": preset, "seed": seed, **document(found)})
    else:
        print_tolerance(console(), found)
    return 0


def print_tolerance(screen: Console, found: Tolerance) -> None:
    """Every bias, then what must be kept."""
    screen.print(
        f"{len(found.planned.observed)} of {len(found.planned.plan)} postures can be measured. Parameters by "
        "number (`tulip model` names them)."
    )
    print_table(screen, _biases(found))
    print_table(screen, _tolerances(found))
    difference = np.abs(found.simulated - found.bias)
    k, j = np.unravel_index(int(difference.argmax()), difference.shape)
    screen.print(
        f"Checked by simulation ({CHECKED} runs with and without each error): the largest difference "
        f"from the prediction is {difference[k, j]:.2f} s.e. ({found.sources[k].label}, parameter {j + 1}), "
        f"beside a largest bias of {np.abs(found.bias).max():.2f}."
    )


def _biases(found: Tolerance) -> Table:
    table = Table(
        title="Bias in standard errors of the default estimator, of one unit",
        title_justify="left",
        header_style="bold",
        padding=(0, 1, 0, 0),
        pad_edge=False,
        box=None,
    )
    table.add_column("error", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for number in range(1, found.bias.shape[1] + 1):
        table.add_column(str(number), justify="right", no_wrap=True, min_width=4)
    for source, bias in zip(found.sources, found.bias, strict=True):
        table.add_row(source.label, source.words, *(_short(value) for value in bias))
    return table


def _tolerances(found: Tolerance) -> Table:
    table = Table(
        title=f"What keeps the bias of every parameter below {ALLOWED} standard errors",
        title_justify="left",
        header_style="bold",
    )
    for header in (
        "error",
        "worst bias of one unit",
        "simulated",
        "this one alone",
        "s.d. if all of a kind err",
    ):
        table.add_column(header, justify="left" if header == "error" else "right", no_wrap=True)
    told = set()
    for k, source in enumerate(found.sources):
        worst = int(np.abs(found.bias[k]).argmax())
        name = source.candidate.effect.name
        together = "" if name in told else _amount(found.together(name), name)
        told.add(name)
        table.add_row(
            source.label,
            f"{found.bias[k, worst]:+.3f} ({worst + 1})",
            f"{found.simulated[k, worst]:+.3f}",
            _amount(found.allowed(k), name),
            together,
        )
    return table


def _amount(units: float, effect: str) -> str:
    if units > LARGE:
        return "any"
    one, unit = UNITS[effect][1].split(" ")
    return f"{units * float(one):.2g} {unit}"


def _short(value: float) -> str:
    """Two decimals without the leading zero; nothing where it is nothing."""
    if abs(value) < 0.005:
        return "."
    return f"{value:.2f}".replace("0.", ".", 1) if abs(value) < 0.995 else f"{value:.1f}"
