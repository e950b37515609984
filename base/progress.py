"""How long work says how far it is; who calls it decides whether anybody sees it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

# Called with what is counted, how many there are and how many were done before; gives a context that yields a
# function to be called with the number of those that are done now.
Progress = Callable[[str, int, int], AbstractContextManager[Callable[[int], None]]]


def silent(what: str, total: int, done: int = 0) -> AbstractContextManager[Callable[[int], None]]:
    """Show nothing."""
    return nullcontext(lambda count: None)
