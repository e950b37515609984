"""Files that an MJCF names: elsewhere, without end, broken."""

from __future__ import annotations

import os
from pathlib import Path

from tests.fuzz.cases import Expected, Rng, pick, refused, same
from tests.fuzz.robot_cases import ROBOT, insert, replaced, robot_mutation


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
