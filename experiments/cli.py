"""The command line: one function a command; bad input ends in one line and exit code 2."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from experiments.check import UNREADABLE, check_folder, print_report
from experiments.description import described_robot
from experiments.run_folder import check_new, write_experiment, write_run
from experiments.scenario import DEFAULT_PLAN, DEFAULT_SEED
from experiments.setting_up import draw_plan, read_scenario, told_apart, tries
from experiments.tables import (
    LEGEND,
    correlation_lines,
    models,
    parameter_table,
    print_experiment,
    print_validation,
    residual_line,
    weak_directions,
)
from experiments.terminal import ERR, console, print_json, printable, progress
from experiments.validate import HIGH_CORRELATION, identify, model_document, report_document, validate
from identification.base_parameters import base_parameters, standard_parameters
from identification.estimators import solve_least_squares
from identification.statistics import high_correlations
from sim.errors import InputError
from sim.laboratory import run_experiment
from sim.measurements import read_measurements, read_plan, write_plan
from sim.measurements.tables import software
from sim.model import TULIP, load_model

Preset = Literal["wii", "force-plate", "ideal"]
Plan = Annotated[
    Path | None,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="PLAN", help="plan folder; the shipped plan if left out"),
]
RobotFile = Annotated[Path, tyro.conf.arg(name="robot", help="robot description (TOML)")]
Json = Annotated[bool, tyro.conf.arg(name="json", help="one JSON document on stdout instead of tables")]
Seed = Annotated[int, tyro.conf.arg(help="seed of everything random")]
Workers = Annotated[int, tyro.conf.arg(help="processes; results do not depend on it")]

CORES = os.cpu_count() or 1


def validate_command(
    plan: Plan = None,
    /,
    *,
    out: Path,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate a plan, identify the robot, compare with the truth and give a verdict.

    Exit code 0: every check passed; 1: a check failed; 2: could not run.
    Example: tulip validate --out runs/first
    """
    check_new(out)
    scenario = read_scenario(plan, preset, seed, robot, workers)
    told_apart(str(plan or DEFAULT_PLAN), scenario.plan, base_parameters(scenario.rig.robot))
    with progress("holding postures", tries(scenario)) as advance:
        result = validate(scenario, workers, advance)
    write_run(out, result)
    document = report_document(result)
    if as_json:
        print_json(document)
    else:
        print_validation(console(), result, document)
    ERR.print(f"Run folder: {out}")
    return 0 if result.verdict == "pass" else 1


