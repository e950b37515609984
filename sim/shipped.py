"""Paths of the files that come with the project; this module loads nothing else."""

from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent

ASSETS = _ROOT / "assets"
TULIP = ASSETS / "tulip_mjcf" / "tulip.toml"
PLATE = ASSETS / "tulip_mjcf" / "plate.xml"
PLANS = _ROOT / "experiments" / "plans"
PLAN_NAMES = ("random", "optimal", "mixed")


def plan_folder(plan: Path) -> Path:
    """Return the folder of a plan; a name of `PLAN_NAMES` is that shipped plan unless such a path exists."""
    return PLANS / plan if str(plan) in PLAN_NAMES and not plan.exists() else plan
