"""Change texts in the files of a robot."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

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
