"""How long work says how far it is; who calls it decides whether it is shown."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Advance(Protocol):
    """Called with the number of those that are done now, and with the best value so far if there is one."""

    def __call__(self, count: int, /, value: float | None = None) -> None: ...


# Called with what is counted, how many there are (None: nobody knows) and how many were done before.
Progress = Callable[[str, int | None, int], AbstractContextManager[Advance]]


def silent(what: str, total: int | None, done: int = 0) -> AbstractContextManager[Advance]:
    """Show nothing."""
    return nullcontext(_nothing)


def _nothing(count: int, /, value: float | None = None) -> None:
    pass
