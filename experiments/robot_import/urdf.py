"""Read a URDF: find its meshes in any format, and make MuJoCo keep all its links."""

import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened
from tulip_testbed.base.files import read_bytes

MOST_URDF = 16 * 2**20  # bytes
MOST_MESH = 64 * 2**20  # bytes
GYRATION = 0.05  # m: radius of gyration of a link whose inertia is impossible, assumed
LEAST_GYRATION = 1e-4  # m
TRIANGLE = 1e-3  # of the largest moment of inertia, by which it may exceed the others' sum
SCHEME = re.compile(r"^[a-z]+://")
NUMBERS = {
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort"),
    "dynamics": ("damping", "friction"),
    "mesh": ("scale",),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
LISTS = ("xyz", "rpy", "size", "scale")  # several numbers each
# Links without mass that move get the least that MuJoCo takes; `skeleton_of` takes it away again.
COMPILER = {
    "discardvisual": "false",
    "fusestatic": "false",
    "strippath": "false",
    "inertiafromgeom": "false",
    "balanceinertia": "true",
    "boundmass": "1e-6",
    "boundinertia": "1e-9",
}


# A model that is not yet compiled, joints that follow others, sentences on what was read, and meshes that are
# missing or cannot be read.
Parsed = tuple[mujoco.MjSpec, frozenset[str], list[str], list[str]]


def read_urdf(path: Path) -> Parsed:
    """Parse a URDF; numbers in it that are none are refused."""
    content = read_bytes(path, MOST_URDF)
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise InputError(f"{path}: found a document type declaration, which URDF does not have")
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise InputError(f"{path}: not a URDF file ({error})") from None
    _check(root, path)
    assumed = _with_possible_inertia(root)
    assets, missing = _with_hulls(root, path)
    for old in root.findall("mujoco"):
        root.remove(old)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", COMPILER)
    followers = frozenset(
        joint.get("name", "") for joint in root.findall("joint") if joint.find("mimic") is not None
    )
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"), assets=assets)
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"{path}: broken URDF: {shortened(error, 300)}") from None
    return spec, followers, assumed, missing


def _check(root: ET.Element, path: Path) -> None:
    """Refuse what MuJoCo would ignore or change without a word."""
    for element in root.iter():
        space, _, tag = element.tag.rpartition("}")
        if "xacro" in space:
            raise InputError(f"{path}: found <xacro:{tag}>, expected a URDF that `xacro` has expanded")
    for kind in ("link", "joint"):
        elements = root.findall(kind)
        count = Counter(element.get("name", "") for element in elements)
        for element in elements:
            name = element.get("name", "")
            where = f"{path}: {kind} '{shortened(name)}'"
            if count[name] > 1:
                raise InputError(f"{where}: found more than one {kind} of this name")
            for inner in element.iter():
                for key in NUMBERS.get(inner.tag, ()):
                    value = inner.get(key, "0")
                    tokens = value.split() if key in LISTS else [value]
                    at = f"{where}, <{inner.tag}>, attribute '{key}'"
                    if bad := [token for token in tokens if not _is_finite(token)]:
                        raise InputError(f"{at}: found '{shortened(bad[0])}', expected finite numbers")
                    if key == "effort" and float(value) < 0:
                        raise InputError(f"{at}: found {value}, expected 0 or more")


def _with_possible_inertia(root: ET.Element) -> list[str]:
    """Replace inertias that no body can have: they do not matter at rest, but MuJoCo refuses them."""
    impossible = []
    for link in root.findall("link"):
        mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
        if mass is None or inertia is None:
            continue
        xx, yy, zz, xy, xz, yz = (float(inertia.get(key) or 0) for key in NUMBERS["inertia"])
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        heavy = float(mass.get("value") or 0)
        least, middle, most = np.linalg.eigvalsh(tensor)
        is_body = least + middle > (1 - TRIANGLE) * most
        if is_body and least > 1e-6 * most > heavy * LEAST_GYRATION**2 * 1e-6:
            continue
        moment = heavy * GYRATION**2
        if heavy > 0:
            impossible.append(link.get("name", ""))
        for key in NUMBERS["inertia"]:
            inertia.set(key, repr(max(moment, 1e-9)) if key[1] == key[2] else "0")
    if not impossible:
        return []
    return [
        f"inertia of a ball of radius of gyration {1e3 * GYRATION:g} mm for links whose own is impossible: "
        f"{listed(impossible)} (it does not matter at rest)"
    ]


def _with_hulls(root: ET.Element, path: Path) -> tuple[dict[str, bytes], list[str]]:
    """Replace every mesh by its convex hull, and remove those that are missing."""
    names: dict[Path, str] = {}
    assets: dict[str, bytes] = {}
    missing = []
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename") or ""
            file = find_mesh(name, path)
            if file is not None and file not in names:
                content = hull_of_file(file)
                if content is not None:
                    names[file] = f"mesh{len(names)}.stl"
                    assets[names[file]] = content
            if file is None or file not in names:
                missing.append(name)
                link.remove(shape)
            else:
                mesh.set("filename", names[file])
    return assets, missing


def _is_finite(token: str) -> bool:
    try:
        return bool(np.isfinite(float(token)))
    except ValueError:
        return False


def find_mesh(name: str, urdf: Path) -> Path | None:
    """Find a mesh next to a URDF or in a folder above it, as `package://` paths mean it."""
    parts = Path(SCHEME.sub("", name).lstrip("/")).parts
    if ".." in parts:
        beside = urdf.parent / Path(*parts)
        return beside if beside.is_file() else None
    for folder in urdf.resolve().parents:
        for k in range(len(parts)):
            if (file := folder.joinpath(*parts[k:])).is_file():
                return file
    return None


def hull_of_file(file: Path) -> bytes | None:
    """Return the convex hull of a mesh file as a binary STL; None if it cannot be read."""
    import trimesh

    if file.stat().st_size > MOST_MESH:
        return None
    try:
        mesh = trimesh.load(file, force="mesh")
        hull = trimesh.convex.convex_hull(mesh)  # pyrefly: ignore
        if file.suffix.lower() == ".dae":
            hull.apply_transform(_upright(read_bytes(file)))
        return hull.export(file_type="stl")
    except Exception:  # a broken file may raise anything in any of its readers
        return None


def _upright(content: bytes) -> np.ndarray:
    """Return the transform of a COLLADA file's axes and unit to z up and metres, (4, 4)."""
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP", content)
    unit = re.search(rb"<unit[^>]*meter=[\"']([0-9.eE+-]+)", content)
    turns = {
        b"X": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        b"Y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        b"Z": np.eye(3),
    }
    out = np.eye(4)
    # Without a word on it COLLADA means y.
    out[:3, :3] = np.array(turns[axis[1] if axis else b"Y"]) * (float(unit[1]) if unit else 1.0)
    return out
