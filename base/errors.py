"""The exception and the warning for bad input, and helpers that word their messages."""

import difflib
import linecache
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable
from itertools import takewhile
from types import FrameType

PACKAGE = __name__.partition(".")[0]
LIKELY = 0.7  # similarity from which on another name may have been meant

MOST_LISTED = 40  # names in a message


class InputError(ValueError):
    """Bad input; the message names what was found, where, and what was expected."""

    exit_code = 2  # of the command

    def _render_traceback_(self) -> list[str]:
        """Return what a notebook shows: the line that called the library, and the message."""
        way = takewhile(lambda step: not _is_ours(step[0]), traceback.walk_tb(self.__traceback__))
        caller = [
            f"----> {number} {linecache.getline(frame.f_code.co_filename, number, frame.f_globals).strip()}"
            for frame, number in way
        ]
        return [*caller[-1:], f"{type(self).__name__}: {self}"]


class FaultyError(InputError):
    """Measurements that can be read, but fail a check without which the work makes no sense."""

    exit_code = 1


class InputWarning(UserWarning):
    """Input that is probably not what was meant."""


class IncompleteError(InputError):
    """A measurement folder that lacks something; the caller that catches it says how to see all of it."""


class UnknownNameError(InputError, KeyError):
    """A name that is not among the valid ones; mappings raise it, so that `in` and `get` work."""

    __str__ = InputError.__str__  # that of KeyError would quote the message


def listed(names, most: int = MOST_LISTED) -> str:
    """Join names for an error message, in their own order; of very many only the first."""
    first = [str(name) for name in names]
    more = f" and {len(first) - most} more" if len(first) > most else ""
    return ", ".join(first[:most]) + more


def most_frequent(reasons: Counter[str]) -> str:
    """Join the most frequent reasons with their counts for an error message."""
    return listed(f"{reason} ({count})" for reason, count in reasons.most_common(4))


def shortened(value: object, most: int = 60) -> str:
    """Return any value as text of one line with at most `most` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def warn(message: str) -> None:
    """Warn at the line that called the library."""
    frames = [frame for frame, _ in traceback.walk_stack(sys._getframe())]
    outermost = max(k for k, frame in enumerate(frames) if _is_ours(frame))
    warnings.warn(message, InputWarning, stacklevel=outermost + 2)


def _is_ours(frame: FrameType) -> bool:
    return frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE


def choices(name: object, valid: Iterable[object]) -> str:
    """Word the valid names for an error message, those that are close to `name` first."""
    names = [str(one) for one in valid]
    close = close_to(name, names)
    meant = f"did you mean {' or '.join(map(repr, close))}? " if close else ""
    return f"{meant}valid: {listed(names)}"


def close_to(name: object, names: list[str]) -> list[str]:
    """Return the names that may have been meant, at most three, the closest first."""
    return difflib.get_close_matches(shortened(name), names, n=3, cutoff=LIKELY)


def look_up(kind: str, name: str, valid, where: str) -> str:
    """Return `name` if it is one of `valid`.

    Raises:
        UnknownNameError: `name` is unknown; the message lists the names that are close and those that are
            valid.
    """
    if name not in valid:
        raise UnknownNameError(f"{where}: unknown {kind} '{shortened(name)}'; {choices(name, valid)}")
    return name


def at_most(name: str, value: int, most: int) -> None:
    if value > most:
        raise InputError(f"{name}: found {shortened(value)}, expected {most} or less")


def at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise InputError(f"{name}: found {value}, expected {least} or more")
