"""Folders look alike from outside: say so when one of another kind is given."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.files import present

KINDS = {"measurement": "manifest.json", "plan": "plan.json", "run": "run.json", "rig": "rig.json"}
INSIDE = {"measurement": "measurements", "plan": "plan"}  # of a run folder
ADVICE = {
    ("plan", "measurement"): "a plan is measured first (`tulip simulate` does it in simulation)",
    ("measurement", "plan"): "it holds what was measured, not what is to be held",
    ("rig", "measurement"): "a rig is given with --rig",
}


def check_kind(folder: Path, wanted: str) -> None:
    """Refuse what is no folder, or a folder of another kind.

    Args:
        wanted: "measurement" or "plan".

    Raises:
        InputError: says which kind it is.
    """
    if not folder.is_dir():
        what = "found a file, expected a" if folder.exists() else "no such"
        raise InputError(f"{folder}: {what} {wanted} folder")
    if present(folder / KINDS[wanted]):
        return
    for kind, file in KINDS.items():
        if present(folder / file):
            inside = folder / INSIDE[wanted]
            there = f"there is one in it: {inside}" if present(inside / KINDS[wanted]) else ""
            advice = ADVICE.get((kind, wanted), there)
            raise InputError(
                f"{folder}: found a {kind} folder ({file}), expected a {wanted} folder ({KINDS[wanted]})"
                + (f"; {advice}" if advice else "")
            )
