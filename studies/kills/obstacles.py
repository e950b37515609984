"""Two writers of one name, a full disk and a folder that may not be written."""

from __future__ import annotations

import dataclasses
import os
import resource
import subprocess
from collections.abc import Callable
from pathlib import Path

from studies.kills.attempt import PATIENCE, Started, start
from studies.kills.commands import COMMANDS, Command
from studies.kills.results import Reference, again, clear, hidden, left

Obstacle = Callable[[Command, Path, Reference], str]
# Root may write everywhere, unless it gives up that right.
AS_ANYBODY = ("setpriv", "--bounding-set=-dac_override,-dac_read_search") if os.geteuid() == 0 else ()


def pairs() -> list[tuple[Command, Command]]:
    """Return every command together with itself, and simulations that share measurements or truth alone."""
    (simulate,) = (command for command in COMMANDS if len(command.results) > 1)
    return [
        *((command, command) for command in COMMANDS),
        (simulate, _renamed(simulate, "out", "other")),
        (simulate, _renamed(simulate, "truth.json", "other.json")),
    ]


def _renamed(command: Command, old: str, new: str) -> Command:
    def named(names: list[str]) -> list[str]:
        return [new if name == old else name for name in names]

    (last,) = named([command.last])
    results = tuple(named(list(command.results)))
    return dataclasses.replace(command, line=named(command.line), results=results, last=last)


def two_writers(pair: tuple[Command, Command], place: Path, wanted: tuple[Reference, Reference]) -> str:
    """Start both at once, of which one has to win, and return what is wrong."""
    for command in pair:
        clear(command, place)
    both = [start(command, place) for command in pair]
    faults = [fault for fault in map(_gone, both) if fault]
    won = [k for k, started in enumerate(both) if started.process.returncode in wanted[k].codes]
    faults += [what for k in won if (what := left(pair[k], place, wanted[k])) != "whole"]
    if len(won) != 1 and not (pair[0].resumes and won):  # the second may come late, and report again
        faults.append(f"{len(won)} of the two wrote")
    for k in {0, 1} - set(won):
        faults.append(_message(pair[k], both[k]))
        own = set(pair[k].results) - {name for j in won for name in pair[j].results}
        faults += [f"the refused one left {name}" for name in own if (place / name).exists()]
    faults += [f"{name} is left" for name in hidden(place)]
    return "; ".join(fault for fault in faults if fault)


def file_size_limit(command: Command, place: Path, wanted: Reference) -> str:
    """Allow no file of more than half of what the command's largest one has."""
    clear(command, place)
    sizes = [len(content) for content in _contents(wanted)]
    most = max(sizes) // 2
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    started = start(command, place, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard)))
    return _refused(command, place, wanted, started) or again(command, place, wanted)


def full_disk(command: Command, place: Path, wanted: Reference) -> str:
    """Give the command a disk of half of what its results need; only root can."""
    disk = place / "disk"
    disk.mkdir()
    size = sum(len(content) for content in _contents(wanted)) // 2
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)]
    try:
        subprocess.run(mount, check=True)
        try:
            return _refused(command, disk, wanted, start(_deeper(command), disk))
        finally:
            subprocess.run(["umount", str(disk)], check=True)
    finally:
        disk.rmdir()


def read_only_folder(command: Command, place: Path, wanted: Reference) -> str:
    """Let the command write into no folder but that of temporary files."""
    clear(command, place)
    place.chmod(0o555)
    try:
        return _refused(command, place, wanted, start(command, place, AS_ANYBODY))
    finally:
        place.chmod(0o755)


def _deeper(command: Command) -> Command:
    """The same command in a folder one level further down."""
    line = [f"../{word}" if word.startswith("../") else word for word in command.line]
    return dataclasses.replace(command, line=line)


def _contents(wanted: Reference) -> list[bytes]:
    return [content for content in wanted.files.values() if content is not None] or [bytes(100_000)]


def _refused(command: Command, place: Path, wanted: Reference, started: Started) -> str:
    """Return the faults of a command that could not write, and of the files it left."""
    fault = _gone(started) or _message(command, started)
    what = left(command, place, wanted)
    if not fault and what not in ("nothing", "begun"):
        return f"found {what}, expected nothing"
    if not fault and not command.resumes and hidden(place):
        return f"{', '.join(hidden(place))} is left"
    return fault


def _gone(started: Started) -> str:
    return "a process is left" if started.gone_after() > PATIENCE else ""


def _message(command: Command, started: Started) -> str:
    """Nothing, if the command ended with one sentence and its exit code."""
    code, said = started.process.returncode, started.said()
    lines = said.strip().splitlines()
    good = code == command.refusal and lines and lines[-1].startswith("tulip: ") and "Traceback" not in said
    return "" if good else f"exit code {code}: {said[-300:]!r}"
