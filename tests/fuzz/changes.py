"""Change an input: rewrite a file, edit a table, put something else under a name.

Each change says what has to come of it: "refused", with a message that holds some words; "same" (accepted,
with the intact input's result); "right" (accepted, with that of an independent reading); or "either" refused
or right.
"""

import hashlib
import json
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from hypothesis import HealthCheck, assume, given, seed, settings
from hypothesis import strategies as st


class Expected(NamedTuple):
    """What has to come of an input."""

    outcome: str
    words: tuple[str, ...] = ()


Draw = Callable[[st.SearchStrategy[Any]], Any]
Change = Callable[[Path, Draw], Expected]  # of a folder
Make = Callable[[Any, Draw], list]  # out of a file's content, bytes or text, those of which it gets one
SAME, RIGHT, EITHER, REFUSED = map(Expected, ("same", "right", "either", "refused"))
WHOLE = "/base"  # the folder, in a message
DEVICES = ("/dev/zero", "/dev/full", "/dev/tty")
PLACES = ("file", "folder", "pipe", "socket", "closed", "gone", "loop", "nothing", *DEVICES)


def refused(*words: str) -> Expected:
    return Expected("refused", words)


def one(draw: Draw, items: Any) -> Any:
    """Draw one of the items by its number, since some are megabytes that nobody wants to see printed."""
    items = list(items)
    return items[draw(st.integers(0, len(items) - 1))]


def drawn(use: Callable[[Draw], Any], examples: int, stream: str) -> list:
    """Return what comes of examples, the same ones for the same stream; one that raises is shrunk."""
    found = []

    @seed(stream)
    @settings(max_examples=examples, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def each(data: st.DataObject) -> None:
        # Hypothesis begins with the first of everything, which would be all that a few examples show.
        assume(data.draw(st.booleans()))
        found.append(use(data.draw))

    each()
    return found


def content(make: Make, expected: Expected, *files: str) -> Change:
    """Give one of the files another content; the manifest then lists the table's new hash."""

    def change(folder: Path, draw: Draw) -> Expected:
        path = one(draw, [folder / name for name in files if (folder / name).exists()])
        old = path.read_bytes()
        made = one(draw, make(old if path.suffix == ".parquet" else old.decode(), draw))
        new = made.encode() if isinstance(made, str) else made
        assert new != old, f"{path.name}: nothing was changed"
        path.write_bytes(new)
        if path.stem == "postures":
            keep_alone(path)
        return named(expected, path)

    return change


def named(expected: Expected, path: Path, where: Iterable[str] = ()) -> Expected:
    """Ask a refusal to name the file and the place in it, unless it is about the whole folder."""
    if expected.outcome != "refused" or WHOLE in expected.words:
        return expected
    return refused(path.name, *(expected.words or where))


def keep_alone(path: Path) -> None:
    """Remove the table's twin and let the manifest list the table as it is."""
    for twin in path.parent.glob(f"{path.stem}.*"):
        if twin != path:
            twin.unlink()
    (manifest,) = path.parent.glob("*.json")
    tables = {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"tables": tables}, indent=1))


def harmless(text: str, draw: Draw) -> list:
    return ["\ufeff" + text, text.replace("\n", "\r\n"), text + "\n\n\n"]


def spoiled(text: str, draw: Draw) -> list:
    half, encoded = len(text) // 2, text.encode()
    broken = [encoded[:half] + bad + encoded[half:] for bad in (b"\x00", b"\xff\xfe")]
    return [text + text, text.encode("utf-16"), text + "x" * 2**24, *broken, ""]


def truncated(old: str | bytes, draw: Draw) -> list:
    return [old[: draw(st.integers(0, len(old) - 12))]]


def flipped(old: str | bytes, draw: Draw, low: int = 0) -> list:
    """Change up to eight bytes from `low` on."""
    changed = bytearray(old.encode() if isinstance(old, str) else old)
    where = st.integers(low, len(changed) - 1)
    for at, bits in draw(st.dictionaries(where, st.integers(1, 255), min_size=1, max_size=8)).items():
        changed[at] ^= bits
    return [bytes(changed)]


def stands(kind: str, *files: str) -> Change:
    """Put something else under the folder's name or under that of one of the files."""

    def change(folder: Path, draw: Draw) -> Expected:
        path = one(draw, [folder / name for name in ("", *files) if (folder / name).exists()])
        moved = path.rename(folder.with_name(f"moved_{path.name}"))
        if kind == "folder":
            path.mkdir()
        elif kind == "file":
            path.touch()
        elif kind == "pipe":
            os.mkfifo(path)
        elif kind == "socket":
            with socket.socket(socket.AF_UNIX) as listener:
                listener.bind(str(path))
        elif kind == "closed":
            moved.rename(path).chmod(0)
        elif kind != "nothing":
            path.symlink_to({"loop": path, "link": moved}.get(kind, Path(kind)))
        fine = kind == "link" or (kind == "nothing" and path.stem == "postures")
        return SAME if fine else refused(path.name)

    return change


def table(
    edit: Callable[[pa.Table, Draw], pa.Table], expected: Expected, *formats: str, **options: Any
) -> Change:
    """Edit the table and write it in one format alone; a refusal has to name the place."""

    def change(folder: Path, draw: Draw) -> Expected:
        (written,) = folder.glob("*.parquet")
        intact = pyarrow.parquet.read_table(written)
        edited, path = edit(intact, draw), written.with_suffix(f".{one(draw, formats or ('parquet', 'csv'))}")
        write = pyarrow.parquet.write_table if path.suffix == ".parquet" else pyarrow.csv.write_csv
        write(edited, path, **options)
        keep_alone(path)
        return named(expected, path, place(intact, edited))

    return change


def place(intact: pa.Table, edited: pa.Table) -> Iterator[str]:
    """Name the columns that were changed and, unless all rows of a column were, its first one that was."""
    for name in intact.column_names:
        if (count := edited.column_names.count(name)) != 1:
            yield f"column '{name}' {'more than once' if count else 'is missing'}"
        elif not intact[name].equals(edited[name]):
            yield f"column '{name}'"
            pairs = zip(intact[name], edited[name], strict=True)
            rows = [f"row {k}" for k, (old, new) in enumerate(pairs, 1) if not old.equals(new)]
            yield from rows[: len(rows) < len(intact)]