def simulate_command(
    plan: Plan = None,
    /,
    *,
    out: Path,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    truth: Path | None = None,
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate the experiment and write a measurement folder, without the truth.

    --truth FILE writes what really happened, elsewhere.
    Example: tulip simulate --out data/first --preset force-plate --truth first-truth.json
    """
    check_new(out)
    if truth is not None:
        check_new(truth)
    if truth is not None and truth.resolve().is_relative_to(out.resolve()):
        raise InputError(f"{truth}: lies inside the measurement folder, which must not hold the truth")
    if truth is not None and out.resolve().is_relative_to(truth.resolve()):
        raise InputError(f"{out}: lies inside {truth}, which is to be a file")
    scenario = read_scenario(plan, preset, seed, robot, workers)
    with progress("holding postures", tries(scenario)) as advance:
        experiment = run_experiment(scenario.rig, scenario.plan, seed, workers, advance)
    write_experiment(out, truth, scenario, experiment)
    if as_json:
        print_json(
            {
                "measurements": str(out),
                "postures_planned": len(scenario.plan),
                "rows": len(experiment.measurements),
                "dropped": [{"posture": p, "reason": r} for p, r in experiment.dropped],
            }
        )
    else:
        print_experiment(console(), experiment, len(scenario.plan), {})
    ERR.print(f"Measurement folder: {out}")
    return 0


def identify_command(
    folder: Annotated[Path, tyro.conf.Positional], /, *, robot: RobotFile = TULIP, as_json: Json = False
) -> int:
    """Identify the robot from a measurement folder: base parameters and what they are worth.

    Example: tulip identify data/first
    """
    described = described_robot(robot)
    measurements = read_measurements(folder)
    found = identify(measurements, described, str(folder))
    document: dict[str, Any] = {
        "postures": len(measurements),
        "placements": len(np.unique(measurements.placement)),
        "condition_number": found.full.condition_number,
        "total_mass": {"estimate": found.mass[0], "standard_error": found.mass[1]},
    }
    estimates = {"full": found.full, "simplified": found.simplified}
    fitted = {
        model: model_document(estimate, None) | {"hardly_known": weak_directions(estimate, found.parameters)}
        for model, estimate in estimates.items()
    }
    document |= fitted
    if as_json:
        print_json(document)
        return 0
    screen = console()
    for model in models(described):
        title = f"{model.capitalize()} model, mm"
        screen.print(parameter_table(title, fitted[model], found.parameters, described, model))
        screen.print(residual_line(fitted[model]))
        pairs = fitted[model]["correlations"]
        screen.print("Correlations above 0.85 in size (eq. 15):" if pairs else "No correlation above 0.85.")
        for line in correlation_lines(pairs, found.parameters, measurements.joint_angles):
            screen.print(f"  {line}", markup=False)
        if fitted[model]["hardly_known"]:
            screen.print(f"Hardly known: {fitted[model]['hardly_known']}", markup=False)
    screen.print(LEGEND)
    screen.print(f"Total mass {found.mass[0]:.3f} +- {found.mass[1]:.3f} kg")
    return 0


def check_command(
    folder: Annotated[Path, tyro.conf.Positional], /, *, robot: RobotFile = TULIP, as_json: Json = False
) -> int:
    """Check a measurement folder before anybody trusts it: weights, drift, plates, legs, units and more.

    Exit code 0: passed, perhaps with warnings; 1: a check failed; 2: could not read. What an
    incomplete folder lacks is listed, with an example to copy.
    Example: tulip check data/first
    """
    document = check_folder(folder, described_robot(robot))
    if as_json:
        print_json(document)
    else:
        print_report(console(), document)
    return {UNREADABLE: 2, "fail": 1}.get(document["verdict"], 0)


def postures_command(
    plan: Plan = None,
    /,
    *,
    random: bool = False,
    out: Path | None = None,
    placements: int = 10,
    per_placement: int = 5,
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Draw random feasible postures (--random --out PLAN), or describe a plan.

    Example: tulip postures --random --placements 10 --per-placement 5 --seed 7 --out plans/seven
    """
    described = described_robot(robot)
    parameters = base_parameters(described)
    source = str(out or plan or DEFAULT_PLAN)
    if random:
        made = draw_plan(described, parameters, placements, per_placement, seed, plan, out)
    else:
        if out is not None:
            raise InputError("--out: found without --random, expected both or neither")
        made = read_plan(plan or DEFAULT_PLAN, described, load_model(described))
    matrix = told_apart(source, made, parameters)
    if random and out is not None:
        write_plan(out, made)
    _, c = solve_least_squares(matrix, np.zeros(len(matrix)))
    pairs = high_correlations(c, np.arange(1, len(c) + 1), HIGH_CORRELATION)
    document = {
        "plan": source,
        "postures": len(made),
        "placements": len(np.unique(made.placement)),
        "condition_number": float(np.linalg.cond(matrix)),
        "correlations": [{"a": a, "b": b, "rho": rho} for a, b, rho in pairs],
        "made": made.made,
    }
    if as_json:
        print_json(document)
        return 0
    screen = console()
    screen.print(
        f"{document['postures']} postures on {document['placements']} placements, "
        f"condition number {document['condition_number']:.0f}"
    )
    screen.print("Correlations above 0.85 in size (eq. 15):")
    for line in correlation_lines(document["correlations"], parameters, made.joint_angles):
        screen.print(f"  {line}", markup=False)
    return 0


def model_command(
    *,
    support: Literal["double", "right", "left"] = "double",
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Show a model's standard parameters and how they group into base parameters.

    Example: tulip model --support double
    """
    described = described_robot(robot)
    model = load_model(described)
    parameters = base_parameters(described, model, support)
    standard = standard_parameters(model)
    values = parameters.values(standard)
    counts = {
        "standard": standard.size,
        "columns": 3 * len(parameters.tree.frames),
        "joined": parameters.joined,
        "base": len(parameters.names),
    }
    document = {
        "model": described.model.name,
        "support": support,
        "total_mass": float(standard[:, 0].sum()),
        "counts": counts,
        "standard": [
            {"link": link, "mass": m, "mcx": x, "mcy": y, "mcz": z}
            for link, (m, x, y, z) in zip(parameters.tree.links, standard.tolist(), strict=True)
        ],
        "base": [
            {
                "number": k,
                "name": name,
                "value": float(value),
                "columns": group,
                "standard": parameters.grouping(k - 1),
            }
            for k, (name, value, group) in enumerate(
                zip(parameters.names, values, parameters.groups, strict=True), 1
            )
        ],
    }
    if as_json:
        print_json(document)
        return 0
    screen = console()
    screen.print(
        f"{described.model.name}: {counts['standard']} standard parameters -> {counts['columns']} columns -> "
        f"{counts['joined']} -> {counts['base']} base parameters in {support} support"
    )
    screen.print("Standard parameters m, m c_x, m c_y, m c_z (kg, kg m):")
    for row in document["standard"]:
        screen.print(
            f"  {row['link']:18s} {row['mass']:8.3f} {row['mcx']:9.4f} {row['mcy']:9.4f} {row['mcz']:9.4f}",
            highlight=False,
        )
    screen.print(f"Base parameters in mm; M = {document['total_mass']:.3f} kg:")
    for row in document["base"]:
        screen.print(
            f"  {row['number']:2d} {row['name']:20s} {1e3 * row['value']:9.2f}  times M: {row['standard']}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    return 0


COMMANDS: dict[str, Callable[..., int]] = {
    "validate": validate_command,
    "simulate": simulate_command,
    "check": check_command,
    "identify": identify_command,
    "postures": postures_command,
    "model": model_command,
}


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="tulip",
            description="A virtual laboratory for the static identification of humanoid robots.",
            args=arguments,
        )
    except InputError as error:
        ERR.print("tulip:", style="bold red", end=" ")
        ERR.print(printable(str(error)), highlight=False, soft_wrap=True, markup=False)
        return 2
    except KeyboardInterrupt:
        ERR.print("tulip: interrupted; nothing was written")
        return 130


def run() -> None:
    """The console script."""
    if sys.argv[1:] == ["--version"]:
        print(f"tulip {software()['tulip-testbed']}")
        sys.exit(0)
    try:
        code = main()
        sys.stdout.flush()
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC, errno.EIO):
            raise
        if error.errno != errno.EPIPE:  # who closes a pipe early knows it
            ERR.print(f"tulip: cannot write the results ({error.strerror})")
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer
        code = 2
    sys.exit(code)
