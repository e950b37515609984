"""Find the files that an MJCF makes MuJoCo open, and check them before MuJoCo opens any."""

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present, read_bytes, sha256

MOST_XML = 16 * 2**20  # bytes
MOST_ELEMENTS = 100_000
MOST_DEPTH = 200  # the limit of tinyxml2, which MuJoCo reads with, is 500
FOLDER_ATTRIBUTES = ("meshdir", "texturedir", "assetdir")
XML_ELEMENTS = ("include", "model")  # their `file` is itself MJCF


@dataclass
class _Search:
    """State of the search.

    Attributes:
        top: folder of the first file, to which MuJoCo's paths are relative.
        folder: folder of the robot; nothing outside of it may be opened.
        hashes: hash of every file.
        assets: meshes, textures, height fields and skins as (place, folder of the naming file, name).
        asset_folders: folders that any <compiler> names.
    """

    top: Path
    folder: Path
    hashes: dict[Path, str] = field(default_factory=dict)
    assets: list[tuple[str, Path, str]] = field(default_factory=list)
    asset_folders: set[str] = field(default_factory=lambda: {""})


def mjcf_files(path: Path, folder: Path) -> dict[Path, str]:
    """Return every file of an MJCF with its hash; those outside of the robot's folder are refused."""
    path = Path(path)
    search = _Search(path.parent, Path(os.path.realpath(folder)))
    if not Path(os.path.realpath(path)).is_relative_to(search.folder):
        raise InputError(f"{path}: lies outside of the robot's folder {search.folder}")
    _read(search, path, [])
    for where, base, name in search.assets:
        for start in {search.top, base}:
            for asset_folder in search.asset_folders:
                asset = _inside(search, where, start / asset_folder, name)
                if present(asset):
                    search.hashes[asset] = sha256(asset)
    return search.hashes


def _read(search: _Search, path: Path, trail: list[Path]) -> None:
    if path in trail:
        chain = " -> ".join(file.name for file in [*trail[trail.index(path) :], path])
        raise InputError(f"{path}: broken MJCF: includes itself ({chain})")
    if path in search.hashes:
        return
    content = read_bytes(path, MOST_XML)
    search.hashes[path] = hashlib.sha256(content).hexdigest()
    for where, element, name in _references(search, path, content, root="mujoco" if not trail else None):
        if element not in XML_ELEMENTS:
            search.assets.append((where, path.parent, name))
            continue
        for start in {search.top, path.parent}:
            if present(inner := _inside(search, where, start, name)):
                _read(search, inner, [*trail, path])


def _inside(search: _Search, where: str, start: Path, name: str) -> Path:
    """Return the path of a name, which has to lie inside the robot's folder."""
    path = start / name
    if os.path.isabs(name) or not Path(os.path.realpath(path)).is_relative_to(search.folder):
        raise InputError(
            f"{where}: found '{shortened(name)}', expected a path inside {search.folder}, the folder of the "
            "robot's description: copy the files into it and name them from there, or move the description "
            "to a folder that holds them all"
        )
    return Path(os.path.normpath(path))


def _references(search: _Search, path: Path, content: bytes, root: str | None) -> list[tuple[str, str, str]]:
    """Return place, element and name of every file that an MJCF file names."""
    parser = expat.ParserCreate()
    found: list[tuple[str, str, str]] = []
    depth = elements = 0

    def start(element: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        where = f"{path}: line {parser.CurrentLineNumber}, <{shortened(element)}>"
        if root is not None and elements == 1 and element != root:
            raise InputError(f"{where}: broken MJCF: expected <{root}>")
        if depth > MOST_DEPTH or elements > MOST_ELEMENTS:
            raise InputError(
                f"{where}: more than {MOST_ELEMENTS} elements, or {MOST_DEPTH} inside each other"
            )
        for key, value in attributes.items():
            place = f"{where}, attribute '{key}'"
            if bad := next((token for token in value.split() if _not_finite(token)), None):
                raise InputError(f"{place}: found '{shortened(bad)}', expected finite numbers")
            if key in FOLDER_ATTRIBUTES:
                _inside(search, place, path.parent, value)
                search.asset_folders.add(value)
            elif key.startswith("file") and value:
                found.append((place, element, value))

    def end(element: str) -> None:
        nonlocal depth
        depth -= 1

    def doctype(*declared: object) -> None:
        line = parser.CurrentLineNumber
        raise InputError(f"{path}: line {line}: found a document type declaration, which MJCF does not have")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content.decode("utf-8"), True)
    except expat.ExpatError as error:
        raise InputError(f"{path}: broken MJCF: {error}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text ({error.reason})") from None
    return found


def _not_finite(token: str) -> bool:
    try:
        return not abs(float(token)) < float("inf")
    except ValueError:
        return False
