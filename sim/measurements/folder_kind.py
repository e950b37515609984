"""Plan and measurement folders look alike from outside: say so when one is given for the other."""

from __future__ import annotations

from pathlib import Path

from sim.errors import InputError
from sim.files import present

KINDS = {"measurement": "manifest.json", "plan": "plan.json"}
ADVICE = {
    "measurement": "a plan is measured first (`tulip simulate` does it in simulation)",
    "plan": "it holds what was measured, not what is to be held",
}


def check_kind(folder: Path, wanted: str) -> None:
    """Refuse what is no folder, or a folder of the other kind.

    Args:
        wanted: "measurement" or "plan".

    Raises:
        InputError: says which kind it is.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such {wanted} folder")
    (other,) = KINDS.keys() - {wanted}
    if present(folder / KINDS[other]) and not present(folder / KINDS[wanted]):
        raise InputError(
            f"{folder}: found a {other} folder ({KINDS[other]}), expected a {wanted} folder "
            f"({KINDS[wanted]}); {ADVICE[wanted]}"
        )
