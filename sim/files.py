"""Reading files that may be anything, and writing so that a file or folder appears whole or not at all."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
import stat
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tulip_testbed.sim.errors import InputError

MOST_BYTES = 64 * 2**20  # of any file that is read
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a regular file; never waits, whatever the path names.

    Raises:
        InputError: it cannot be read, is no regular file, or is larger than `most`.
    """
    try:
        # Without O_NONBLOCK, opening a named pipe waits for somebody who writes into it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            mode = os.fstat(descriptor).st_mode
            if not stat.S_ISREG(mode):
                raise InputError(f"{path}: found {KINDS.get(stat.S_IFMT(mode), 'no file')}, expected a file")
            with open(descriptor, "rb", closefd=False) as file:
                content = file.read(most + 1)
        finally:
            os.close(descriptor)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise InputError(f"{path}: cannot read ({error_text(error)})") from None
    if len(content) > most:
        raise InputError(f"{path}: found more than {most} bytes, expected at most that")
    return content


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """A regular file as UTF-8, with or without byte order mark.

    Raises:
        InputError: as `read_bytes`, or not UTF-8.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text ({error.reason})") from None


def present(path: Path) -> bool:
    """Whether the name is there, be it a file or not.

    Raises:
        InputError: its folder cannot be searched.
    """
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return False
    except OSError as error:
        raise InputError(f"{path}: cannot read ({error_text(error)})") from None
    return True


def check_new(path: Path) -> None:
    """Refuse, before the work, a path at which its result could not be written.

    Raises:
        InputError: the path exists, or lies in a folder that cannot be written.
    """
    path = Path(path)
    real = Path(os.path.realpath(path))
    if present(path) or real.exists():
        raise InputError(f"{path}: exists already; give a new name")
    parent = next(folder for folder in real.parents if folder.exists())
    try:
        os.rmdir(tempfile.mkdtemp(dir=parent, prefix=f".{path.name}.", suffix=".partial"))
    except OSError as error:
        raise InputError(f"{path}: cannot write into {parent} ({error.strerror})") from None


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to fill; it gets its name when the block ends well, else nothing stays behind.

    Raises:
        InputError: the name is taken or the folder cannot be written.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already; give the name of a new folder")
    with _partial(path) as working:
        yield working
        for inner in [*working.rglob("*"), working]:
            _to_disk(inner)
        os.rename(working, path)
        _to_disk(path.parent)


def write_text(path: Path, text: str) -> None:
    """Write one UTF-8 file, which appears whole; one of the same name is replaced.

    Raises:
        InputError: it cannot be written.
    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write one file, which appears whole; one of the same name is replaced.

    Raises:
        InputError: it cannot be written.
    """
    path = Path(path)
    with _partial(path) as working:
        file = working / path.name
        file.write_bytes(content)
        _to_disk(file)
        os.replace(file, path)
        _to_disk(path.parent)


@contextmanager
def _partial(path: Path) -> Iterator[Path]:
    """A hidden folder beside `path` to prepare it in: locked while in use, removed at the end.

    A killed process leaves its own behind, but not the lock, so the next one that writes to
    the same name can tell it from a folder in use, and removes it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_stale(path)
        working, lock = _make_locked(path)
        try:
            yield working
        finally:
            shutil.rmtree(working, ignore_errors=True)
            os.close(lock)
    except OSError as error:
        raise InputError(f"{path}: cannot write ({error_text(error)})") from None


def _make_locked(path: Path) -> tuple[Path, int]:
    while True:
        working = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
        working.mkdir()
        lock = os.open(working, os.O_RDONLY)
        with suppress(OSError):  # some network file systems cannot lock; there stale folders stay
            fcntl.flock(lock, fcntl.LOCK_EX)
        if working.exists():  # else somebody took it for stale before it was locked
            return working, lock
        os.close(lock)


def _remove_stale(path: Path) -> None:
    for stale in path.parent.glob(f".{glob.escape(path.name)}.????????.partial"):
        with suppress(OSError):
            lock = os.open(stale, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(stale, ignore_errors=True)
            finally:
                os.close(lock)


def _to_disk(path: Path) -> None:
    """Make a file's content, or a folder's names, survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def error_text(error: Exception) -> str:
    """What the system says, as one line."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())
