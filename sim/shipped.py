"""Paths of the files that come with the project; this module loads nothing else."""

from __future__ import annotations

from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent

ASSETS = _ROOT / "assets"
TULIP = ASSETS / "tulip_mjcf" / "tulip.toml"
PLATE = ASSETS / "tulip_mjcf" / "plate.xml"
PLANS = _ROOT / "experiments" / "plans"
