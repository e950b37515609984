"""Unusual and broken robots, description (TOML) and MJCF, and what has to come of each."""

import json
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.sax.saxutils import quoteattr

from tests.fuzz import changes
from tests.fuzz.changes import EITHER, REFUSED, SAME, Change, Draw, Expected, Make, content, one, refused
from tests.fuzz.documents import HOSTILE

TOML, ROBOT, PAPER = "tulip.toml", "tulip.xml", "table2.csv"
WHOLE_LINE = re.compile(r"^([\w-]+) = ([^\[\n]*|\[.*\]\s*(#.*)?)$", re.MULTILINE)  # a key with its value
STRANGE_TOML = (
    *("true", "-1", "0", "1e300", "nan", "-inf", "9" * 26, '"x"', '""', '"\\u0000"', "[]", "[[]]", "{}"),
    *("{ pair = [1, 1] }", "1979-05-27", "[1, 2, 3]", '["x", 1]', "[nan, 1]", "[-1e308, 1e308]"),
    *('"../../../etc/passwd"', '"' + "x" * 300 + '"', "0.0", "0.02", "1e-300"),
)
STRANGE_NUMBERS = ("nan", "inf", "-inf", "1e400", "0", "-1", "1e300", "-1e300", "1e-300", "1e10", "9" * 20)
STRANGE_XML = (
    *("", " ", "x", "0 0 0", "1 2 3 4 5 6 7 8 9", "0.1 x 0.2", "true", "../x", "\U0010ffff", "x" * 50_000),
    *STRANGE_NUMBERS,
)


END = "</mujoco>"
ENDLESS = (  # small to write, too large to compile
    "<worldbody>" + "<replicate count='1000'>" * 4 + "<site/>" + "</replicate>" * 4 + "</worldbody>",
    "<worldbody><replicate count='100000000'><site/></replicate></worldbody>",
    "<worldbody><flexcomp name='f' type='grid' count='400 400 400' spacing='1 1 1' dim='3'/></worldbody>",
    "<worldbody>" + "<body><geom size='1'/></body>" * 5_000 + "</worldbody>",
    "<asset><texture name='t' type='2d' builtin='flat' width='1000000' height='1000000'/></asset>",
    "<asset><hfield name='t' nrow='1000000' ncol='1000000' size='1 1 1 1'/></asset>",
    *(f"<size {key}='2000000000'/>" for key in ("nkey", "nuserdata", "nuser_body")),
    "<size memory='1000T'/>",
    "<custom><numeric name='n' size='2000000000'/></custom>",
    "<sensor><user name='u' dim='2000000000'/></sensor>",
)
DEEP = [f"<worldbody>{'<body>' * n}{'</body>' * n}</worldbody>" for n in (450, 100_000)]
BOMB = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
FOLDERS = [
    f'<compiler {kind}dir="{up}"/>' for kind in ("mesh", "texture", "asset") for up in ("..", "/", "a/../..")
]


def before_the_end(*texts: str) -> Make:
    return lambda text, draw: [text.replace(END, inserted + END) for inserted in texts]


def wrong_mjcf(text: str, draw: Draw) -> list:
    types = "<!DOCTYPE m SYSTEM 'file:///etc/passwd'>", f"<!DOCTYPE m [<!ENTITY e0 'x'>{BOMB}]>"
    return [text.replace(END, ""), text.replace("mujoco", "robot"), *(t + text for t in types)]


def lines(*values: str) -> Make:
    """Give a key another value; drop it with an empty one."""

    def make(text: str, draw: Draw) -> list:
        line = one(draw, WHOLE_LINE.finditer(text))
        return [text[: line.start()] + (new and f"{line[1]} = {new}") + text[line.end() :] for new in values]

    return make


def endless_toml(text: str, draw: Draw) -> list:
    return [f"{text}\nx = {nested * 100_000}" for nested in ("[", "{a=")]


def tree(edit: str) -> Make:
    """Drop, repeat or rename an element; drop an attribute or give it a strange value or number."""

    def make(text: str, draw: Draw) -> list:
        root = ET.fromstring(text)
        parent = one(draw, [e for e in root.iter() if len(e)])
        child = one(draw, parent)
        inner = [e for e in root.iter() if e is not root and e.attrib]
        physics = [e for e in inner if e.tag in ("inertial", "joint", "option")]
        element = one(draw, physics if edit == "number" and physics else inner)
        key = one(draw, element.attrib)
        if edit == "drop":
            parent.remove(child)
        elif edit == "repeat":
            parent.append(child)
        elif edit == "rename":
            child.tag = one(draw, ["nose", *sorted({e.tag for e in inner})])
        elif edit == "forget":
            del element.attrib[key]
        else:
            tokens = element.attrib[key].split()
            at = one(draw, [slice(None), *(slice(k, k + 1) for k in range(len(tokens)))])
            tokens[at] = [one(draw, STRANGE_NUMBERS if edit == "number" else STRANGE_XML)]
            element.attrib[key] = " ".join(tokens)
        return [ET.tostring(root)]

    return make


