"""Rows of a measurement folder's table, or of a motion's samples, while they arrive in a file that grows.

A watch keeps how much of the file it has read, and the hash of that: nothing before its end may change.

A row of a motion comes with the first sample at or after the end of its window. It depends on the samples in
the window alone, and not on how many arrive at a time.
"""

import io
import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, check_outside, opened, present, read_bytes, write_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import stacked
from tulip_testbed.measurements.logs.series_reduction import reduced_window
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import (
    mapped_samples,
    measurements_in,
    moves,
    samples_from,
)
from tulip_testbed.measurements.motion_table import MOST_SAMPLES, check_segments
from tulip_testbed.measurements.trajectory import runs

TABLE, SAMPLES = "postures.csv", "motion.csv"
FORMAT = "tulip-watch-8"
MOST_LINE = 2**20  # bytes
MOST_AT_ONCE = 2**22  # bytes that are read of a file at a time


class Seen(NamedTuple):
    """How much of a file was read: its bytes and lines, and their SHA-256."""

    size: int = 0
    lines: int = 0
    sha256: str = sha256().hexdigest()


NOTHING = Seen()


class Line(NamedTuple):
    """A line that holds values: its number and text, what was read with it, and whether it came since."""

    number: int
    text: bytes
    seen: Seen
    new: bool


class Arrived(NamedTuple):
    """A row, or the problem why there is none, with the line that completed it."""

    line: Line
    row: Measurements | None
    problem: str = ""


@dataclass(kw_only=True)
class ArrivingRows:
    """Rows of held postures, one a line of a file that grows.

    Attributes:
        path: of the file. manifest, where: the manifest and its path.
        kept: what a watch that was killed has read; its rows come again first.
        once: whether a last line that has all values but no end is read too.
    """

    held: ClassVar[bool] = True
    path: Path
    manifest: Manifest
    where: Path
    kept: Seen = NOTHING
    once: bool = False
    _hash: Any = field(default_factory=sha256)
    _seen: Seen = NOTHING
    _open: bool = False  # the last line had no end
    _header: bytes = b""

    def new(self) -> Iterator[Arrived]:
        """Yield what came since the last look; a half-written last line waits for its end.

        A row that is prepared, most of its readings still empty, waits for them, and so do those after it.
        """
        while lines := self._new_lines():
            yield from self._taken(self._rows(lines))

    def _new_lines(self) -> list[bytes]:
        """Return the complete lines since the last look; those before are compared with their hash."""
        first = not self._seen.size
        seen = self.kept if first else self._seen
        if not present(self.path):
            if seen.size:
                raise InputError(
                    f"{self.path}: found no file any more, expected the one that was read so far"
                )
            if self.held and moves(self.path.parent):
                raise _in_motion(f"{self.path.parent}: found samples of a motion")
            return []
        with opened(self.path) as file:
            changed = file.seek(0, 2) < seen.size
            if self.held or first:  # a motion is long
                file.seek(0)
                before = file.read(seen.size)
                goes_on = before[-1:] not in (b"", b"\n") and file.read(1) not in (b"", b"\r", b"\n")
                changed = goes_on or sha256(before).hexdigest() != seen.sha256
            if changed:
                raise InputError(
                    f"{self.path}: found other values in the first {seen.lines} lines than were read before, "
                    "or fewer; rows may only be added at the end"
                )
            file.seek(self._seen.size)
            content = file.read(MOST_AT_ONCE)
        lines = list(io.BytesIO(content))
        if any(len(line) > MOST_LINE or b"\r" in text_of(line) for line in lines):
            raise InputError(
                f"{self.path}: found a line of more than {MOST_LINE} bytes or with a carriage return (CR) "
                "within, expected lines that end with LF or CR LF"
            )
        if lines and not lines[-1].endswith(b"\n"):
            whole = len(_names(lines[-1])) == len(_names(self._header)) > 1 and len(content) < MOST_AT_ONCE
            lines = lines if self.once and whole else lines[:-1]
        return list(itertools.takewhile(lambda line: not (self.held and _is_prepared(line)), lines))

    def _rows(self, lines: list[bytes]) -> Iterator[Line]:
        """Yield the lines that are rows below the header, which may come again."""
        for line in lines:
            new, text, names = self._seen.size >= self.kept.size, text_of(line), _names(line)
            self._hash.update(line)
            size, number = self._seen.size + len(line), self._seen.lines + (not self._open)
            self._seen, self._open = Seen(size, number, self._hash.hexdigest()), not line.endswith(b"\n")
            where = f"{self.path}: line {number}"
            if not _is_row(line):
                continue
            if not self._header:
                if any(name.startswith("q_rate.") for name in names):
                    raise _in_motion(f"{where}: found rows of a motion")
                self._header = text
            elif names != _names(self._header):
                if "posture" in names:
                    raise InputError(f"{where}: found another header, expected that of the first row")
                yield Line(number, text, self._seen, new)

    def _taken(self, lines: Iterable[Line]) -> Iterator[Arrived]:
        """Yield rows and problems of some lines."""
        for line in lines:
            try:
                yield Arrived(line, measurements_in(self.manifest, self._table([line]), self.where))
            except InputError as error:
                yield Arrived(line, None, self._problem(line, error))

    def _table(self, lines: list[Line]) -> TableFile:
        content = b"\n".join([self._header, *(line.text for line in lines), b""])
        return TableFile(self.path, content, MOST_SAMPLES)

    def _problem(self, line: Line, error: InputError) -> str:
        """Return what is wrong with a line that was read by itself."""
        place = str(error).removeprefix(f"{self.path}: ").removeprefix("line 2: ")
        return (
            f"{self.path}: line {line.number}: {shortened(re.sub(', row [0-9]+', '', place, count=1), 400)}"
        )


