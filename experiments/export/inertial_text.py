"""Replace inertias and places in the text of an MJCF or a URDF; every other byte stays as it is."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.identification.pseudo_inertia import central

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of MJCF's fullinertia
INDENT = b"  "
TAG = re.compile(rb"""(?:[^"'>]|"[^"]*"|'[^']*')*>""")  # quoted values may hold a '>'
POSITION = re.compile(rb"""(\spos\s*=\s*)("[^"]*"|'[^']*')""")


@dataclass
class _Element:
    """A body or a link in the text.

    Attributes:
        start: of its start tag, in bytes. after: end of the start tag.
        inertial: start and end of its <inertial>; None: there is none.
    """

    start: int
    after: int
    inertial: tuple[int, int] | None = None


def with_inertias(content: bytes, pseudo: Mapping[str, np.ndarray], where: Path) -> bytes:
    """Return the file with the inertias of some bodies (MJCF) or links (URDF) replaced.

    Args:
        content: of the file. pseudo: pseudo-inertias in the frames of the bodies by name, (4, 4) each.
        where: the file, for messages.

    Raises:
        InputError: the file itself does not hold a body, which may stand in an included file.
    """
    kind, elements = _elements(content, where)
    if missing := [name for name in pseudo if name not in elements]:
        raise InputError(
            f"{where}: found no <{kind} name={quoteattr(shortened(missing[0]))}>, expected every link with a "
            "mass in the file itself: write included, attached or replicated bodies into it"
        )
    changes = []
    for name, inertia in pseudo.items():
        element, text = elements[name], inertial_xml(inertia, kind)
        if element.inertial is not None:
            changes.append((*element.inertial, text))
        elif content[: element.after].endswith(b"/>"):  # an empty element gets an end tag
            closing = b">" + text + f"</{kind}>".encode()
            changes.append((element.after - 2, element.after, closing))
        else:
            changes.append((element.after, element.after, _new_line(content, element.start) + text))
    return _changed(content, changes)


def with_places(content: bytes, places: Mapping[str, tuple[np.ndarray, np.ndarray]], where: Path) -> bytes:
    """Return an MJCF with the places of some bodies in their parents replaced.

    Args:
        places: old and new place of bodies by name, (3,) [m] each.

    Raises:
        InputError: the file does not hold the old place as the body's `pos`, for example within a <frame>.
    """
    changes = []
    _, elements = _elements(content, where)
    for name, (old, new) in places.items():
        element = elements.get(name)
        tag = b"" if element is None else content[element.start : element.after]
        position = POSITION.search(tag)
        values = [] if position is None else position[2][1:-1].split()
        if element is None or position is None or not np.allclose(np.array(values, float), old, atol=1e-12):
            raise InputError(
                f'{where}: found no <body name={quoteattr(shortened(name))} pos="{joined(old)}">, expected '
                "its place in the body itself: write what a <frame> adds into it"
            )
        start = element.start + position.start(2)
        changes.append((start, start + len(position[2]), f'"{joined(new)}"'.encode()))
    return _changed(content, changes)


def inertial_spans(content: bytes, where: Path) -> list[tuple[int, int]]:
    """Return start and end of every <inertial> of a body or link, in bytes."""
    _, elements = _elements(content, where)
    return sorted(part.inertial for part in elements.values() if part.inertial is not None)


def inertial_xml(pseudo: np.ndarray, kind: str) -> bytes:
    """Return the <inertial> of a body of an MJCF ("body") or of a link of a URDF ("link")."""
    mass, center, inertia = central(pseudo)
    entries = [float(inertia[entry]) for entry in ENTRIES]
    if kind == "body":
        text = f'<inertial pos="{joined(center)}" mass="{mass!r}" fullinertia="{joined(entries)}"/>'
    else:
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        tensor = " ".join(f'{name}="{value!r}"' for name, value in zip(names, entries, strict=True))
        text = (
            f'<inertial><origin xyz="{joined(center)}" rpy="0 0 0"/><mass value="{mass!r}"/>'
            f"<inertia {tensor}/></inertial>"
        )
    return text.encode()


def _changed(content: bytes, changes: list[tuple[int, int, bytes]]) -> bytes:
    for start, end, text in sorted(changes, reverse=True):
        content = content[:start] + text + content[end:]
    return content


def joined(values: Iterable[float]) -> str:
    """Return numbers as an attribute holds them, exactly."""
    return " ".join(repr(float(value)) for value in values)


def _elements(content: bytes, where: Path) -> tuple[str, dict[str, _Element]]:
    """Return what bodies are called in the file, "body" or "link", and where each stands, by name."""
    parser = expat.ParserCreate()
    path: list[str] = []
    owners: list[_Element | None] = [None]  # of the elements on the path, and above the first
    elements: dict[str, _Element] = {}
    kinds: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        at, owner = parser.CurrentByteIndex, None
        path.append(tag)
        if len(path) == 1:
            kinds.append("link" if tag == "robot" else "body")
        of_urdf, of_mjcf = path == ["robot", "link"], path[:2] == ["mujoco", "worldbody"] and tag == "body"
        if (of_urdf or of_mjcf) and "name" in attributes:
            end_of_tag = TAG.match(content, at)
            assert end_of_tag is not None  # of a parsed start tag
            owner = elements[attributes["name"]] = _Element(at, end_of_tag.end())
        elif tag == "inertial" and owners[-1] is not None:
            owners[-1].inertial = (at, at)
        owners.append(owner)

    def end(tag: str) -> None:
        path.pop()
        owners.pop()
        if tag == "inertial" and (above := owners[-1]) is not None:
            assert above.inertial is not None
            at = parser.CurrentByteIndex
            closed = content.startswith(b"</inertial", at)  # otherwise an empty element, which ends here
            above.inertial = (above.inertial[0], content.index(b">", at) + 1 if closed else at)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(f"{where}: broken XML: {error}") from None
    return kinds[0], elements


def _new_line(content: bytes, start: int) -> bytes:
    """Return a line break with the indentation of a child of the element that starts here."""
    line = content[content.rfind(b"\n", 0, start) + 1 : start]
    ending = b"\r\n" if b"\r\n" in content else b"\n"
    return ending + line + INDENT if not line.strip() else b""
