"""The command line: one function a command; bad input ends in one line and exit code 2."""

from __future__ import annotations

import difflib
import errno
import io
import os
import sys
from collections.abc import Callable
from inspect import signature

import tyro

from tulip_testbed.cli.atlas_command import atlas_command
from tulip_testbed.cli.benchmark_command import benchmark_command
from tulip_testbed.cli.check_command import check_command
from tulip_testbed.cli.compare_command import compare_command
from tulip_testbed.cli.discover_command import discover_command
from tulip_testbed.cli.effects_command import effects_command
from tulip_testbed.cli.identify_command import identify_command
from tulip_testbed.cli.model_command import model_command
from tulip_testbed.cli.montecarlo_command import montecarlo_command
from tulip_testbed.cli.plan_command import plan_command
from tulip_testbed.cli.postures_command import postures_command
from tulip_testbed.cli.report_command import report_command
from tulip_testbed.cli.simulate_command import simulate_command
from tulip_testbed.cli.terminal import refuse, say
from tulip_testbed.cli.tolerance_command import tolerance_command
from tulip_testbed.cli.validate_command import validate_command
from tulip_testbed.cli.view_command import view_command
from tulip_testbed.sim.errors import InputError, listed, shortened
from tulip_testbed.sim.measurements.table_files import software

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
    given = sys.argv[1:] if arguments is None else arguments
    try:
        _known_command(given[:1])
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="tulip",
            description="A virtual laboratory for the static identification of humanoid robots.",
            args=arguments,
        )
    except InputError as error:
        refuse(_with_flags(str(error), given[0]))
        return 2
    except KeyboardInterrupt:
        say("tulip: interrupted; nothing was written")
        return 130


def _with_flags(message: str, command: str) -> str:
    """Write the parameters that a library's message begins with as the flags that they are here."""
    names = signature(COMMANDS[command]).parameters if command in COMMANDS else {}
    place, colon, rest = message.partition(": ")
    words = place.split(", ")
    if not colon or any(word.split(" ")[0] not in names for word in words):
        return message
    return ", ".join(f"--{w.replace('_', '-')}" for w in words) + colon + rest


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
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what cannot be encoded shows as its code
            stream.reconfigure(errors="backslashreplace")
    try:
        code = main()
        sys.stdout.flush()
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC, errno.EIO):
            raise
        if error.errno != errno.EPIPE:  # who closes a pipe early knows it
            say(f"tulip: cannot write the results ({error.strerror})")
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer
        code = 2
    sys.exit(code)
