"""Rows of a motion while its samples arrive in a CSV file that grows.

A row comes with the first sample at or after the end of its window. It depends on the samples in the window
alone, and not on how many arrive at a time.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import opened, present
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.experiments.watching.arriving_rows import (
    MOST_AT_ONCE,
    MOST_LINE,
    is_header,
    is_row,
    text_of,
)
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import OF_ROWS
from tulip_testbed.measurements.logs.series_reduction import reduced_window
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import mapped_samples, samples_from
from tulip_testbed.measurements.motion_table import MOST_SAMPLES

TABLE = "motion.csv"


class Arrived(NamedTuple):
    """A row or a problem, with its line's number and the SHA-256 of the file as far as this line."""

    line: int
    read: str
    row: Measurements | None
    problem: str = ""


@dataclass
class ArrivingSamples:
    """Samples of a file that grows, and the rows that they give.

    Attributes:
        path: of the file. manifest, where: the manifest and its path. weight: of the robot [N].
        window: length of a row [s].
        known: number of lines that were read by a watch that was killed, and their SHA-256.
    """

    path: Path
    manifest: Manifest
    where: Path
    weight: float
    window: float
    known: tuple[int, str] = (0, "")
    _read: Any = field(default_factory=sha256)
    _bytes: int = 0
    _lines: int = 0
    _header: bytes = b""
    _rows: int = 0
    _segments: list[int] = field(default_factory=list)
    _kept: list[Measurements] = field(default_factory=list)  # samples since the next window's start
    _start: float = 0.0  # of the segment's first window
    _next: int = 0  # window of the segment

    def new(self) -> Iterator[Arrived]:
        """Yield what came since the last look; a half-written last line waits for its end."""
        while lines := self._new_lines():
            samples, reads = [], {}
            for line in lines:
                self._lines += 1
                self._bytes += len(line)
                self._read.update(line)
                if self._lines == self.known[0] and self._read.hexdigest() != self.known[1]:
                    raise InputError(
                        f"{self.path}: found other values in the first {self._lines} lines than were read "
                        "before"
                    )
                if not is_row(line):
                    continue
                if is_header(self.path, self._lines, line, self._header):
                    self._header = self._header or text_of(line)
                    continue
                samples.append((self._lines, line))
                reads[self._lines] = self._read.copy()
            for number, row, problem in self._taken(samples):
                yield Arrived(number, reads[number].hexdigest(), row, problem)
        if self._lines < self.known[0]:
            raise InputError(f"{self.path}: found fewer lines than the {self.known[0]} that were read before")

    def _new_lines(self) -> list[bytes]:
        if not present(self.path) and not self._bytes:
            return []
        with opened(self.path) as file:
            size = file.seek(0, 2)
            file.seek(self._bytes)
            lines = file.read(MOST_AT_ONCE).splitlines(keepends=True)
        if size < self._bytes:
            raise InputError(f"{self.path}: found fewer lines than the {self._lines} that were read before")
        if lines and len(lines[-1]) > MOST_LINE:
            raise InputError(f"{self.path}: found a line of more than {MOST_LINE} bytes")
        return lines if lines and lines[-1].endswith(b"\n") else lines[:-1]

    def _taken(self, lines: list[tuple[int, bytes]]) -> Iterator[tuple[int, Measurements | None, str]]:
        """Yield rows and problems of some lines, by the number of the line with which they came."""
        for numbers, samples, problem in self._parsed(lines):
            if samples is None:
                yield numbers[0], None, problem
                continue
            for k, number in enumerate(numbers):
                one = samples.take(np.array([k]))
                if problem := self._misplaced(one):
                    yield number, None, f"{self.path}: line {number}: {problem}"
                    continue
                for row, problem in self._with_sample(one, number):
                    yield number, row, problem

    def _parsed(self, lines: list[tuple[int, bytes]]) -> Iterator[tuple[list[int], Measurements | None, str]]:
        """Yield samples of lines that can be read together, and of each that cannot be read what is wrong."""
        if not lines:
            return
        numbers = [number for number, _ in lines]
        content = b"\n".join([self._header, *(text_of(line) for _, line in lines), b""])
        try:
            table = TableFile(self.path, content, MOST_SAMPLES)
            mapped = mapped_samples(self.manifest, table, self.where)
            yield numbers, samples_from(self.manifest, mapped, self.where), ""
        except InputError as error:
            if len(lines) == 1:
                told = (
                    str(error).removeprefix(f"{self.path}: ").removeprefix("line 2: ").replace(", row 1", "")
                )
                yield numbers, None, f"{self.path}: line {numbers[0]}: {shortened(told, 400)}"
                return
            for half in (lines[: len(lines) // 2], lines[len(lines) // 2 :]):
                yield from self._parsed(half)

    def _misplaced(self, one: Measurements) -> str:
        """Say why a sample cannot follow those before it; "": it can."""
        segment, last = int(one.posture[0]), self._kept[-1] if self._kept else None
        if not self._segments or segment != self._segments[-1]:
            if segment in self._segments:
                return f"found segment {segment} again, expected the rows of a segment one after the other"
            return ""
        assert last is not None
        if one.time[0] <= last.time[0]:
            return f"found time {one.time[0]:g} after {last.time[0]:g}, expected a time that increases"
        for name in ("placement", "support"):
            if getattr(one, name)[0] != getattr(last, name)[0]:
                return f"found another {name}, expected one {name} in a segment"
        return ""

    def _with_sample(self, one: Measurements, line: int) -> Iterator[tuple[Measurements | None, str]]:
        """Take a sample in, and yield the row or the problem of a window that ends before it."""
        segment, time = int(one.posture[0]), float(one.time[0])
        if not self._segments or segment != self._segments[-1]:
            self._segments.append(segment)
            self._kept, self._start, self._next = [], time, 0
        start = self._start + self.window * self._next
        self._kept.append(one)
        if time < start + self.window - 1e-9:
            return
        found = reduced_window(joined(self._kept), self.weight, start, self.window)
        if len(found.measurements):
            self._rows += 1
            yield replace(found.measurements, posture=np.array([self._rows])), ""
        else:
            (cause,) = found.dropped
            yield None, f"{self.path}: line {line}: found no row from {start:.2f} s on, of a window {cause}"
        # Windows without a sample give nothing.
        self._next = max(self._next + 1, int((time - self._start) / self.window + 1e-9))
        self._kept = [one]


def joined(samples: list[Measurements]) -> Measurements:
    arrays = {
        name: np.concatenate([getattr(one, name) for one in samples])
        for name, values in vars(samples[0]).items()
        if name in OF_ROWS and values is not None
    }
    return replace(samples[0], **arrays)  # pyrefly: ignore[bad-argument-type]
