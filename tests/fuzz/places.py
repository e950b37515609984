"""What stands under a file's name: nothing, a folder, a pipe, a device, a link."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from tests.fuzz.cases import Expected, Rng, manifest_of, mutation, pick, refused, same


@mutation
def something_else_than_a_file(folder: Path, rng: Rng) -> Expected:
    name = pick(rng, (manifest_of(folder).name, "postures.parquet", "postures.csv"))
    path = folder / name
    content = path.read_bytes()
    kind = pick(rng, ("folder", "pipe", "zero", "full", "tty", "dangling", "loop", "socket"))
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind in ("zero", "full", "tty"):
        path.symlink_to(f"/dev/{kind}")
    elif kind == "dangling":
        path.symlink_to("nowhere")
    elif kind == "loop":
        path.symlink_to(name)
    else:
        here = os.getcwd()
        os.chdir(folder)  # a socket's name is short
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(name)
        os.chdir(here)
    assert content
    return refused(name)


@mutation
def a_missing_file(folder: Path, rng: Rng) -> Expected:
    names = pick(rng, ([manifest_of(folder).name], ["postures.parquet", "postures.csv"]))
    for name in names:
        (folder / name).unlink()
    return refused(names[0])


@mutation
def one_format_is_enough(folder: Path, rng: Rng) -> Expected:
    (folder / pick(rng, ("postures.parquet", "postures.csv"))).unlink()
    return same()


@mutation
def links_to_the_files(folder: Path, rng: Rng) -> Expected:
    """A store of large files may keep them elsewhere; their hashes say that they are the right ones."""
    store_folder = folder.parent / "elsewhere"
    store_folder.mkdir()
    for path in list(folder.iterdir()):
        moved = path.rename(store_folder / path.name)
        path.symlink_to(moved)
    return same()


@mutation
def no_permission(folder: Path, rng: Rng) -> Expected:
    path = pick(rng, (manifest_of(folder), folder / "postures.parquet", folder / "postures.csv", folder))
    path.chmod(0)
    return refused(path.name, "Permission denied")


@mutation
def no_folder(folder: Path, rng: Rng) -> Expected:
    moved = folder.rename(folder.with_name("moved"))
    kind = pick(rng, ("nothing", "file", "pipe", "loop", "empty"))
    if kind == "file":
        folder.write_bytes((moved / "postures.csv").read_bytes())
    elif kind == "pipe":
        os.mkfifo(folder)
    elif kind == "loop":
        folder.symlink_to(folder.name)
    elif kind == "empty":
        folder.mkdir()
    return refused(folder.name)
