"""Tell measurement, plan, run and rig folders apart, and name the kind in messages."""

from pathlib import Path

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import FOLDERS as KINDS
from tulip_testbed.base.files import is_folder, present

INSIDE = {"measurement": "measurements", "plan": "plan"}  # of a run folder
ADVICE = {
    ("plan", "measurement"): "measure the plan first, for example with `tulip simulate`",
    ("measurement", "plan"): "it holds measured postures, not planned ones",
    ("rig", "measurement"): "a rig corrects measurements: give their folder here, and the rig separately",
}


def check_kind(folder: Path, wanted: str) -> None:
    """Refuse a path that is no folder of the wanted kind, "measurement" or "plan"."""
    if not is_folder(folder):
        there = present(folder)
        found = "found a file, expected a" if there else "no such"
        table = wanted == "measurement" and there and folder.suffix in (".csv", ".parquet")
        advice = (
            f" with manifest.json and the table as postures{folder.suffix}; `check` of {folder.parent} "
            "lists what that one lacks"
        )
        raise InputError(f"{folder}: {found} {wanted} folder{advice if table else ''}")
    if present(folder / KINDS[wanted]):
        return
    inside = folder / INSIDE[wanted]
    there = f"there is one in it: {inside}" if present(inside / KINDS[wanted]) else ""
    for kind, file in KINDS.items():
        if present(folder / file):
            advice = ADVICE.get((kind, wanted), there)
            raise InputError(
                f"{folder}: found a {kind} folder ({file}), expected a {wanted} folder ({KINDS[wanted]})"
                + (f"; {advice}" if advice else "")
            )
    if wanted == "plan":  # a check lists all that a measurement folder lacks
        advice = f"; {there}" if there else ""
        raise InputError(f"{folder}: found no {KINDS[wanted]} in it, expected a plan folder{advice}")
