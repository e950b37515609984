"""Read arbitrary files safely, and write files and folders so that they appear whole or not at all."""

import errno
import fcntl
import functools
import glob
import hashlib
import itertools
import os
import shutil
import stat
import tempfile
import tomllib
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from tulip_testbed.base.errors import InputError, shortened

MOST_BYTES = 64 * 2**20  # of any file that is read
MOST_TOML = 2**20  # bytes
NO_LINKS = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV)
MOST_NAME = 255  # bytes of a part of a path, on every usual file system
TRIES = 100  # at a hidden name, which other processes may take for stale
LONGEST_STEM = 200  # bytes of it that are found again in hidden names
FOLDERS = {"measurement": "manifest.json", "plan": "plan.json", "run": "run.json", "rig": "rig.json"}
OURS = b'"tulip-'  # in each of these files
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_path(path: str | Path) -> None:
    """Refuse a path that cannot be given to every library, written down and read again."""
    text = os.fspath(path)
    shown = shortened(text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0"))
    if "\0" in text:
        raise InputError(f"{shown}: found a NUL in the path, expected none")
    try:
        longest = max((len(part.encode()) for part in text.split("/")), default=0)
    except UnicodeEncodeError:
        raise InputError(f"{shown}: found a path that is not UTF-8, expected one that is") from None
    if longest > MOST_NAME:
        raise InputError(f"{shown}: found a name of {longest} bytes, expected at most {MOST_NAME}")


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file, without ever blocking."""
    with opened(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{path}: found more than {most} bytes, expected at most {most}")
    return content


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file to read it; nothing waits for the writer of a pipe."""
    try:
        # Without O_NONBLOCK, opening a named pipe waits for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise _unreadable(path, error) from None
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: found {KINDS.get(stat.S_IFMT(mode), 'no file')}, expected a file")
        with open(descriptor, "rb", closefd=False) as file:
            yield file
    except OSError as error:
        raise _unreadable(path, error) from None
    finally:
        os.close(descriptor)


def _unreadable(path: Path, error: OSError | ValueError) -> InputError:
    return InputError(f"{path}: cannot read ({error_text(error)})")


def sha256(path: Path) -> str:
    """Return the hash of a file's bytes, in hexadecimal."""
    return hashlib.sha256(read_bytes(Path(path))).hexdigest()


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """Return a regular file as UTF-8 text, with or without byte order mark."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text ({error.reason})") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file of at most `MOST_TOML` bytes."""
    try:
        return tomllib.loads(read_text(path, MOST_TOML))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file ({error})") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deep") from None


def present(path: Path) -> bool:
    """Return whether the name exists, as a file or anything else."""
    return _looked_up(path, os.lstat) is not None


def is_folder(path: Path) -> bool:
    there = _looked_up(path, os.stat)
    return there is not None and stat.S_ISDIR(there.st_mode)


def _looked_up(path: Path, how: Callable[[Path], os.stat_result]) -> os.stat_result | None:
    try:
        return how(path)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return None
    except OSError as error:
        raise _unreadable(path, error) from None


def check_outside(path: Path) -> None:
    """Refuse a place inside of a folder that commands read: it holds what was written at once, and no more.

    Raises:
        InputError: names that folder.
    """
    for folder, (kind, file) in itertools.product(path.parents, FOLDERS.items()):
        try:
            ours = present(folder / file) and OURS in read_bytes(folder / file)
        except InputError:  # another program's
            continue
        if ours:
            raise InputError(f"{path}: lies inside the {kind} folder {folder}, expected a place outside")


