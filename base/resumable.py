"""A folder of work that may be interrupted: the same call goes on in it, alone; others are refused."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, error_text, hidden_stem, new_folder, present
from tulip_testbed.base.result import flattened
from tulip_testbed.base.table_files import read_json, write_json

NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)  # of some network file systems
FREE = "machine"  # its last digits differ, its random numbers do not: another one may go on


@contextmanager
def alone_on(path: Path) -> Iterator[None]:
    """Keep other processes from a file or a folder, until the end or until this process is killed.

    The hidden file .NAME.lock next to it is locked; a killed process leaves that file, but not the lock.
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


@dataclass(frozen=True)
class ResumableFolder:
    """A folder of finished pieces of work, next to the document of all that they depend on.

    Attributes:
        folder: its place. file: name of the document in it.
        made_with: the document: settings, hashes of the inputs, versions.
        kind: of the work, such as "Monte Carlo". pieces: name of what is finished, such as "runs".
    """

    folder: Path
    file: str
    made_with: dict[str, Any]
    kind: str
    pieces: str

    def begun(self) -> bool:
        """Return whether the same call has begun the folder; False: it is still to be made."""
        if not present(self.folder):
            check_new(self.folder)
            return False
        if not present(self.folder / self.file):
            raise InputError(
                f"{self.folder}: exists already and holds no {self.kind} ({self.file}); give a new name"
            )
        there, here = (
            flattened({key: value for key, value in document.items() if key != FREE})
            for document in (read_json(self.folder / self.file), self.made_with)
        )
        for name in {**here, **there}:
            if (old := there.get(name)) != (new := here.get(name)):
                raise InputError(
                    f"{self.folder}: holds {self.pieces} of another configuration: {name} is "
                    f"{shortened(repr(old))} there and {shortened(repr(new))} here; give a new name"
                )
        return True

    @contextmanager
    def opened(self, fill: Callable[[Path], object] = lambda folder: None) -> Iterator[Path]:
        """Make the folder and `fill` it, unless it is begun, and keep other processes out of it."""
        if not self.begun():
            with new_folder(self.folder) as working:
                fill(working)
                write_json(working / self.file, self.made_with)
        with alone_on(self.folder):
            yield self.folder
