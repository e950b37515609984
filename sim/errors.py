"""The exception for bad input, and helpers that word its messages."""

from collections import Counter


class InputError(ValueError):
    """Bad input; the message names what was found, where, and what was expected."""


class UnknownNameError(InputError, KeyError):
    """A name that is not among the valid ones; mappings raise it, so that `in` and `get` work."""

    __str__ = InputError.__str__  # that of KeyError would quote the message


def listed(names) -> str:
    """Join names for an error message, in their own order."""
    return ", ".join(str(name) for name in names)


def most_frequent(reasons: Counter[str], most: int = 4) -> str:
    """Join the most frequent reasons with their counts for an error message."""
    return listed(f"{reason} ({count})" for reason, count in reasons.most_common(most))


def shortened(value: object, most: int = 60) -> str:
    """Return any value as text of one line with at most `most` characters."""
    text = " ".join(str(value).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def look_up(kind: str, name: str, valid, where: str) -> str:
    """Return `name` if it is one of `valid`.

    Raises:
        InputError: `name` is unknown; the message lists the valid names.
    """
    if name not in valid:
        raise InputError(f"{where}: unknown {kind} '{shortened(name)}'; valid: {listed(valid)}")
    return name


def at_least(name: str, value: int, least: int) -> None:
    """Refuse a number below `least`.

    Raises:
        InputError: the number is too small.
    """
    if value < least:
        raise InputError(f"{name}: found {value}, expected {least} or more")
