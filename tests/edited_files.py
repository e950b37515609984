"""Write rig folders, and change texts in files."""

from collections.abc import Iterable
from pathlib import Path

from tulip_testbed.experiments.rig_folder import rig_files

BUILT = 'tulip.toml: scene = "scene_plates.xml" => plate = "plate.xml"'  # the scene is built


def change_texts(folder: Path, changes: Iterable[str]) -> None:
    """Replace the first occurrence of a text by another, as `FILE: TEXT => ANOTHER` says."""
    for change in changes:
        file, _, texts = change.partition(": ")
        texts = texts.replace("HUGE", "1" + "0" * 400).replace("\\n", "\n")
        old, _, new = texts.partition(" =>")
        text = (folder / file).read_text()
        assert old in text, change
        (folder / file).write_text(text.replace(old, new.removeprefix(" "), 1))


def write_rig(folder: Path, robot, effects) -> None:
    """Write a rig folder as a discovery writes it."""
    folder.mkdir()
    for name, text in rig_files(robot, effects).items():
        (folder / name).write_text(text)
