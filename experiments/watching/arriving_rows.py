"""Rows of a measurement folder's table while they arrive in a file that grows.

A watch keeps the bytes of all lines that it has read; nothing before their end may change.
"""

import io
import itertools
from pathlib import Path

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, check_outside, opened, present, read_bytes, write_bytes
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import measurements_in, moves

TABLE = "postures.csv"
FORMAT = b"tulip-watch-7"
MOST_LINE = 2**20  # bytes
MOST_AT_ONCE = 2**22  # bytes that are read of a file at a time


def text_of(line: bytes) -> bytes:
    return line.rstrip(b"\n").rstrip(b"\r")


def is_row(line: bytes) -> bool:
    """Return whether a line holds values: it is not empty and no comment."""
    return bool(line.strip(b' \t\r\n",;')) and not line.lstrip(b' "').startswith(b"#")


def new_lines(path: Path, read: bytes, header: bytes, once: bool = False) -> list[bytes]:
    """Return the complete lines of a file that grew; a half-written last line waits for its end.

    A row that is prepared, most of its readings still empty, waits for them, and so do those after it.

    Args:
        read: what was read before. header: in it; b"": none yet.
        once: also return a last line that has all values but no end.
    """
    if not present(path):
        if read:
            raise InputError(f"{path}: found no file any more, expected the one that was read so far")
        if moves(path.parent):
            raise _in_motion(f"{path.parent}: found samples of a motion")
        return []
    with opened(path) as file:
        beginning, content = file.read(len(read)), file.read(MOST_AT_ONCE)
    open_end = read[-1:] not in (b"", b"\n")
    if beginning != read or (open_end and content[:1] not in (b"", b"\r", b"\n")):
        lines = len(read.splitlines())
        raise InputError(
            f"{path}: found other values in the first {lines} lines than were read before, or fewer; rows "
            "may only be added at the end"
        )
    lines = list(io.BytesIO(content))
    if any(len(line) > MOST_LINE or b"\r" in text_of(line) for line in lines):
        raise InputError(
            f"{path}: found a line of more than {MOST_LINE} bytes or with a carriage return (CR) within, "
            "expected lines that end with LF or CR LF"
        )
    if lines and not lines[-1].endswith(b"\n"):
        whole = len(_names(lines[-1])) == len(_names(header)) > 1 and len(content) < MOST_AT_ONCE
        lines = lines if once and whole else lines[:-1]
    return list(itertools.takewhile(lambda line: not _is_prepared(line), lines))


def _is_prepared(line: bytes) -> bool:
    values = _names(line)
    return is_row(line) and 2 * values.count("") > len(values)


def is_header(path: Path, number: int, line: bytes, header: bytes) -> bool:
    """Return whether a line is the header: the first one, or the same once more."""
    names, known = _names(line), _names(header)
    if not header and any(name.startswith("q_rate.") for name in names):
        raise _in_motion(f"{path}: line {number}: found rows of a motion")
    if header and "posture" in names and names != known:
        raise InputError(f"{path}: line {number}: found another header, expected that of the first row")
    return not header or names == known


def _in_motion(found: str) -> InputError:
    return InputError(
        f"{found}, expected held postures as in the plan; of a plan that moves, a watch reads the samples of "
        "motion.csv"
    )


def _names(line: bytes) -> list[str]:
    text = text_of(line).decode("utf-8-sig", "replace")
    return [name.strip().strip('"') for name in text.replace(";", ",").split(",")]


def row_of(
    path: Path, number: int, line: bytes, header: bytes, manifest: Manifest, where: Path
) -> Measurements:
    """Read one row and hold it against the contract."""
    try:
        return measurements_in(manifest, TableFile(path, header + b"\n" + text_of(line) + b"\n"), where)
    except InputError as error:
        place = str(error).removeprefix(f"{path}: ").removeprefix("line 2: ").replace(", row 1", "")
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
    """Write the lines that were read, below the hash of the day."""
    write_bytes(path, b" ".join((FORMAT, day.encode())) + b"\n" + read)


def read_state(path: Path, day: str) -> bytes:
    """Return the lines that a watch of the same day has read; b"": there is no such file."""
    if not present(path):
        return b""
    head, _, read = read_bytes(path).partition(b"\n")
    form, _, of_day = head.partition(b" ")
    if form != FORMAT:
        raise InputError(f"{path}: found no state of a watch; give another name")
    if of_day != day.encode():
        raise InputError(
            f"{path}: found the state of another plan, manifest or robot, expected that of this day; "
            "give another name for a new one"
        )
    return read
