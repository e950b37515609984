"""Keep two processes from working on one folder or file at the same time."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import error_text, hidden_stem


@contextmanager
def alone_in(folder: Path, file: str) -> Iterator[None]:
    """Keep other processes out of a folder, until the end or until this process is killed.

    Args:
        file: a file in it that exists and is not replaced meanwhile.

    Raises:
        InputError: another process is at work in it.
    """
    lock = os.open(folder / file, os.O_RDONLY | os.O_CLOEXEC)
    try:
        _lock(lock, folder)
        yield
    finally:
        os.close(lock)


@contextmanager
def alone_on(path: Path) -> Iterator[None]:
    """Keep other processes from a file that is replaced as a whole.

    The hidden file .NAME.lock in its folder is locked; a killed process leaves it, but not the lock.

    Raises:
        InputError: another process is at work on it, or nothing can be written there.
    """
    lock_file = path.with_name(f".{hidden_stem(path)}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = os.open(lock_file, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise InputError(f"{path}: cannot write ({error_text(error)})") from None
    try:
        _lock(lock, path)
        if not (lock_file.exists() and os.path.samestat(os.fstat(lock), lock_file.stat())):
            raise _at_work(path)  # the other one removed it just before it was locked
        try:
            yield
        finally:
            with suppress(OSError):
                lock_file.unlink()
    finally:
        os.close(lock)


def _lock(descriptor: int, work: Path) -> None:
    """Lock a file; the system unlocks it however the process ends."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise _at_work(work) from None
    except OSError:  # some network file systems cannot lock
        pass


def _at_work(work: Path) -> InputError:
    return InputError(f"{work}: another process is at work in it")
