"""Write the scene as an XML tree without loss of digits; MuJoCo itself writes six."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from xml.etree.ElementTree import Element, fromstring

import mujoco
import numpy as np

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
