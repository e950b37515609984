"""The command line: one function per command; bad input ends in one line and exit code 2.

A message names a parameter of the library's function, such as `robot_spread`: its option is --robot-spread,
which may also be written --robot_spread. The simulator is loaded only when a command runs: help is quick.
"""

import errno
import functools
import io
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import Any

from tulip_testbed.base.errors import InputError, InputWarning, choices, listed, shortened
from tulip_testbed.cli.commands import COMMANDS

Command = Callable[..., int]


def main(arguments: list[str] | None = None, loaded: Callable[[], object] = lambda: None) -> int:
    """Carry out a command, by the process's arguments if None, and return the exit code.

    When the libraries are loaded and the work begins, `loaded` is called.
    """
    given = sys.argv[1:] if arguments is None else arguments
    name, rest = split_name(given)
    if given and given[-1] in ("-h", "--help") and name in (given[-1], *groups()):
        print(usage(None if name == given[-1] else name))
        return 0
    try:
        return _carry_out(str(name), command_of(name), rest, loaded)
    except InputError as error:
        from tulip_testbed.cli.terminal import refuse

        refuse(str(error))
        return error.exit_code
    except OSError as error:
        if error.filename is None or not (error.strerror or ""):  # of stdout, see `run`
            raise
        from tulip_testbed.cli.terminal import refuse

        refuse(f"{error.filename}: cannot be used ({error.strerror})")
        return 2
    except KeyboardInterrupt as stopped:
        from tulip_testbed.cli.terminal import say

        say(f"tulip: {str(stopped) or 'interrupted; no unfinished result was left'}")
        return 130


def split_name(given: list[str]) -> tuple[str | None, list[str]]:
    """Split the name of a command, which may have two words, from its arguments."""
    words = 2 if " ".join(given[:2]) in COMMANDS else 1
    return (given[0] if words == 1 else " ".join(given[:2])) if given else None, given[words:]


def groups() -> set[str]:
    """Return the first words of names that are no command alone."""
    return {name.partition(" ")[0] for name in COMMANDS} - COMMANDS.keys()


def usage(group: str | None = None) -> str:
    """Describe every command, or those of a group, with its summary."""
    described = {name: c.summary for name, c in COMMANDS.items() if group in (None, name.split(" ")[0])}
    blocks = [{n: s for n, s in described.items() if (" " in n) is two} for two in (False, True)]
    lines = [
        f"  {name:{max(map(len, block))}}  {summary}" for block in blocks for name, summary in block.items()
    ]
    return "\n".join(
        [
            f"usage: tulip {group or 'COMMAND'} {'COMMAND ' if group else ''}[OPTIONS]",
            "",
            "A virtual laboratory for the static identification of humanoid robots.",
            "",
            "Commands:",
            *lines,
            "",
            "`tulip COMMAND --help` explains a command, `tulip --version` prints the version.",
        ]
    )


def command_of(name: str | None) -> Command:
    names = list(COMMANDS)
    if name is None:
        raise InputError(f"found no command; valid: {listed(names)}; `tulip --help` explains them")
    if name not in names:
        if name.startswith("-"):
            raise InputError(
                f"unknown option '{shortened(name)}'; valid: --help, --version, or a command first"
            )
        if name in groups():
            names = [full for full in names if full.startswith(f"{name} ")]
            raise InputError(f"{name}: found no command that it names; valid: {listed(names)}")
        raise InputError(f"unknown command '{shortened(name)}'; {choices(name, names)}")
    return COMMANDS[name].load()


def _carry_out(name: str, command: Command, arguments: list[str], loaded: Callable[[], object]) -> int:
    """Parse a command's arguments, load the libraries and call it with one thread for linear algebra."""
    positional, options = read_arguments(name, command, arguments)
    import tulip_testbed.api  # noqa: F401  all at once, while an interruption still ends quietly
    from tulip_testbed.base.files import check_path
    from tulip_testbed.base.threads import one_blas_thread

    for path in _paths([*positional, *options.values()]):
        check_path(path)
    loaded()
    with _warnings_in_our_words():
        return one_blas_thread(command)(*positional, **options)


def read_arguments(
    name: str, command: Command, arguments: list[str]
) -> tuple[tuple[object, ...], dict[str, object]]:
    """Parse the arguments of a command, without its name, into what its function is called with.

    Raises:
        SystemExit: the arguments are wrong, or ask for help.
    """
    import tyro

    @functools.wraps(command)
    def given(*positional: object, **options: object) -> tuple[tuple[object, ...], dict[str, object]]:
        return positional, options

    with _refusals_printable(arguments):
        found: Any = tyro.cli(given, prog=f"tulip {name}", args=arguments)
    return found


@contextmanager
def _refusals_printable(arguments: list[str]) -> Iterator[None]:
    """Escape what would steer a terminal where the parser repeats arguments."""
    if all(map(str.isprintable, arguments)):
        yield
        return
    from tulip_testbed.base.column import printable

    said = io.StringIO()
    try:
        with redirect_stderr(said):
            yield
    finally:
        for line in said.getvalue().splitlines():
            print(printable(line), file=sys.stderr)


def _paths(values: Iterable[object]) -> Iterator[Path]:
    for value in values:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, tuple | list):
            yield from _paths(value)


@contextmanager
def _warnings_in_our_words() -> Iterator[None]:
    """Print the library's warnings as lines of the command's."""
    from tulip_testbed.cli.terminal import say

    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                say(f"tulip: warning: {message}")
            else:
                others(message, category, *where, **more)

        warnings.showwarning = show
        warnings.simplefilter("always", InputWarning)
        yield


def run(loaded: Callable[[], object]) -> None:
    """Run the console script; see `main` for `loaded`."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what cannot be encoded shows as its code
            stream.reconfigure(errors="backslashreplace")
    # Locks and what is begun are removed, as by Ctrl-C.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    code = 128 + signal.SIGPIPE
    try:
        code = main(loaded=loaded)
        sys.stdout.flush()
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC, errno.EIO):
            raise
        from tulip_testbed.cli.terminal import fall_silent, say

        if error.errno != errno.EPIPE:  # who closes a pipe early has seen enough
            say(f"tulip: cannot write the results ({error.strerror})")
            code = 2
        fall_silent()  # with what is left in the buffer
    sys.exit(code)
