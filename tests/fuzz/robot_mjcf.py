"""Any element, attribute or byte of the MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz.cases import Expected, Rng, pick, refused
from tests.fuzz.robot_cases import PLATE, ROBOT, SCENE, robot_mutation

Tree = Any  # ElementTree's generic parameter came with Python 3.14's stubs only

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
