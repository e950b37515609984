"""Progress bars, consoles and JSON: stdout is for results, stderr for everything else."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.measure import Measurement
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
from rich.table import Table
from rich.text import Text

from tulip_testbed.sim.measurements.table_files import finite

ERR = Console(stderr=True)
PIPE_WIDTH, MOST_WIDTH = 150, 1000


def printable(text: str) -> str:
    """Text from files and paths with everything escaped that would steer a terminal or cannot be encoded."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class RateColumn(ProgressColumn):
    """Steps a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.3g}/s" if task.speed else "")


@contextmanager
def progress(label: str, total: int, done: int = 0) -> Iterator[Callable[[int], None]]:
    """A bar on stderr with rate and time left; `done` steps were done before."""
    columns = (
        TextColumn(label),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=ERR, transient=True, disable=not ERR.is_terminal) as bar:
        task = bar.add_task(label, total=total, completed=done)
        yield lambda count: bar.advance(task, count)


def console() -> Console:
    """As wide as the terminal; into a pipe or a file as wide as `PIPE_WIDTH`, or as $COLUMNS says."""
    piped = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(width=PIPE_WIDTH if piped else None)


def print_table(screen: Console, table: Table) -> None:
    """A table no wider than the screen, unless figures would have to be cut."""
    unlimited = screen.options.update_width(MOST_WIDTH)
    size = Measurement.get(screen, unlimited, table)
    # Of a table in which nothing wraps, rich's least width is too small by what it pads.
    least = size.maximum if all(column.no_wrap for column in table.columns) else size.minimum
    screen.print(table) if least <= screen.width else Console(width=least).print(table)


def print_json(document: dict[str, Any]) -> None:
    json.dump(finite(document), sys.stdout, indent=1)
    sys.stdout.write("\n")
