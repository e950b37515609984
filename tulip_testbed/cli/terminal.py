"""Output of the commands: results go to stdout, everything else to stderr."""

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from tulip_testbed.base.column import printable
from tulip_testbed.base.progress import Advance
from tulip_testbed.base.table import STYLES, Table, Verbatim
from tulip_testbed.base.table_files import finite

ERR = Console(stderr=True)
PIPE_WIDTH = 150
QUIET = 60.0  # s between two lines about work that goes on
VERDICT = "Verdict: "  # what the line begins with whose rest has the colour of the verdict


def show(*parts: Table | str) -> None:
    """Print tables and sentences on stdout, as wide as the terminal.

    A pipe or a file gets whole tables and lines of `PIPE_WIDTH`, or as many characters as $COLUMNS says.
    """
    before: Table | str = ""
    for part in parts:
        if isinstance(part, str):
            text = Text(printable(part))
            if part.startswith(VERDICT):
                verdict = part.removeprefix(VERDICT).split(" (")[0]
                name = next(filter(verdict.startswith, STYLES), verdict)
                text.stylize(STYLES.get(name, "bold"), len(VERDICT), len(VERDICT) + len(name))
            _console().print(text, soft_wrap=isinstance(part, Verbatim))
        else:
            gap = [""] if isinstance(before, str) and before else []
            _console(part.whole_width).print(*gap, part, "", sep="\n", crop=False)
        before = part


def show_whole(lines: Iterable[str]) -> None:
    """Print lines that a person may copy: whole, at any width."""
    screen = _console()
    for line in lines:
        screen.print(Text(printable(line)), soft_wrap=True)


def say(text: str) -> None:
    """Print a line on stderr."""
    ERR.print(Text(printable(text)), soft_wrap=True)


def refuse(message: str) -> None:
    """Print what is wrong with the input on stderr."""
    ERR.print(Text.assemble(("tulip: ", "bold red"), printable(message)), soft_wrap=True)


def print_json(document: dict[str, Any], indent: int | None = 1) -> None:
    """Print one JSON document on stdout, at once; without `indent` on one line."""
    try:
        json.dump(finite(document), sys.stdout, indent=indent)
        sys.stdout.write("\n")
        sys.stdout.flush()
    except BrokenPipeError:
        fall_silent()


def fall_silent() -> None:
    """Write nothing more on stdout, whose reader has gone: the command itself goes on and has its own end."""
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, sys.stdout.fileno())
    os.close(devnull)


class _Screen(Console):
    """Stdout, which may be a pipe whose reader has seen enough."""

    def on_broken_pipe(self) -> None:
        fall_silent()


class RateColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.3g}/s" if task.speed else "")


@contextmanager
def progress(label: str, total: int | None, done: int = 0) -> Iterator[Advance]:
    """Show a bar with rate, time left and the best value so far on stderr; no terminal gets a line a minute.

    The total is None if nobody knows it. Some steps may be done before; the yielded function is called with
    the number of those done now.
    """
    if not ERR.is_terminal:
        ended, count = Event(), [done]

        def tell() -> None:
            while not ended.wait(QUIET):
                say(f"{label}: " + (f"{sum(count)} of {total}" if total else f"step {sum(count)}"))

        Thread(target=tell, daemon=True).start()
        try:
            yield lambda more, /, value=None: count.append(more)
        finally:
            ended.set()
        return
    value_column = TextColumn("{task.fields[value]}")
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), RateColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), value_column, console=ERR, transient=True) as bar:
        task = bar.add_task(label, total=total, completed=done, value="")

        def advance(count: int, /, value: float | None = None) -> None:
            bar.update(task, advance=count, value="" if value is None else f"{value:.4g}")

        yield advance


def _console(least: int = 0) -> Console:
    """Return stdout as rich sees it, a pipe or a file at least so wide."""
    piped = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return _Screen(width=max(PIPE_WIDTH, least) if piped else None)
