"""Rows of a measurement folder's table while they arrive: in a file that grows, or as lines of a stream.

A watch keeps the bytes of all lines that it has read; nothing before their end may change.
"""

from __future__ import annotations

import io
import itertools
import math
import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import check_new, check_outside, opened, present, read_bytes, write_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import measurements_in, moves

TABLE = "postures.csv"
FORMAT = b"tulip-watch-5"
MOST_LINE = 2**20  # bytes
MOST_AT_ONCE = 2**22  # bytes that are read of a file at a time


def line_number(read: bytes) -> int:
    """Return the number of the line that follows those that were read, from 1."""
    return read.count(b"\n") + 1


def text_of(line: bytes) -> bytes:
    """Return a line without its end."""
    return line.rstrip(b"\n").rstrip(b"\r")


def is_row(line: bytes) -> bool:
    """Return whether a line holds values: it is not empty and no comment."""
    return bool(line.strip(b' \t\r\n",;')) and not line.lstrip(b' "').startswith(b"#")


def new_lines(path: Path, read: bytes, once: bool = False) -> list[bytes]:
    """Return the complete lines of a file that grew; a half-written last line waits for its end.

    A row that is prepared, most of its readings still empty, waits for them, and so do those after it.

    Args:
        read: what was read before. once: also return a last line that has all values but no end.
    """
    if not present(path):
        if read:
            raise InputError(f"{path}: found no file any more, expected the one that was read so far")
        if moves(path.parent):
            raise _in_motion(f"{path.parent}: found samples of a motion")
        return []
    header = header_of(read)
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        beginning, content = file.read(len(read)), file.read(MOST_AT_ONCE)
    if size < len(read):
        raise InputError(
            f"{path}: found {size} bytes, expected at least the {len(read)} that were read: rows "
            "may only be added at the end"
        )
    if header not in beginning[:MOST_LINE]:
        raise _another_header(path, 1, text_of(beginning.split(b"\n")[0]), header)
    open_end = read[-1:] not in (b"", b"\n")
    if beginning != read or (open_end and content[:1] not in (b"", b"\r", b"\n")):
        raise InputError(
            f"{path}: found other values in the first {line_number(read) - (not open_end)} lines than were "
            "read before; rows may only be added at the end"
        )
    lines = list(io.BytesIO(content))
    for number, line in enumerate(lines, line_number(read)):
        check_line(path, number, line)
    if lines and not lines[-1].endswith(b"\n"):
        whole = len(_names(lines[-1])) == len(_names(header)) > 1 and len(content) < MOST_AT_ONCE
        lines = lines if once and whole else lines[:-1]
    return list(itertools.takewhile(lambda line: not _is_prepared(line), lines))


def _is_prepared(line: bytes) -> bool:
    values = _names(text_of(line))
    return is_row(line) and 2 * values.count("") > len(values)


def check_line(path: Path, number: int, line: bytes) -> None:
    """Refuse what is no line of a table."""
    if not isinstance(line, bytes):
        raise InputError(f"rows: found {type(line).__name__}, expected lines of bytes")
    if len(line) > MOST_LINE:
        raise InputError(f"{path}: line {number}: found more than {MOST_LINE} bytes, expected a row")
    if b"\r" in text_of(line):
        raise InputError(
            f"{path}: line {number}: found a carriage return (CR) within the line, expected lines that "
            "end with LF or CR LF"
        )


def header_of(read: bytes) -> bytes:
    """Return the first line that holds values; b"": none yet."""
    return next((text_of(line) for line in io.BytesIO(read) if is_row(line)), b"")


def is_header(path: Path, number: int, line: bytes, header: bytes) -> bool:
    """Return whether a line is the header: the first one, or the same once more."""
    text = text_of(line)
    names = _names(text)
    if not header and 2 * sum(map(_is_number, names)) > len(names):
        raise InputError(f"{path}: line {number}: found numbers, expected the columns' names")
    if not header and any(name.startswith("q_rate.") for name in names):
        raise _in_motion(f"{path}: line {number}: found rows of a motion")
    if header in (b"", text):
        return True
    if "posture" in names and names != _names(header):
        raise _another_header(path, number, text, header)
    return "posture" in names


def _in_motion(found: str) -> InputError:
    return InputError(
        f"{found}, expected held postures: a watch takes the noise of rows as independent, and in a motion "
        "it lasts; `check` takes the segments that are complete"
    )


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        return math.isfinite(float(text))
    return False


def _another_header(path: Path, number: int, now: bytes, header: bytes) -> InputError:
    gone = [name for name in _names(header) if name not in _names(now)]
    change = f"that column {listed(map(repr, gone))} vanished during the day" if gone else "another header"
    return InputError(f"{path}: line {number}: found {change}, expected the header of the first row")


def _names(header: bytes) -> list[str]:
    text = header.decode("utf-8-sig", "replace")
    return [name.strip().strip('"') for name in text.replace(";", ",").split(",")]


def row_of(
    path: Path, number: int, line: bytes, header: bytes, manifest: Manifest, where: Path
) -> Measurements:
    """Read one row and hold it against the contract."""
    names, values = _names(header), _names(text_of(line))
    if len(values) != len(names):
        fewer = "a column vanished" if len(values) < len(names) else "a column was added"
        raise InputError(
            f"{path}: line {number}: found {len(values)} values, expected {len(names)}, as many as the "
            f"header has names ({fewer} during the day, or a decimal comma)"
        )
    try:
        return measurements_in(manifest, TableFile(path, header + b"\n" + text_of(line) + b"\n"), where)
    except InputError as error:
        place = str(error).removeprefix(f"{path}: ").replace(", row 1", "")
        raise InputError(f"{path}: line {number}: {shortened(place, 400)}") from None


def check_state_file(path: Path) -> None:
    """Refuse, before the first row, a place inside a measurement folder or one that cannot be written."""
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, which the state would replace; expected a file")
    if present(path):
        check_outside(path.resolve())
    else:
        check_new(path)


def write_state(path: Path, day: str, read: bytes) -> None:
    """Write the lines that were read, below the hashes of the day and of themselves."""
    write_bytes(path, b" ".join((FORMAT, day.encode(), _hash(read))) + b"\n" + read)


def read_state(path: Path, day: str) -> bytes:
    """Return the lines that a watch of the same day has read; b"": there is no such file."""
    if not present(path):
        return b""
    head, _, read = read_bytes(path).partition(b"\n")
    form, *hashes = head.split(b" ")
    if form != FORMAT or len(hashes) != 2 or hashes[1] != _hash(read):
        raise InputError(f"{path}: found no state of a watch; give another name")
    if hashes[0] != day.encode():
        raise InputError(
            f"{path}: found the state of another plan, manifest or robot, expected that of this day; "
            "give another name for a new one"
        )
    return read


def _hash(read: bytes) -> bytes:
    return sha256(read).hexdigest().encode()
