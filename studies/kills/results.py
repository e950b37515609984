"""The state of a command's output: whole, begun, nothing, or broken."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from studies.kills.attempt import PATIENCE, attempt
from studies.kills.commands import Command

ENDS = {".html": b"</html>", ".rrd": b"RRF2FOOT"}  # near the end of a whole file


@dataclass(frozen=True)
class Reference:
    """The files that two undisturbed runs of a command wrote.

    Attributes:
        files: every file's content; None where the two differ, by a time or a random name.
        codes: exit codes.
        total, writing: see `End`; of the second run.
    """

    files: dict[str, bytes | None]
    codes: tuple[int, ...]
    total: float
    writing: float


def clear(command: Command, place: Path) -> None:
    """Remove the results, nothing else."""
    for path in (place / name for name in command.results):
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)


def found(command: Command, place: Path) -> dict[str, bytes]:
    """Return the content of all files of the results."""
    inside = [path for name in command.results for path in [place / name, *(place / name).rglob("*")]]
    return {str(path.relative_to(place)): path.read_bytes() for path in inside if path.is_file()}


def hidden(place: Path) -> set[str]:
    """Return the names of what is hidden or temporary."""
    inside = (path.relative_to(place) for path in place.rglob("*"))
    return {str(path) for path in inside if path.name.startswith(".") or "tmp" in path.parts[:-1]}


def reference(command: Command, place: Path) -> Reference:
    """Run a command twice, undisturbed; it has to leave nothing but its results."""
    both = []
    for _ in range(2):
        clear(command, place)
        end = attempt(command, place)
        both.append((end, found(command, place)))
        assert end.code in (0, 1), f"{command.name}: {end.said}"
        assert (place / command.last).exists(), f"{command.name}: {end.said}"
        assert not hidden(place), f"{command.name}: {hidden(place)}"
    (first, before), (second, after) = both
    assert before.keys() == after.keys()
    same = {name: content if content == before[name] else None for name, content in after.items()}
    return Reference(same, (first.code, second.code), second.total, second.writing)


def left(command: Command, place: Path, wanted: Reference) -> str:
    """Return "nothing", "begun" or "whole", or what is wrong."""
    files = {name: content for name, content in found(command, place).items() if not _partial(name)}
    if command.resumes and _interrupted(files.get(f"{command.results[0]}/plan.json", b"{}")):
        return "begun"
    for name, content in files.items():
        if fault := _fault(name, content, wanted):
            return f"{name}: {fault}"
    if not any(Path(name).parts[0] == command.results[0] for name in files):
        return "nothing"
    if missing := wanted.files.keys() - files.keys():
        return "begun" if command.resumes else f"lacks {', '.join(sorted(missing))}"
    return _listed(command, files) or "whole"


def again(command: Command, place: Path, wanted: Reference, resume: bool = False) -> str:
    """Run a command once more, undisturbed, and return what is wrong then.

    Args:
        resume: go on from what is there.
    """
    if not resume:
        clear(command, place)
    end = attempt(command, place)
    what = left(command, place, wanted)
    if end.code not in wanted.codes or what != "whole":
        return f"once more: exit code {end.code}, {what}: {end.said[-300:]}"
    if end.gone > PATIENCE:
        return "once more: a process is left"
    return f"once more: {', '.join(sorted(hidden(place)))} is left" if hidden(place) else ""


def _interrupted(plan: bytes) -> bool:
    """Whether a plan is the best one so far of a search that Ctrl-C ended."""
    return json.loads(plan).get("made", {}).get("interrupted", False)


def _partial(name: str) -> bool:
    return any(part.startswith(".") for part in Path(name).parts)


def _fault(name: str, content: bytes, wanted: Reference) -> str:
    if name not in wanted.files:
        return "not one of the undisturbed run's"
    if wanted.files[name] is not None:
        return "" if content == wanted.files[name] else "differs from the undisturbed run's"
    ending = Path(name).suffix
    if ending == ".json":
        json.loads(content)
        return ""
    return "" if ENDS[ending] in content[-64:] else "has no end"


def _listed(command: Command, files: dict[str, bytes]) -> str:
    """Compare a run folder's files with the hashes in its run.json."""
    head = f"{command.results[0]}/"
    for name, expected in json.loads(files.get(f"{head}run.json", b"{}")).get("outputs", {}).items():
        if hashlib.sha256(files[head + name]).hexdigest() != expected:
            return f"{name}: differs from the hash in run.json"
    return ""
