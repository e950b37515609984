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
from tulip_testbed.measurements.data import OF_ROWS
from tulip_testbed.measurements.logs.series_reduction import reduced_window
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import (
    mapped_samples,
    measurements_in,
    moves,
    samples_from,
)
from tulip_testbed.measurements.motion_table import MOST_SAMPLES

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
    _size: int = 0
    _lines: int = 0
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
        seen = self._seen if self._size else self.kept
        if not present(self.path):
            if seen.size:
                raise InputError(
                    f"{self.path}: found no file any more, expected the one that was read so far"
                )
            if self.held and moves(self.path.parent):
                raise _in_motion(f"{self.path.parent}: found samples of a motion")
            return []
        with opened(self.path) as file:
            if self.held or not self._size:  # a motion is long
                before = file.read(seen.size)
                goes_on = before[-1:] not in (b"", b"\n") and file.read(1) not in (b"", b"\r", b"\n")
                if goes_on or sha256(before).hexdigest() != seen.sha256:
                    raise self._changed(seen)
            elif file.seek(0, 2) < seen.size:
                raise self._changed(seen)
            file.seek(self._size)
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

    @property
    def _seen(self) -> Seen:
        return Seen(self._size, self._lines, self._hash.hexdigest())

    def _changed(self, seen: Seen) -> InputError:
        return InputError(
            f"{self.path}: found other values in the first {seen.lines} lines than were read before, or "
            "fewer; rows may only be added at the end"
        )

    def _rows(self, lines: list[bytes]) -> Iterator[Line]:
        """Yield the lines that are rows below the header."""
        for line in lines:
            new = self._size >= self.kept.size
            self._lines += not self._open
            self._size, self._open = self._size + len(line), not line.endswith(b"\n")
            self._hash.update(line)
            if not is_row(line):
                continue
            if self._is_header(line):
                self._header = self._header or text_of(line)
            else:
                yield Line(self._lines, text_of(line), self._seen, new)

    def _is_header(self, line: bytes) -> bool:
        """Return whether a line is the header: the first one, or the same once more."""
        names, known, where = _names(line), _names(self._header), f"{self.path}: line {self._lines}"
        if not self._header and any(name.startswith("q_rate.") for name in names):
            raise _in_motion(f"{where}: found rows of a motion")
        if self._header and "posture" in names and names != known:
            raise InputError(f"{where}: found another header, expected that of the first row")
        return not self._header or names == known

    def _taken(self, lines: Iterable[Line]) -> Iterator[Arrived]:
        """Yield rows and problems of some lines."""
        for line in lines:
            row, problem = None, ""
            try:
                row = measurements_in(self.manifest, self._table([line]), self.where)
            except InputError as error:
                problem = self._problem(line, error)
            yield Arrived(line, row, problem)

    def _table(self, lines: list[Line]) -> TableFile:
        content = b"\n".join([self._header, *(line.text for line in lines), b""])
        return TableFile(self.path, content, MOST_SAMPLES)

    def _problem(self, line: Line, error: InputError) -> str:
        """Return what is wrong with a line that was read by itself."""
        place = str(error).removeprefix(f"{self.path}: ").removeprefix("line 2: ").replace(", row 1", "")
        return f"{self.path}: line {line.number}: {shortened(place, 400)}"


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
    _segments: list[int] = field(default_factory=list)
    _waiting: list[Measurements] = field(default_factory=list)  # samples since the next window's start
    _start: float = 0.0  # of the segment's first window
    _next: int = 0  # window of the segment

    def _taken(self, lines: Iterable[Line]) -> Iterator[Arrived]:
        for some, samples, problem in self._parsed(list(lines)):
            if samples is None:
                yield Arrived(some[0], None, problem)
                continue
            for k, line in enumerate(some):
                one = samples.take(np.array([k]))
                if problem := self._misplaced(one):
                    yield Arrived(line, None, f"{self.path}: line {line.number}: {problem}")
                else:
                    yield from self._with_sample(one, line)

    def _parsed(self, lines: list[Line]) -> Iterator[tuple[list[Line], Measurements | None, str]]:
        """Yield samples of lines that can be read together, and of each that cannot be read what is wrong."""
        if not lines:
            return
        try:
            mapped = mapped_samples(self.manifest, self._table(lines), self.where)
            yield lines, samples_from(self.manifest, mapped, self.where), ""
        except InputError as error:
            if len(lines) == 1:
                yield lines, None, self._problem(lines[0], error)
                return
            for half in (lines[: len(lines) // 2], lines[len(lines) // 2 :]):
                yield from self._parsed(half)

    def _misplaced(self, one: Measurements) -> str:
        """Say why a sample cannot follow those before it; "": it can."""
        segment, last = int(one.posture[0]), self._waiting[-1] if self._waiting else None
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

    def _with_sample(self, one: Measurements, line: Line) -> Iterator[Arrived]:
        """Take a sample in, and yield the row or the problem of a window that ends before it."""
        segment, time = int(one.posture[0]), float(one.time[0])
        if not self._segments or segment != self._segments[-1]:
            self._segments.append(segment)
            self._waiting, self._start, self._next = [], time, 0
        start = self._start + self.window * self._next
        self._waiting.append(one)
        if time < start + self.window - 1e-9:
            return
        found = reduced_window(joined(self._waiting), self.weight, start, self.window)
        if len(found.measurements):
            self._count += 1
            yield Arrived(line, replace(found.measurements, posture=np.array([self._count])))
        else:
            (cause,) = found.dropped
            problem = f"found no row from {start:.2f} s on, of a window {cause}"
            yield Arrived(line, None, f"{self.path}: line {line.number}: {problem}")
        # Windows without a sample give nothing.
        self._next = max(self._next + 1, int((time - self._start) / self.window + 1e-9))
        self._waiting = [one]


def joined(samples: list[Measurements]) -> Measurements:
    arrays = {
        name: np.concatenate([getattr(one, name) for one in samples])
        for name, values in vars(samples[0]).items()
        if name in OF_ROWS and values is not None
    }
    return replace(samples[0], **arrays)  # pyrefly: ignore[bad-argument-type]


def text_of(line: bytes) -> bytes:
    return line.rstrip(b"\n").rstrip(b"\r")


def is_row(line: bytes) -> bool:
    """Return whether a line holds values: it is not empty and no comment."""
    return bool(line.strip(b' \t\r\n",;')) and not line.lstrip(b' "').startswith(b"#")


def _is_prepared(line: bytes) -> bool:
    values = _names(line)
    return is_row(line) and 2 * values.count("") > len(values)


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