@dataclass(kw_only=True)
class ArrivingSamples(ArrivingRows):
    """Samples of a file that grows, and the rows that they give.

    Attributes:
        weight: of the robot [N]. window: length of a row [s].
    """

    held: ClassVar[bool] = False
    weight: float
    window: float
    _count: int = 0  # of rows
    _ends: Measurements | None = None  # last sample of every segment so far
    _waiting: Measurements | None = None  # samples since the next window's start
    _start: float = 0.0  # of the segment's first window
    _next: int = 0  # window of the segment

    def _taken(self, lines: Iterable[Line], samples: Measurements | None = None) -> Iterator[Arrived]:
        """Yield rows and problems of some lines, which hold these samples; None: they are to be read.

        Lines that cannot be read together, or that cannot follow those before them, are halved.
        """
        lines = list(lines)
        if not lines:
            return
        every = np.arange(len(lines))
        try:
            if samples is None:
                mapped = mapped_samples(self.manifest, self._table(lines), self.where)
                samples = samples_from(self.manifest, mapped, self.where)
            known = samples if self._ends is None else stacked([self._ends, samples])
            check_segments(self.path, known.time, known.posture, known.placement, known.support)
        except InputError as error:
            if len(lines) == 1:
                yield Arrived(lines[0], None, self._problem(lines[0], error))
                return
            for half in (slice(len(lines) // 2), slice(len(lines) // 2, None)):
                yield from self._taken(lines[half], samples and samples.take(every[half]))
            return
        self._ends = known.take(np.array([rows.stop - 1 for rows in runs(known.posture)]))
        for rows in runs(samples.posture):
            yield from self._windows(samples.take(every[rows]), lines[rows])

    def _windows(self, samples: Measurements, lines: list[Line]) -> Iterator[Arrived]:
        """Yield the row of every window of a segment that ends before one of these samples, or a problem."""
        before, whole, begin = self._waiting, samples, 0
        if before is not None and before.posture[0] == samples.posture[0]:
            whole = stacked([before, samples])
        else:
            self._start, self._next = float(samples.time[0]), 0
        for k, line in enumerate(lines, len(whole) - len(samples)):
            time, start = float(whole.time[k]), self._start + self.window * self._next
            if time < start + self.window - 1e-9:
                continue
            found = reduced_window(whole.take(np.arange(begin, k + 1)), self.weight, start, self.window)
            if len(found.measurements):
                self._count += 1
                yield Arrived(line, replace(found.measurements, posture=np.array([self._count])))
            else:
                (cause,) = found.dropped
                problem = f"found no row from {start:.2f} s on, of a window {cause}"
                yield Arrived(line, None, f"{self.path}: line {line.number}: {problem}")
            # Windows without a sample give nothing.
            self._next, begin = max(self._next + 1, int((time - self._start) / self.window + 1e-9)), k
        self._waiting = whole.take(np.arange(begin, len(whole)))


def text_of(line: bytes) -> bytes:
    return line.rstrip(b"\n").rstrip(b"\r")


def _is_row(line: bytes) -> bool:
    """Return whether a line holds values: it is not empty and no comment."""
    return bool(line.strip(b' \t\r\n",;')) and not line.lstrip(b' "').startswith(b"#")


def _is_prepared(line: bytes) -> bool:
    values = _names(line)
    return _is_row(line) and 2 * values.count("") > len(values)


def _in_motion(found: str) -> InputError:
    return InputError(
        f"{found}, expected held postures as in the plan; of a plan that moves, a watch reads the samples of "
        "motion.csv"
    )


def _names(line: bytes) -> list[str]:
    text = text_of(line).decode("utf-8-sig", "replace")
    return [name.strip().strip('"') for name in text.replace(";", ",").split(",")]


def check_state_file(path: Path) -> None:
    """Refuse, before the first row, a place inside a measurement folder or one that cannot be written."""
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, which the state would replace; expected a file")
    if present(path):
        check_outside(path.resolve())
    else:
        check_new(path)


def write_state(path: Path, day: str, seen: Seen) -> None:
    """Write how much was read, below the hash of the day."""
    write_bytes(path, "{} {}\n{} {} {}\n".format(FORMAT, day, *seen).encode())


def read_state(path: Path, day: str) -> Seen:
    """Return how much a watch of the same day has read; nothing if there is no such file."""
    if not present(path):
        return NOTHING
    found = re.fullmatch(rf"{FORMAT} (\w+)\n(\d+) (\d+) (\w+)\n", read_bytes(path).decode("utf-8", "replace"))
    if found is None:
        raise InputError(f"{path}: found no state of a watch; give another name")
    if found[1] != day:
        raise InputError(
            f"{path}: found the state of another plan, manifest or robot, expected that of this day; "
            "give another name for a new one"
        )
    return Seen(int(found[2]), int(found[3]), found[4])
