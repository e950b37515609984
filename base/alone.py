"""Keep two processes from working on one folder or file at the same time."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import error_text, hidden_stem

NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)  # of some network file systems


@contextmanager
def alone_on(path: Path) -> Iterator[None]:
    """Keep other processes from a file or a folder, until the end or until this process is killed.

    The hidden file .NAME.lock beside it is locked; a killed process leaves that file, but not the lock.
    """
    from filelock import FileLock, Timeout  # a twentieth of a second, needed by long runs alone

    beside = Path(os.path.abspath(path))
    file = beside.with_name(f".{hidden_stem(beside)}.lock")
    lock = FileLock(file, blocking=False, thread_local=False, fallback_to_soft=False)
    try:
        beside.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise InputError(f"{path}: another process is at work in it") from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise InputError(f"{path}: cannot write ({error_text(error)})") from None
    try:
        yield
    finally:
        with suppress(OSError):
            file.unlink()
        lock.release()
