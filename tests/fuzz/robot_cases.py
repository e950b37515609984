"""Mutations of a robot's folder: its description (TOML) and its MJCF."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.cases import Mutation

ROBOT_MUTATIONS: dict[str, Mutation] = {}
TOML, ROBOT, SCENE, PLATE = "tulip.toml", "tulip.xml", "scene_plates.xml", "plate.xml"


def robot_mutation(function: Mutation) -> Mutation:
    ROBOT_MUTATIONS[function.__name__] = function
    return function


def replaced(path: Path, old: str, new: str, count: int = -1) -> None:
    text = path.read_text()
    assert old in text, old
    path.write_text(text.replace(old, new, count))


def insert(folder: Path, section: str, text: str, name: str = ROBOT) -> None:
    """Put text right after the opening tag of a section."""
    replaced(folder / name, f"<{section}>", f"<{section}>{text}", 1)