def elsewhere(suffix: str, file: str, old: str, new: str, **broken: bytes) -> Change:
    """Make a file name one that lies outside the robot's folder, is no file, or is broken."""

    def change(folder: Path, draw: Draw) -> Expected:
        outside = folder.with_name(f"outside.{suffix}")
        outside.write_bytes((folder / ROBOT).read_bytes())
        for name, made in broken.items():
            (folder / f"{name}.{suffix}").write_bytes(made)
        for name, there in {"link": outside, "loop": f"loop.{suffix}", "zero": "/dev/zero"}.items():
            (folder / f"{name}.{suffix}").symlink_to(there)
        os.mkfifo(folder / f"pipe.{suffix}")
        (folder / f"folder.{suffix}").mkdir()
        near = [f"{name}.{suffix}" for name in ("gone", "link", "loop", "zero", "pipe", "folder", *broken)]
        far = (str(outside), f"../{outside.name}", "../" * 50 + "etc/passwd", "x" * 300, "a\\u0000b")
        name = one(draw, (*near, *far))
        content(lambda text, d: [text.replace(old, new.format(name))], REFUSED, file)(folder, draw)
        return refused()

    return change


def includes_that_are_fine(folder: Path, draw: Draw) -> Expected:
    (folder / "parts").mkdir()
    (folder / "parts" / "more.xml").write_text("<mujocoinclude><custom/></mujocoinclude>")
    return content(before_the_end('<include file="parts/more.xml"/>'), SAME, ROBOT)(folder, draw)


TREE_EDITS = ("drop", "repeat", "rename", "forget", "strange", "number")
LOOP = {
    k: b'<mujocoinclude><include file="%s.xml"/></mujocoinclude>' % k[::-1].encode() for k in ("ab", "ba")
}
GARBAGE = b"\x89PNG\r\n\x1a\n\nv 0 0 0\nf 1 99999999 3\n" + b"\xd5" * 900
BROKEN = {"empty": b"", "many": b"\x00" * 80 + b"\xff\xff\xff\x7f" + b"\x00" * 100, "garbage": GARBAGE}
ITSELF = f'<asset><model name="m" file="{ROBOT}"/></asset>'
NAMED = {  # where an MJCF may name another file: that file's suffix, what may be broken about it
    '<include file="{}"/>': ("xml", LOOP),
    '<asset><model name="m" file="{}"/></asset>': ("xml", LOOP),
    '<asset><mesh name="m" file="{}"/></asset>': ("stl", BROKEN),
    '<asset><mesh name="m" file="{}" /></asset>': ("obj", BROKEN),
    '<asset><texture name="t" type="2d" file="{}"/></asset>': ("png", BROKEN),
    '<asset><hfield name="h" size="1 1 1 1" file="{}"/></asset>': ("png", BROKEN),
}
DESCRIPTIONS: dict[str, tuple] = {
    "drop a TOML key": (lines(""), EITHER),
    "strange TOML values": (lines(*STRANGE_TOML), EITHER),
    "truncated TOML": (changes.truncated, EITHER),
    "spoiled TOML": (changes.spoiled, REFUSED),
    "harmless TOML": (changes.harmless, SAME),
    "endless TOML": (endless_toml, REFUSED),
}
MODELS: dict[str, tuple] = {
    **{f"{edit} in MJCF": (tree(edit), EITHER) for edit in TREE_EDITS},
    "flipped bytes in MJCF": (changes.flipped, EITHER),
    "truncated MJCF": (changes.truncated, REFUSED),
    "spoiled MJCF": (changes.spoiled, REFUSED),
    "wrong MJCF": (wrong_mjcf, REFUSED),
    "deep MJCF": (before_the_end(*DEEP), REFUSED),
    "many elements": (before_the_end("<custom/>" * 200_000), REFUSED),
    "models without end": (before_the_end(*ENDLESS), REFUSED),
    "a model in itself": (before_the_end(ITSELF), refused("includes itself (tulip.xml -> tulip.xml)")),
    "a folder elsewhere": (before_the_end(*FOLDERS), refused("line")),
}


def renamed(old: str, news: tuple[str, ...]) -> Change:
    """Give a joint, a link or the robot another name, in both files."""

    def change(folder: Path, draw: Draw) -> Expected:
        new = one(draw, news)
        for file, write in ((ROBOT, quoteattr), (TOML, json.dumps)):
            text = (folder / file).read_text()
            (folder / file).write_text(text.replace(f'"{old}"', write(new)))
        return EITHER

    return change


ODD = ("\u0085", "a,b", "=1+1", "nan", "..", "-a", "a@2", "\U0001f9be", "x" * 5_000, "right_hip")
CALLED = ("left_knee", "left_foot", "torso", "TULip")
ROBOT_KINDS: dict[str, Change] = {
    **{f"{old} has another name": renamed(old, (*HOSTILE, *ODD)) for old in CALLED},
    **{name: content(*how, TOML) for name, how in DESCRIPTIONS.items()},
    **{name: content(*how, ROBOT) for name, how in MODELS.items()},
    **{f"{kind} for a robot's file": changes.stands(kind, TOML, ROBOT) for kind in changes.PLACES},
    **{f"{new} elsewhere": elsewhere(how[0], ROBOT, END, new + END, **how[1]) for new, how in NAMED.items()},
    "a model elsewhere": elsewhere("xml", TOML, f'"{ROBOT}"', '"{}"'),
    "a table of the paper elsewhere": elsewhere("csv", TOML, f'"{PAPER}"', '"{}"'),
    "a spoiled table of the paper": content(changes.spoiled, REFUSED, PAPER),
    "includes that are fine": includes_that_are_fine,
}