def check_new(path: Path, ending: str = "") -> None:
    """Refuse, before the work, a path at which its result could not be written, or of another ending."""
    check_path(path)
    path = Path(path)
    if not path.name.lower().endswith(ending):
        raise InputError(f"{path}: found a name that ends in '{path.suffix}', expected {ending}")
    real = Path(os.path.realpath(path))
    if present(path) or present(real):
        raise InputError(f"{path}: exists already; give a new name")
    if not ending:  # a view or a page may lie beside what it shows
        check_outside(real)
    parent = next(folder for folder in real.parents if present(folder))
    try:
        probe = tempfile.mkdtemp(dir=parent, prefix=f".{hidden_stem(path)}.", suffix=".partial")
        with suppress(FileNotFoundError):  # another writer of the name took it for stale
            os.rmdir(probe)
    except OSError as error:
        raise InputError(f"{path}: cannot write into {parent} ({error_text(error)})") from None


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a folder to fill; it gets its name if the block succeeds and is removed otherwise.

    Raises:
        InputError: the name exists already, lies in a folder of another result, or cannot be written.
    """
    check_path(path)
    path = Path(path)
    if present(path):
        raise InputError(f"{path}: exists already; give the name of a new folder")
    check_outside(Path(os.path.realpath(path)))
    with _partial(path, _new_folder) as working:
        yield working
        for inner in [*working.rglob("*"), working]:
            _to_disk(inner)
        if present(path):  # by now
            raise InputError(f"{path}: exists already; give the name of a new folder")
        os.rename(working, path)
        _to_disk(path.parent)


def write_text(path: Path, text: str, new: bool = False) -> None:
    """Write a UTF-8 file, see `write_bytes`."""
    write_bytes(path, text.encode(), new)


def write_bytes(path: Path, content: bytes, new: bool = False) -> None:
    """Write a file atomically, in the place of one of the same name unless it is to be `new`."""
    check_path(path)
    path = Path(path)
    with _partial(path, _new_file) as working:
        working.write_bytes(content)
        _to_disk(working)
        if new:
            _name_new(working, path)
        os.replace(working, path)
        _to_disk(path.parent)


def _name_new(file: Path, path: Path) -> None:
    """Give a file its name unless there is one, which is refused; `os.rename` would replace it."""
    try:
        try:
            os.link(file, path)
        except OSError as error:
            if error.errno not in NO_LINKS:
                raise
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))  # a file system without links
    except FileExistsError:
        raise InputError(f"{path}: exists already; give a new name") from None


@contextmanager
def scratch_folder(name: str) -> Iterator[Path]:
    """Yield a folder among the system's temporary files that nobody else may read, removed at the end.

    A killed process's partial output is removed by the next one that asks for the same name.
    """
    with _partial(Path(tempfile.gettempdir()) / name, functools.partial(_new_folder, mode=0o700)) as working:
        yield working


def _new_folder(path: Path, mode: int = 0o777) -> int:
    path.mkdir(mode)
    return os.open(path, os.O_RDONLY)


def _new_file(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)


@contextmanager
def _partial(path: Path, make: Callable[[Path], int]) -> Iterator[Path]:
    """Yield a hidden folder or file next to `path`, locked while in use and removed at the end.

    A killed process leaves it but not the lock, so that the next process that writes to the same name
    recognises it as stale and removes it.

    Args:
        make: makes it and opens it.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_stale(path)
        working, lock = _make_locked(path, make)
        try:
            yield working
        finally:
            _remove(working)
            os.close(lock)
    except OSError as error:
        raise InputError(f"{path}: cannot write ({error_text(error)})") from None


def hidden_stem(path: Path) -> str:
    """Return what hidden names of a result begin with; a name of almost 255 bytes leaves no room for more."""
    name = os.fsencode(path.name)
    return path.name if len(name) <= LONGEST_STEM else hashlib.sha256(name).hexdigest()


def _make_locked(path: Path, make: Callable[[Path], int]) -> tuple[Path, int]:
    tried = 0
    while True:
        tried += 1
        working = path.with_name(f".{hidden_stem(path)}.{uuid.uuid4().hex[:8]}.partial")
        try:
            lock = make(working)
        except FileNotFoundError:
            if (
                tried == TRIES or not path.parent.is_dir()
            ):  # /proc says of every new file that it is not there
                raise
            continue  # another process removed it as stale before it was opened
        with suppress(OSError):  # some network file systems cannot lock; stale ones remain there
            fcntl.flock(lock, fcntl.LOCK_EX)
        if working.exists():  # otherwise another process removed it as stale before it was locked
            return working, lock
        os.close(lock)


def _remove_stale(path: Path) -> None:
    for stale in path.parent.glob(f".{glob.escape(hidden_stem(path))}.????????.partial"):
        with suppress(OSError):
            lock = os.open(stale, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(stale)
            finally:
                os.close(lock)


def _remove(path: Path) -> None:
    """Remove a folder or a file, as far as the system lets us."""
    shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        path.unlink()


def _to_disk(path: Path) -> None:
    """Flush a file's content, or a folder's names, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def error_text(error: Exception) -> str:
    """Return the system's message as one line."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())
