"""A folder of work that may be interrupted: the same call goes on in it, every other one is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.base.alone import alone_on
from tulip_testbed.base.document import first_difference
from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, new_folder, present
from tulip_testbed.base.table_files import read_json, write_json

FREE = "machine"  # its last digits differ, its random numbers do not: another one may go on


@dataclass(frozen=True)
class ResumableFolder:
    """A folder of finished pieces of work, beside the document of all that they depend on.

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
            {key: value for key, value in document.items() if key != FREE}
            for document in (read_json(self.folder / self.file), self.made_with)
        )
        if (other := first_difference(there, here)) is not None:
            name, old, new = other
            raise InputError(
                f"{self.folder}: holds {self.pieces} of another configuration: {name} is "
                f"{shortened(repr(old))} there and {shortened(repr(new))} here; give a new name"
            )
        return True

    @contextmanager
    def opened(self, fill: Callable[[Path], object] = lambda folder: None) -> Iterator[Path]:
        """Make the folder, unless it is begun, and keep other processes out of it.

        Args:
            fill: called with a new folder, for what lies beside the pieces.
        """
        if not self.begun():
            with new_folder(self.folder) as working:
                fill(working)
                write_json(working / self.file, self.made_with)
        with alone_on(self.folder):
            yield self.folder
