"""Unusual names of joints, links, robots and folders, and what has to come of each."""

from __future__ import annotations

import json
import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

from tests.fuzz.changes import EITHER, REFUSED, SAME, Change, Draw, Expected, one
from tests.fuzz.robots import ROBOT, TOML

NAMES: dict[str, tuple[str, ...]] = {
    "brackets": ("[bold]x", "[/]", "[red]x[/red]", "{x}", "{{ 7 * 7 }}", "(x", "[link=file:///etc]x[/link]"),
    "tags": ("<b>x</b>", "<script>alert(1)</script>", "</td>", "&lt;x&gt;", "<!--", "]]>"),
    "ESC": ("\x1b[2J", "x\x1b]0;title\x07", "\x1bP", "\x1b"),
    "C1": ("\x9b31m", "x\x90y", "\x85"),
    "other directions": ("\u202eabc", "\u2066x\u2069", "x\u200f", "\u061cx", "a\u200bb", "\ufeffx"),
    "quotes": ("'", '"', "`x`", "'x'", '"""', "a'b\"c", "\\", "\\n", "$(x)", "%s"),
    "line ends": ("a\nb", "\n", "a\r\nb", "a\tb", "a\u2028b", "a\x0bb"),
    "blanks": (" ", "a b", " a", "a ", "\u00a0", "\u3000"),
    "dots and commas": ("a.b", ".", "..", "a,b", "a;b", "a:b", "a=b", "#a", "-a", "--a", "~", "*"),
    "letters": ("ä", "e\u0301", "膝", "колено", "\U0001f9be", "\U0010ffff", "ﬀ", "K\u0331"),
    "formulas": ("=1+1", "@x", "+1", "1e5", "nan", "null", "true", "0", "None"),
    "very long": ("x" * 200, "x y " * 50, "ä" * 120),
}
LONGER = ("x" * 5_000, "[" * 50_000, "ä" * 10_000)
JOINTS = ("right_ankle_roll", "left_knee")
LINKS = ("right_ankle", "left_foot", "torso")
TULIP = ("TULip",)


def in_robot(old: tuple[str, ...], news: tuple[str, ...]) -> Change:
    """Give a joint, a link or the robot another name, in both files."""

    def change(folder: Path, draw: Draw) -> Expected:
        name, new = one(draw, old), one(draw, news)
        for file, write in ((ROBOT, quoteattr), (TOML, json.dumps)):
            text = (folder / file).read_text()
            (folder / file).write_text(text.replace(f'"{name}"', write(new)))
        return EITHER

    return change


def of_folder(news: tuple[str, ...], expected: Expected) -> Change:
    """Move everything into a folder of another name."""

    def change(folder: Path, draw: Draw) -> Expected:
        moved = folder.rename(folder.with_name("moved"))
        folder.mkdir()
        name = one(draw, news)
        moved.rename(folder / ("x" if name in (".", "..") else name))
        return expected

    return change


NAME_KINDS: dict[str, Change] = {
    **{f"{kind} in a joint": in_robot(JOINTS, news) for kind, news in NAMES.items()},
    **{f"{kind} in a link": in_robot(LINKS, news) for kind, news in NAMES.items()},
    **{f"{kind} in a robot's name": in_robot(TULIP, news) for kind, news in NAMES.items()},
    "longer joints": in_robot(JOINTS, LONGER),
    "longer links": in_robot(LINKS, LONGER),
    "longer robots": in_robot(TULIP, LONGER),
    "no name": in_robot((*JOINTS, *LINKS), ("",)),
    "a name twice": in_robot((*JOINTS, *LINKS), ("right_hip", "left_hip_yaw", "left_ankle")),
}
FOLDER_KINDS: dict[str, Change] = {
    **{kind: of_folder(tuple(n.replace("/", "\u2215") for n in news), SAME) for kind, news in NAMES.items()},
    "not UTF-8": of_folder(
        (os.fsdecode(b"\xff"), os.fsdecode(b"a\xc3(b"), os.fsdecode(b"\xed\xa0\x80")), REFUSED
    ),
}
