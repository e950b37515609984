"""The text of a model file: inertias replaced, every other byte as it is; an MJCF as a URDF."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.identification.pseudo_inertia import central, moved
from tulip_testbed.sim.control import joint_torques
from tulip_testbed.sim.robot import Robot, rotation_matrices

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of MJCF's fullinertia
INDENT = b"  "
FASTEST = 100.0  # rad/s: a URDF needs a limit of the speed, which an MJCF does not have
TAG = re.compile(rb"""(?:[^"'>]|"[^"]*"|'[^']*')*>""")  # quoted values may hold a '>'


@dataclass
class _Element:
    """A body or a link in the text: start and end of its tag, in bytes, and those of its <inertial>."""

    start: int
    after: int
    inertial: tuple[int, int] | None = None


def with_inertias(content: bytes, pseudo: Mapping[str, np.ndarray], where: Path) -> bytes:
    """Return the file with the pseudo-inertias of bodies (MJCF) or links (URDF) replaced, by name."""
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
    for start, end, text in sorted(changes, reverse=True):
        content = content[:start] + text + content[end:]
    return content


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


def written_urdf(robot: Robot, pseudo: np.ndarray) -> bytes:
    """Return a URDF of the robot with other inertias.

    The frame of a link is the body's frame, moved to its last hinge where that is elsewhere. A body with
    several hinges gets links without mass between them. Shapes, motors and sensors are left out.

    Args:
        pseudo: pseudo-inertias of the links in the frames of the bodies, (n_links, 4, 4).

    Raises:
        InputError: a hinge whose zero is not where the file draws it (`ref`), which a URDF cannot express.
    """
    model, torques = robot.model, joint_torques(robot.spec)
    rotations = rotation_matrices(model.body_quat)
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>"]
    if (pseudo[:, 3, 3] == 0).any() or (model.body_jntnum > 1).any():
        # MuJoCo refuses links that move without mass; other programs pass over this.
        lines.append('  <mujoco><compiler boundmass="1e-9" boundinertia="1e-12"/></mujoco>')
    taken = {model.body(k).name for k in range(model.nbody)}
    shift = np.zeros((model.nbody, 3))  # from the body's frame to the link's, in the body's axes
    for body in range(1, model.nbody):
        name, above = model.body(body).name, int(model.body_parentid[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = range(first, first + count)
        hinges = [joint for joint in joints if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE]
        for hinge in hinges:
            if zero := float(model.qpos0[model.jnt_qposadr[hinge]]):
                raise InputError(
                    f"{robot.model_file}: joint '{model.joint(hinge).name}': found ref {zero:g} rad, "
                    "expected 0 for a URDF; export an MJCF"
                )
        shift[body] = model.jnt_pos[hinges[-1]] if hinges else 0.0
        inertial = ""
        if pseudo[body - 1, 3, 3] > 0:
            to_link = np.eye(4)
            to_link[:3, 3] = -shift[body]
            inertial = inertial_xml(moved(pseudo[body - 1], to_link), "link").decode()
        lines.append(f"  <link name={quoteattr(name)}>{inertial}</link>")
        if not above:
            continue
        parent, start = model.body(above).name, model.body_pos[body] - shift[above]
        turn = _rpy(rotations[body])
        if not hinges:
            lines.append(_joint(f"{name}_fixed", "fixed", parent, name, start, turn))
        for k, hinge in enumerate(hinges):
            joint, anchor, child = model.joint(hinge).name, model.jnt_pos[hinge], name
            if k < len(hinges) - 1:
                child = f"{joint}_link"
                while child in taken:
                    child += "_"
                taken.add(child)
                lines.append(f"  <link name={quoteattr(child)}/>")
            origin = anchor - model.jnt_pos[hinges[k - 1]]
            if k == 0:
                origin = start + rotations[body] @ anchor
            limits = f'effort="{float(torques.get(joint, 0.0))!r}" velocity="{FASTEST!r}"'
            if model.jnt_limited[hinge]:
                low, high = map(float, model.jnt_range[hinge])
                limits = f'lower="{low!r}" upper="{high!r}" {limits}'
            more = f'<axis xyz="{joined(model.jnt_axis[hinge])}"/><limit {limits}/>'
            kind = "revolute" if model.jnt_limited[hinge] else "continuous"
            lines.append(_joint(joint, kind, parent, child, origin, turn if k == 0 else np.zeros(3), more))
            parent = child
    return ("\n".join([*lines, "</robot>"]) + "\n").encode()


def _joint(
    name: str, kind: str, parent: str, child: str, origin: np.ndarray, turn: np.ndarray, more: str = ""
) -> str:
    return (
        f'  <joint name={quoteattr(name)} type="{kind}"><parent link={quoteattr(parent)}/>'
        f'<child link={quoteattr(child)}/><origin xyz="{joined(origin)}" rpy="{joined(turn)}"/>{more}'
        "</joint>"
    )


def _rpy(axes: np.ndarray) -> np.ndarray:
    """Return a rotation as roll, pitch and yaw about fixed axes, (3,) [rad]."""
    yaw = np.arctan2(axes[1, 0], axes[0, 0])  # at a vertical x axis any yaw will do
    c, s = np.cos(yaw), np.sin(yaw)
    rest = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ axes
    return np.array([np.arctan2(-rest[1, 2], rest[1, 1]), np.arctan2(-rest[2, 0], rest[0, 0]), yaw])
