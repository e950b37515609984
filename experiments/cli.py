"""The command line: one function a command; bad input ends in one line and exit code 2."""

from __future__ import annotations

import difflib
import errno
import os
import sys
from collections.abc import Callable

import tyro

from experiments.commands.atlas import atlas_command
from experiments.commands.benchmark import benchmark_command
from experiments.commands.check import check_command
from experiments.commands.compare import compare_command
from experiments.commands.discover import discover_command
from experiments.commands.effects import effects_command
from experiments.commands.identify import identify_command
from experiments.commands.model import model_command
from experiments.commands.montecarlo import montecarlo_command
from experiments.commands.plan import plan_command
from experiments.commands.postures import postures_command
from experiments.commands.report import report_command
from experiments.commands.simulate import simulate_command
from experiments.commands.tolerance import tolerance_command
from experiments.commands.validate import validate_command
from experiments.commands.view import view_command
from experiments.terminal import ERR, printable
from sim.errors import InputError, listed, shortened
from sim.measurements.tables import software

COMMANDS: dict[str, Callable[..., int]] = {
    "validate": validate_command,
    "simulate": simulate_command,
    "montecarlo": montecarlo_command,
    "check": check_command,
    "identify": identify_command,
    "postures": postures_command,
    "plan": plan_command,
    "model": model_command,
    "discover": discover_command,
    "effects": effects_command,
    "atlas": atlas_command,
    "tolerance": tolerance_command,
    "view": view_command,
    "report": report_command,
    "compare": compare_command,
    "benchmark": benchmark_command,
}


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    try:
        _known_command((sys.argv[1:] if arguments is None else arguments)[:1])
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


def _known_command(first: list[str]) -> None:
    if first and not first[0].startswith("-") and first[0] not in COMMANDS:
        close = difflib.get_close_matches(first[0], COMMANDS, n=1)
        meant = f"did you mean '{close[0]}'? " if close else ""
        raise InputError(f"unknown command '{shortened(first[0])}'; {meant}valid: {listed(COMMANDS)}")


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
