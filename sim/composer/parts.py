"""Split the laboratory's scene, with all its digits, into MJCF models that dm_control's entities can own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import mujoco
import numpy as np
from dm_control import mjcf

SIX_DIGITS = 5e-6
# Names of MjSpec's attributes by MJCF's, where they differ.
ALIASES = {
    "diaginertia": "inertia",
    "solreflimit": "solref_limit",
    "solimplimit": "solimp_limit",
    "solreffriction": "solref_friction",
    "solimpfriction": "solimp_friction",
}
INERTIAL = {"pos": "ipos", "quat": "iquat"}
# Sections that refer to bodies, ordered so that every name is defined before it is used.
SECTIONS = ("tendon", "actuator", "equality", "contact", "sensor")
REFERENCES = ("body", "joint", "geom", "site", "tendon", "actuator")


def scene_xml(spec: mujoco.MjSpec) -> Element:
    """Return the XML of a compiled spec with all digits of its named elements.

    The last digit matters: dry friction at rest depends on the path before it, so that a difference of
    1e-6 in a mass grows to 0.1 N in a cell.
    """
    root = fromstring(spec.to_xml())
    for element, own in _named(root, spec):
        _write_in_full(element, own, {})
        for part, wrap in zip(element, getattr(own, "path", ()), strict=False):
            _write_in_full(part, wrap, {})
        if (inertial := element.find("inertial")) is not None:
            _write_in_full(inertial, own, INERTIAL)
    return root


def _named(root: Element, spec: mujoco.MjSpec) -> Iterator[tuple[Element, object]]:
    """Yield the named elements, each with its counterpart in `spec`."""
    kinds: dict[str, Callable[[str], object]] = {
        "worldbody//body": spec.body,
        "worldbody//joint": spec.joint,
        "worldbody//geom": spec.geom,
        "worldbody//site": spec.site,
        "contact/pair": spec.pair,
        "tendon/*": spec.tendon,
        "equality/*": spec.equality,
        "actuator/*": spec.actuator,
    }
    for path, look_up in kinds.items():
        for element in root.findall(path):
            if name := element.get("name"):
                yield element, look_up(name)


def _write_in_full(element: Element, own: object, aliases: dict[str, str]) -> None:
    """Replace numbers by those of `own` where both agree to six digits."""
    for key, text in element.attrib.items():
        exact = getattr(own, aliases.get(key, key), getattr(own, ALIASES.get(key, key), None))
        try:
            written = np.array(text.split(), float)
            numbers = np.atleast_1d(np.asarray(exact, float))[: len(written)]
        except (TypeError, ValueError):
            continue
        for candidate in (numbers, numbers * np.pi / 180):  # MjSpec keeps the degrees of its file
            if candidate.shape == written.shape and np.allclose(written, candidate, SIX_DIGITS, 1e-12):
                element.set(key, " ".join(repr(float(number)) for number in candidate))
                break


@dataclass(frozen=True)
class Part:
    """A body of the scene's world as a model of its own.

    Attributes:
        root: its MJCF, with the names of the scene.
        position, quaternion: its pose in the world, (3,) [m] and (4,).
        free: whether it has a free joint, which the attachment frame takes over.
    """

    root: mjcf.RootElement
    position: np.ndarray
    quaternion: np.ndarray
    free: bool


@dataclass(frozen=True)
class SceneParts:
    """A scene split into parts.

    Attributes:
        arena: MJCF of everything that belongs to no part.
        parts: the parts by name.
        between: section and element of every element that connects parts to each other or to
            the world, such as
            contact pairs.
    """

    arena: mjcf.RootElement
    parts: dict[str, Part]
    between: tuple[tuple[str, Element], ...]


def split_scene(spec: mujoco.MjSpec, model: mujoco.MjModel, bodies: Mapping[str, str]) -> SceneParts:
    """Split a compiled scene into an arena and one part per body; keyframes are left out.

    Args:
        bodies: name of the world's body by the name of the part.
    """
    arena = scene_xml(spec)
    for keyframe in arena.findall("keyframe"):
        arena.remove(keyframe)
    common = copy.deepcopy(arena)
    for section in ("worldbody", *SECTIONS):
        for element in common.findall(section):
            common.remove(element)
    for sky in common.findall("asset/texture[@type='skybox']"):
        _child(common, "asset").remove(sky)
    taken = {name: _take(_child(arena, "worldbody"), body) for name, body in bodies.items()}
    owner = {
        e.get("name", ""): name for name, body in taken.items() for e in body.iter() if "name" in e.attrib
    }
    trees = {name: copy.deepcopy(common) for name in bodies}
    between = _share_out(arena, trees, owner)
    parts = {}
    for name, body in taken.items():
        free = body.find("joint[@type='free']")
        if free is not None:
            body.remove(free)
        for key in ("pos", "quat"):
            body.attrib.pop(key, None)
        trees[name].set("model", name)
        _child(trees[name], "worldbody").append(body)
        place = model.body(bodies[name])
        parts[name] = Part(
            _parse(trees[name], spec.modelfiledir), place.pos.copy(), place.quat.copy(), free is not None
        )
    return SceneParts(_parse(arena, spec.modelfiledir), parts, tuple(between))


def join(scene: SceneParts) -> None:
    """Add the elements that connect parts to the arena, after the parts were attached to it."""
    for section, element in scene.between:
        attributes: dict[str, object] = {}
        for key, value in element.attrib.items():
            kind = key.rstrip("12")
            roots = [part.root for part in scene.parts.values()] if kind in REFERENCES else []
            found = [e for root in roots if (e := root.find(kind, value)) is not None]
            attributes["dclass" if key == "class" else key] = found[0] if found else value
        getattr(scene.arena, section).add(element.tag, **attributes)


def _take(world: Element, name: str) -> Element:
    """Remove a body from the world, or from a frame in it; remove the frame if it is then empty."""
    for parent in (world, *world.findall("frame")):
        for body in parent.findall("body"):
            if body.get("name") == name:
                parent.remove(body)
                if parent.tag == "frame" and len(parent) == 0:
                    world.remove(parent)
                return body
    raise ValueError(f"no body '{name}' in the scene's world")


def _share_out(arena: Element, trees: dict[str, Element], owner: dict[str, str]) -> list[tuple[str, Element]]:
    """Move each element that refers to one part into that part; remove and return the others."""
    between = []
    for section in SECTIONS:
        for element in arena.findall(f"{section}/*"):
            values = {v for e in element.iter() for k, v in e.attrib.items() if k not in ("name", "class")}
            owners = {owner[value] for value in values if value in owner}
            if not owners:
                continue
            _child(arena, section).remove(element)
            if len(owners) > 1 or "world" in values:
                between.append((section, element))
            else:
                part = owners.pop()
                _child(trees[part], section).append(element)
                owner.setdefault(element.get("name", ""), part)
    return between


def _child(parent: Element, tag: str) -> Element:
    found = parent.find(tag)
    return SubElement(parent, tag) if found is None else found


def _parse(tree: Element, folder: str) -> mjcf.RootElement:
    _drop_unused(tree)
    return mjcf.from_xml_string(tostring(tree, encoding="unicode"), model_dir=folder)


def _drop_unused(tree: Element) -> None:
    """Remove default classes and assets that nothing refers to, since every part has a copy of all."""
    classes = {e.get(key) for e in tree.iter() if e.tag != "default" for key in ("class", "childclass")}
    for default in tree.findall("default"):
        _drop_classes(default, classes)
    for _ in range(2):  # a texture becomes unused when its material is removed
        used = {value for e in tree.iter() for key, value in e.attrib.items() if key != "name"}
        for asset in tree.findall("asset/*"):
            if "name" in asset.attrib and asset.get("name") not in used:
                _child(tree, "asset").remove(asset)


def _drop_classes(default: Element, used: set[str | None]) -> None:
    for inner in default.findall("default"):
        _drop_classes(inner, used)
        if inner.get("class") not in used and inner.find("default") is None:
            default.remove(inner)
