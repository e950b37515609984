"""Results of a page or a view: a file, or a window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table

MEGABYTE = 1e6


@dataclass(frozen=True, repr=False)
class WrittenReport(Result):
    """A page that was written.

    Attributes:
        report: its file. bytes: its size. left_out: pictures that could not be drawn, and why.
    """

    report: str
    bytes: int
    left_out: tuple[str, ...]

    def tables(self) -> list[Table | str]:
        """Return what was left out, and the file."""
        missing = [f"Left out: {note}" for note in self.left_out]
        return [*missing, f"Report: {self.report} ({self.bytes / MEGABYTE:.1f} MB)"]


@dataclass(frozen=True, repr=False)
class OpenView(Result):
    """A view that was written, or that is open.

    Attributes:
        view: its file. bytes: its size. closed: waits until the viewer is closed.
    """

    view: str | None = None
    bytes: int | None = None
    closed: Callable[[], None] = lambda: None

    def tables(self) -> list[Table | str]:
        """Return the file; a window says enough itself."""
        if self.view is None or self.bytes is None:
            return []
        return [f"View: {self.view} ({self.bytes / MEGABYTE:.1f} MB); open it by `rerun {self.view}`"]

    def to_json(self) -> dict[str, Any]:
        """Return the file with its size."""
        document = {"view": self.view, "bytes": self.bytes}
        return {key: value for key, value in document.items() if value is not None}

    def wait(self) -> None:
        """Wait until the viewer is closed.

        Raises:
            InputError: it could not draw, or ended by itself.
        """
        self.closed()
