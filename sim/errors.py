"""The one exception for input that a person can mend."""


class InputError(ValueError):
    """Bad input; the message names what was found, where, and what was expected."""


def listed(names) -> str:
    """Names for an error message, in their own order."""
    return ", ".join(str(name) for name in names)


def look_up(kind: str, name: str, valid, where: str) -> str:
    """Return `name` if it is one of `valid`.

    Raises:
        InputError: `name` is unknown; the message lists the valid names.
    """
    if name not in valid:
        raise InputError(f"{where}: unknown {kind} '{name}'; valid: {listed(valid)}")
    return name
