"""Rows of a measurement folder's table while they arrive: in a file that grows, or as lines of a stream."""

from __future__ import annotations

import io
import itertools
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import opened, present
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import measurements_in

TABLE = "postures.csv"
MOST_LINE = 2**20  # bytes
MOST_AT_ONCE = 2**22  # bytes that are read of a file at a time


@dataclass(frozen=True)
class Line:
    """A complete line of a table.

    Attributes:
        whole: as it was read. text: without its end. number: in the file, from 1.
        end: bytes of the file up to its end.
    """

    whole: bytes
    text: bytes
    number: int
    end: int

    @property
    def is_row(self) -> bool:
        """Return whether the line holds values: it is not empty and no comment."""
        return bool(self.text.strip(b' \t\r",;')) and not self.text.lstrip(b' "').startswith(b"#")

    @property
    def is_prepared(self) -> bool:
        """Return whether most values are empty: a row that was prepared and is not measured yet."""
        values = _names(self.text)
        return self.is_row and 2 * values.count("") > len(values)


@dataclass(frozen=True)
class Place:
    """How far a table was read.

    Attributes:
        lines: number of lines. size: bytes up to the end of the last one.
        header: the first line that holds values; b"": none yet.
        checksum: of everything that was read.
    """

    lines: int = 0
    size: int = 0
    header: bytes = b""
    checksum: int = 0

    def after(self, line: Line) -> Place:
        """Return the place after one more line."""
        header = self.header or (line.text if line.is_row else b"")
        return Place(line.number, line.end, header, crc32(line.whole, self.checksum))


BEGINNING = Place()


def new_lines(path: Path, place: Place, once: bool = False) -> list[Line]:
    """Return the complete lines of a file that grew; a half-written last line waits for its end.

    A row that is prepared, its readings still empty, waits for them, and so do those after it.

    Args:
        once: also return a last line that has all values but no end.
    """
    if not present(path):
        if place.size:
            raise InputError(f"{path}: found no file any more, expected the one that was read so far")
        return []
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size < place.size:
            raise InputError(
                f"{path}: found {size} bytes, expected at least the {place.size} that were read: rows "
                "may only be added at the end"
            )
        beginning = file.read(place.size)
        if place.header and place.header not in beginning[:MOST_LINE]:
            raise _another_header(path, 1, beginning.split(b"\n")[0].rstrip(b"\r"), place)
        content = file.read(MOST_AT_ONCE)
        open_end = beginning[-1:] not in (b"", b"\n")
        if (open_end and content[:1] not in (b"", b"\r", b"\n")) or crc32(beginning) != place.checksum:
            raise InputError(
                f"{path}: found other values in the first {place.lines} lines than were read before; rows "
                "may only be added at the end"
            )
    *complete, rest = list(io.BytesIO(content)) or [b""]
    whole = once and len(_names(rest)) == len(_names(place.header)) > 1 and len(content) < MOST_AT_ONCE
    if rest.endswith(b"\n") or whole:
        complete.append(rest)
    begun = replace(place, lines=place.lines - open_end)
    lines = lines_of(complete or [rest], begun, path)  # of half a line the ending alone is checked
    arrived = list(itertools.takewhile(lambda line: not line.is_prepared, lines))
    return arrived if complete else []


def lines_of(stream: Iterable[bytes], place: Place, path: Path) -> Iterator[Line]:
    """Yield the lines of a stream; its end also ends a line."""
    number, end = place.lines, place.size
    for whole in stream:
        if not isinstance(whole, bytes):
            raise InputError(f"rows: found {type(whole).__name__}, expected lines of bytes")
        number, end = number + 1, end + len(whole)
        if len(whole) > MOST_LINE and not whole.endswith(b"\n"):
            raise InputError(f"{path}: line {number}: found more than {MOST_LINE} bytes, expected a row")
        text = whole.rstrip(b"\n").rstrip(b"\r")
        if b"\r" in text:
            raise InputError(
                f"{path}: line {number}: found a carriage return (CR) within the line, expected lines that "
                "end with LF or CR LF"
            )
        yield Line(whole, text, number, end)


def is_header(path: Path, line: Line, place: Place) -> bool:
    """Return whether a line is the header: the first one, or the same once more."""
    if not place.header and 2 * sum(map(_is_number, names := _names(line.text))) > len(names):
        raise InputError(f"{path}: line {line.number}: found numbers, expected the columns' names")
    if place.header in (b"", line.text):
        return True
    if "posture" not in _names(line.text):
        return False
    if _names(line.text) != _names(place.header):
        raise _another_header(path, line.number, line.text, place)
    return True


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        return math.isfinite(float(text))
    return False


def _another_header(path: Path, number: int, now: bytes, place: Place) -> InputError:
    gone = [name for name in _names(place.header) if name not in _names(now)]
    change = f"that column {listed(map(repr, gone))} vanished during the day" if gone else "another header"
    return InputError(f"{path}: line {number}: found {change}, expected the header of the first row")


def _names(header: bytes) -> list[str]:
    text = header.decode("utf-8-sig", "replace")
    return [name.strip().strip('"') for name in text.replace(";", ",").split(",")]


def row_of(line: Line, header: bytes, manifest: Manifest, path: Path, where: Path) -> Measurements:
    """Read one row and hold it against the contract."""
    if len(line.text) > MOST_LINE:
        raise InputError(f"{path}: line {line.number}: found {len(line.text)} bytes, expected one posture")
    names, values = _names(header), _names(line.text)
    if len(values) != len(names):
        fewer = "a column vanished" if len(values) < len(names) else "a column was added"
        raise InputError(
            f"{path}: line {line.number}: found {len(values)} values, expected {len(names)}, as many as the "
            f"header has names ({fewer} during the day, or a decimal comma)"
        )
    try:
        return measurements_in(manifest, TableFile(path, header + b"\n" + line.text + b"\n"), where)
    except InputError as error:
        place = str(error).removeprefix(f"{path}: ").replace(", row 1", "")
        raise InputError(f"{path}: line {line.number}: {shortened(place, 400)}") from None
