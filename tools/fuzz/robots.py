"""Ways to break a robot's folder: its description (TOML) and its MJCF."""

from __future__ import annotations

import os
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.fuzz.cases import Expected, Mutation, Rng, pick, refused, same

ROBOT_MUTATIONS: dict[str, Mutation] = {}
Tree = Any  # ElementTree's generic parameter came with Python 3.14's stubs only
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


# --- the description ---------------------------------------------------------------------------

WHOLE_LINE = re.compile(r"[\w-]+ = [^\[]*$|[\w-]+ = \[.*\]\s*(#.*)?$")  # a key with its value
STRANGE_TOML = (
    "true",
    "-1",
    "0",
    "1e300",
    "nan",
    "-inf",
    "99999999999999999999999999",
    '"x"',
    '""',
    '"\\u0000"',
    "[]",
    "[[]]",
    "{}",
    "{ pair = [1, 1] }",
    "1979-05-27",
    "[1, 2, 3]",
    '["x", 1]',
    "[nan, 1]",
    "[-1e308, 1e308]",
    '"../../../etc/passwd"',
    '"' + "x" * 300 + '"',
)


@robot_mutation
def drop_a_toml_key(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    lines = path.read_text().splitlines()
    keys = [
        k for k, line in enumerate(lines) if re.match(r"[\w-]+ = [^\[]*$|[\w-]+ = \[.*\]\s*(#.*)?$", line)
    ]
    del lines[pick(rng, keys)]
    path.write_text("\n".join(lines))
    return Expected("either", (TOML,))


@robot_mutation
def strange_toml_values(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    lines = path.read_text().splitlines()
    keys = [
        k for k, line in enumerate(lines) if re.match(r"[\w-]+ = [^\[]*$|[\w-]+ = \[.*\]\s*(#.*)?$", line)
    ]
    at = pick(rng, keys)
    lines[at] = f"{lines[at].split(' = ')[0]} = {pick(rng, STRANGE_TOML)}"
    path.write_text("\n".join(lines))
    return Expected("either", ())


@robot_mutation
def strange_toml_text(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    content = path.read_bytes()
    made = pick(
        rng,
        [
            b"",
            content[: int(rng.integers(1, 300))],
            content.replace(b"name", b"n\xff\xfeme", 1),
            content + b"\nx = " + b"[" * 100_000,
            content + b"\nx = " + b"{a=" * 100_000,
            content + b"#" * 2_000_000,
            content + b"\nname = 1\n",
            content.decode().encode("utf-16"),
            content + b"\x00",
            b"unknown = 1\n" + content,
            content.replace(b"swing_x =", b"swing_q ="),
            content.replace(b"[planning]", b"[planing]"),
            content.replace(b"[planning]", b"[planning]\nswing_z = [0, 1]"),
            content.replace(b"[-0.12, 0.12]", b"[0.12, -0.12]"),
            content.replace(b"[paper]", b"[paper]\nyear = 2013"),
        ],
    )
    path.write_bytes(made)
    return refused(TOML)


@robot_mutation
def harmless_toml_text(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    content = path.read_bytes()
    made = pick(rng, [b"\xef\xbb\xbf" + content, content.replace(b"\n", b"\r\n"), content + b"\n# \xc3\xa4"])
    path.write_bytes(made)
    return same()


@robot_mutation
def paths_that_lead_elsewhere(folder: Path, rng: Rng) -> Expected:
    key, name = pick(rng, (("model", ROBOT), ("scene", SCENE), ("plate", PLATE)))
    if key == "plate":
        replaced(folder / TOML, f'scene = "{SCENE}"', f'plate = "{PLATE}"')
    outside = folder.parent / "outside"
    shutil.copytree(folder, outside)
    file = folder / name
    kind = pick(rng, ("climb", "absolute", "link", "folder", "pipe", "device", "missing", "nul", "long"))
    path = {
        "climb": f"../outside/{name}",
        "absolute": str(outside / name),
        "device": "/dev/zero",
        "missing": "gone.xml",
        "nul": "a\\u0000b",
        "long": "x" * 300,
    }.get(kind, name)
    if kind == "link":
        file.unlink()
        file.symlink_to(outside / name)
    elif kind in ("folder", "pipe"):
        file.unlink()
        file.mkdir() if kind == "folder" else os.mkfifo(file)
    replaced(folder / TOML, f'{key} = "{name}"', f'{key} = "{path}"')
    return refused()


@robot_mutation
def scenes_that_are_built(folder: Path, rng: Rng) -> Expected:
    """From the robot and a plate, its own or the one that is shipped."""
    made = pick(rng, ("", f'plate = "{PLATE}"'))
    replaced(folder / TOML, f'scene = "{SCENE}"', made)
    return same()


@robot_mutation
def strange_drives(folder: Path, rng: Rng) -> Expected:
    value = pick(rng, (*STRANGE_TOML, "0.0", "0.02", "1e-300", "1e-3"))
    keys = ("[drives]\nwind_up", "[drives]\nbacklash", "[compliance]\nsole", "[compliance]\nsole_tilt")
    table = pick(rng, keys)
    path = folder / TOML
    path.write_text(f"{path.read_text()}\n{table} = {value}\n")
    return Expected("either", ())


@robot_mutation
def parameters_that_are_not_there(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    old, new = pick(
        rng,
        [
            ("[1, 5, 9,", "[26, 5, 9,"),
            ("[1, 5, 9,", "[0, 5, 9,"),
            ("[1, 5, 9,", "[5, 5, 9,"),
            ("[1, 5, 9,", "[1.0, 5, 9,"),
            ("pair = [12, 13]", "pair = [12, 99]"),
            ("pair = [12, 13]", "pair = [12, 12]"),
            ("pair = [12, 13]", "pair = [12, 13, 14]"),
            ('joint = "right_ankle_roll"', 'joint = "nose"'),
            ('"right_hip", "right_upper_leg"', '"nose", "right_upper_leg"'),
            ("postures_planned = 150", "postures_planned = 0"),
            ("wii = [4.2, 0.7]", "wii = [4.2]"),
            ("wii = [4.2, 0.7]", "wii = 4.2"),
            ("wii = [4.2, 0.7]", "wij = [4.2, 0.7]"),
            (f'scene = "{SCENE}"', f'scene = "{SCENE}"\nplate = "{PLATE}"'),
            ("[4.2, 3.6, 10.7]", "[4.2, 3.6]"),
            ("[4.2, 3.6, 10.7]", '["4.2", 3.6, 1]'),
            ('stance_foot = "right_foot"', 'stance_foot = "left_foot"'),
            ('stance_foot = "right_foot"', 'stance_foot = "nose"'),
            ('swing_foot = "left_foot"', 'swing_foot = "torso"'),
        ],
    )
    replaced(path, old, new)
    return refused(TOML if "foot" not in old or "left" in new else ROBOT)


@robot_mutation
def a_broken_paper_table(folder: Path, rng: Rng) -> Expected:
    path = folder / "table2.csv"
    content = path.read_bytes()
    made = pick(
        rng,
        [
            None,
            content.replace(b"number", b"nr"),
            content.replace(b"-10.96", b"nan"),
            content.replace(b"-10.96", b"many"),
            content.replace(b"1,-10.96", b"one,-10.96"),
            content.replace(b"1,-10.96", b"1"),
            b"\xff\xfe" + content,
            content.replace(b"-10.96", b'"' + b"x" * 200_000),
            b"pipe",
            b"outside",
        ],
    )
    if made is None or made == b"pipe":
        path.unlink()
    if made == b"pipe":
        os.mkfifo(path)
    elif made == b"outside":
        path.rename(folder.parent / "table2.csv")
        replaced(folder / TOML, '"table2.csv"', '"../table2.csv"')
    elif made is not None:
        path.write_bytes(made)
    return refused("table2.csv")


# --- any element or attribute ------------------------------------------------------------------

STRANGE_XML = (
    *("nan", "inf", "-inf", "1e400", "0", "-1", "1e300", "-1e300", "1e-300", "1e10", "99999999999999999999"),
    *("", " ", "x", "0 0 0", "1 2 3 4 5 6 7 8 9", "0.1 x 0.2", "true", "../x", "&#x10FFFF;", "x" * 50_000),
)


def _elements(tree: Tree) -> list[ET.Element]:
    return [element for element in tree.iter() if element.tag != "mujoco"]


def _rewrite(folder: Path, rng: Rng, change: Callable[[Tree], None]) -> Expected:
    path = folder / str(rng.choice([ROBOT, SCENE, PLATE], p=[0.7, 0.2, 0.1]))
    tree = ET.parse(path)
    change(tree)
    tree.write(path)
    return Expected("either", ())


@robot_mutation
def strange_attributes(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        element = pick(rng, [e for e in _elements(tree) if e.attrib])
        key = pick(rng, element.attrib)
        tokens = element.attrib[key].split()
        value = pick(rng, STRANGE_XML)
        if len(tokens) > 1 and rng.random() < 0.7:
            tokens[int(rng.integers(len(tokens)))] = value
            value = " ".join(tokens)
        element.attrib[key] = value

    return _rewrite(folder, rng, change)


@robot_mutation
def strange_inertia(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        found = [e for e in _elements(tree) if e.tag in ("inertial", "joint", "option") and e.attrib]
        element = pick(rng, found or _elements(tree))
        key = pick(rng, element.attrib or ["mass"])
        element.attrib[key] = pick(rng, STRANGE_XML[:11])

    return _rewrite(folder, rng, change)


@robot_mutation
def drop_attributes(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        element = pick(rng, [e for e in _elements(tree) if e.attrib])
        del element.attrib[pick(rng, element.attrib)]

    return _rewrite(folder, rng, change)


@robot_mutation
def drop_elements(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        parent = pick(rng, [e for e in tree.iter() if len(e)])
        parent.remove(pick(rng, parent))

    return _rewrite(folder, rng, change)


@robot_mutation
def repeat_elements(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        parent = pick(rng, [e for e in tree.iter() if len(e)])
        parent.append(pick(rng, parent))

    return _rewrite(folder, rng, change)


@robot_mutation
def rename_elements(folder: Path, rng: Rng) -> Expected:
    def change(tree: Tree) -> None:
        elements = _elements(tree)
        pick(rng, elements).tag = pick(rng, [*(e.tag for e in elements), "nose"])

    return _rewrite(folder, rng, change)


# --- text of the MJCF --------------------------------------------------------------------------


@robot_mutation
def strange_xml_text(folder: Path, rng: Rng) -> Expected:
    name = pick(rng, (ROBOT, SCENE, PLATE))
    path = folder / name
    content = path.read_bytes()
    bomb = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    made = pick(
        rng,
        [
            b"",
            content[: int(rng.integers(0, len(content) - 12))],
            content + content,
            content.replace(b"<mujoco", b"<robot", 1),
            content.replace(b"mujoco", b"robot"),
            content.replace(b"<worldbody>", b"<worldbody>\x00", 1),
            content.replace(b"<worldbody>", b"<worldbody><!-- \xff\xfe -->", 1),
            content.decode().encode("utf-16"),
            f'<!DOCTYPE m [<!ENTITY e0 "x">{bomb}]><mujoco model="&e11;"/>'.encode(),
            b'<!DOCTYPE m SYSTEM "file:///etc/passwd">' + content,
            b"<mujoco><worldbody>" + b"<body>" * 100_000 + b"</body>" * 100_000 + b"</worldbody></mujoco>",
            b"<mujoco><worldbody>" + b"<body>" * 450 + b"</body>" * 450 + b"</worldbody></mujoco>",
            b"<mujoco>" + b"<site/>" * 200_000 + b"</mujoco>",
            content + b" " * 2**24,
        ],
    )
    path.write_bytes(made)
    return refused(name)


@robot_mutation
def flip_bytes_in_mjcf(folder: Path, rng: Rng) -> Expected:
    path = folder / pick(rng, (ROBOT, SCENE, PLATE))
    content = bytearray(path.read_bytes())
    for at in rng.integers(0, len(content), int(rng.integers(1, 6))):
        content[at] ^= int(rng.integers(1, 128))
    path.write_bytes(content)
    return Expected("either", ())


# --- files that an MJCF names ------------------------------------------------------------------


@robot_mutation
def includes_that_lead_elsewhere(folder: Path, rng: Rng) -> Expected:
    outside = folder.parent / "outside"
    outside.mkdir()
    (outside / "more.xml").write_text("<mujocoinclude/>")
    (folder / "loop.xml").write_text('<mujocoinclude><include file="loop2.xml"/></mujocoinclude>')
    (folder / "loop2.xml").write_text('<mujocoinclude><include file="loop.xml"/></mujocoinclude>')
    (folder / "link.xml").symlink_to(outside / "more.xml")
    (folder / "round.xml").symlink_to("round.xml")
    os.mkfifo(folder / "pipe.xml")
    (folder / "folder.xml").mkdir()
    (folder / "zero.xml").symlink_to("/dev/zero")
    name = pick(
        rng,
        (
            *(
                "../outside/more.xml",
                str(outside / "more.xml"),
                "link.xml",
                "round.xml",
                "loop.xml",
                "gone.xml",
            ),
            *(
                "pipe.xml",
                "folder.xml",
                "zero.xml",
                "/etc/passwd",
                "x" * 300,
                ROBOT,
                "../" * 50 + "etc/passwd",
            ),
        ),
    )
    element = pick(rng, ("include", "model"))
    if element == "include":
        replaced(folder / ROBOT, "</mujoco>", f'<include file="{name}"/></mujoco>')
    else:
        insert(folder, "asset", f'<model name="more" file="{name}"/>')
    return refused()


@robot_mutation
def assets_that_lead_elsewhere(folder: Path, rng: Rng) -> Expected:
    outside = folder.parent / "outside"
    outside.mkdir()
    (outside / "a.stl").write_bytes(b"\x00" * 84)
    (folder / "link.stl").symlink_to(outside / "a.stl")
    os.mkfifo(folder / "pipe.stl")
    (folder / "zero.stl").symlink_to("/dev/zero")
    (folder / "empty.stl").touch()
    (folder / "garbage.stl").write_bytes(rng.bytes(1_000))
    (folder / "many.stl").write_bytes(b"\x00" * 80 + b"\xff\xff\xff\x7f" + b"\x00" * 100)
    (folder / "garbage.obj").write_bytes(b"v 0 0 0\nf 1 99999999 3\n")
    (folder / "garbage.png").write_bytes(b"\x89PNG\r\n\x1a\n" + rng.bytes(100))
    element, attribute, suffixes = pick(
        rng, (("mesh", "file", ("stl", "obj")), ("texture", "file", ("png",)), ("hfield", "file", ("png",)))
    )
    names = ["../outside/a.stl", str(outside / "a.stl"), "link.stl", "pipe.stl", "zero.stl", "gone.stl"]
    names += [p.name for p in folder.iterdir() if p.suffix[1:] in suffixes and p.name not in names]
    size = ' size="1 1 1 1"' if element == "hfield" else ' type="2d"' if element == "texture" else ""
    insert(folder, "asset", f'<{element} name="more" {attribute}="{pick(rng, names)}"{size}/>')
    return refused()


@robot_mutation
def folders_that_lead_elsewhere(folder: Path, rng: Rng) -> Expected:
    key, value = (
        pick(rng, ("meshdir", "texturedir", "assetdir")),
        pick(rng, ("..", "/tmp", "a/../../..", "/")),
    )
    replaced(folder / ROBOT, "<compiler ", f'<compiler {key}="{value}" ')
    return refused(ROBOT, "line")


@robot_mutation
def includes_that_are_fine(folder: Path, rng: Rng) -> Expected:
    (folder / "parts").mkdir()
    (folder / "parts" / "more.xml").write_text("<mujocoinclude><custom/></mujocoinclude>")
    replaced(folder / ROBOT, "</mujoco>", '<include file="parts/more.xml"/></mujoco>')
    return same()


# --- models that compile hugely, or not at all -------------------------------------------------


@robot_mutation
def models_without_end(folder: Path, rng: Rng) -> Expected:
    """Small to write, too large to compile."""
    nest = "<replicate count='1000'>" * 4 + "<site/>" + "</replicate>" * 4
    section, text = pick(
        rng,
        [
            ("worldbody", nest),
            ("worldbody", "<replicate count='100000000'><site/></replicate>"),
            ("worldbody", "<flexcomp name='f' type='grid' count='400 400 400' spacing='.1 .1 .1' dim='3'/>"),
            ("asset", "<texture name='t' type='2d' builtin='flat' width='1000000' height='1000000'/>"),
            ("asset", "<hfield name='t' nrow='1000000' ncol='1000000' size='1 1 1 1'/>"),
            ("actuator", "</actuator><size nkey='2000000000'/><actuator>"),
            ("actuator", "</actuator><size memory='1000T'/><actuator>"),
            ("actuator", "</actuator><size nuserdata='2000000000'/><actuator>"),
            ("actuator", "</actuator><size nuser_body='2000000000'/><actuator>"),
            ("actuator", "</actuator><custom><numeric name='n' size='2000000000'/></custom><actuator>"),
            ("sensor", "<user name='u' dim='2000000000'/>"),
            ("worldbody", "".join(f"<body name='b{k}'><geom size='1'/></body>" for k in range(5_000))),
        ],
    )
    insert(folder, section, text)
    return refused(ROBOT)


@robot_mutation
def robots_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    old, new = pick(
        rng,
        [
            ('mass="10.7"', 'mass="-10.7"'),
            ('mass="10.7"', 'mass="0"'),
            ('mass="10.7"', 'mass="1e9"'),
            ('diaginertia="0.25 0.23 0.075"', 'diaginertia="0 0 0"'),
            ('diaginertia="0.25 0.23 0.075"', 'diaginertia="1 1 100"'),
            ('<freejoint name="torso"/>', ""),
            ('<freejoint name="torso"/>', '<joint name="torso" axis="0 0 1"/>'),
            ('<joint name="left_knee" class', '<joint name="left_knee" type="slide" class'),
            ('<joint name="left_knee" class', '<joint name="left_knee" type="ball" class'),
            ('name="left_knee" class', 'name="right_knee" class'),
            ('<joint name="left_knee" class', "<joint class"),
            ('<body name="left_hip">', '<body name="right_hip">'),
            ('<body name="left_hip">', "<body>"),
            ('timestep="0.001"', 'timestep="0"'),
            ('timestep="0.001"', 'timestep="-1"'),
            ('timestep="0.001"', 'timestep="1e-12"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 9.81"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 0"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="1 0 -9.81"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 -1e300"'),
            ('name="right_foot_front_left"', 'name="toe"'),
            ('class="sole" pos="0.13 0.05 -0.058"', 'class="sole" pos="0.13 0.05 -0.05"'),
            ('<body name="torso" pos="0 0 0.6899">', '<body name="torso" pos="0 0 1e200">'),
            ('axis="0 0 1" range="-40 40"', 'axis="0 0 0" range="-40 40"'),
            ('range="-40 40"', 'range="40 -40"'),
            ('<body name="right_ankle" pos="0 0 -0.2732">', '<body name="right_ankle" quat="0 0 0 0">'),
            ("<actuator>", '<keyframe><key name="stand" qpos="1 2"/></keyframe><actuator>'),
        ],
    )
    replaced(folder / ROBOT, old, new, 1)
    return (
        refused()
        if "quat" not in new and "key" not in new and "1 1 100" not in new
        else Expected("either", ())
    )


@robot_mutation
def scenes_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    """The robot alone is fine, so that only what works on the plates is refused."""
    name, old, new = pick(
        rng,
        [
            (SCENE, 'name="floor" type', 'name="ground" type'),
            (SCENE, '<frame name="right_plate_place"', '<frame name="here"'),
            (SCENE, 'prefix="left_"', 'prefix="other_"'),
            (SCENE, '<include file="tulip.xml"/>', ""),
            (SCENE, "<default>", '<option timestep="0.5"/><default>'),
            (SCENE, "<default>", '<option gravity="0 0 9"/><default>'),
            (
                SCENE,
                '<model name="plate" file="plate.xml"/>',
                '<model name="plate" file="scene_plates.xml"/>',
            ),
            (PLATE, 'name="plate_top"', 'name="top"'),
            (PLATE, '<touch name="plate_front_left"', '<touch name="front"'),
            (PLATE, '<touch name="plate_front_left"', '<force name="plate_front_left"'),
            (PLATE, 'mass="3.5"', 'mass="-3.5"'),
            (PLATE, '<site name="plate_front_left"', '<site name="front"'),
        ],
    )
    replaced(folder / name, old, new, 1)
    return refused("scene")


@robot_mutation
def drives_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    old, new = pick(
        rng,
        [
            ('<motor name="left_knee" joint="left_knee" class="drive_90w_111"/>', ""),
            ('joint="left_knee" class="drive_90w_111"/>', 'joint="right_knee" class="drive_90w_111"/>'),
            ('joint="left_knee" class="drive_90w_111"/>', 'body="left_foot"/>'),
            ('forcerange="-25.4 25.4"', ""),
            ('forcerange="-25.4 25.4"', 'forcerange="-25.4 0"'),
        ],
    )
    replaced(folder / ROBOT, old, new, 1)
    return refused("scene")
