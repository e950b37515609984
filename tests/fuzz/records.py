"""Edited run folders, and what has to come of each.

Whoever edits also lists the new hashes, so that they do not betray it.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.fuzz import changes, documents
from tests.fuzz.changes import EITHER, REFUSED, SAME, Change, Draw, Expected, Make, content
from tests.fuzz.documents import edited

RUN, RESULT, TRUTH = "run.json", "result.json", "truth.json"


def sealed(change: Change) -> Change:
    """List the files' new hashes in run.json after a change."""

    def both(folder: Path, draw: Draw) -> Expected:
        expected = change(folder, draw)
        with suppress(ValueError, OSError, TypeError, KeyError, AttributeError):  # nothing that lists hashes
            document = json.loads((folder / RUN).read_text())
            old = document["outputs"]
            new = {name: hash_of(folder / name, known) for name, known in old.items()}
            if new != old:
                (folder / RUN).write_text(json.dumps(document | {"outputs": new}))
        return expected

    return both


def hash_of(path: Path, known: Any) -> Any:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else known


def documents_of(*files: str) -> dict[str, Change]:
    """Return the kinds of change that any JSON file bears."""
    kinds: dict[str, tuple[Make, Expected]] = {
        **{name: (edited(edit), EITHER) for name, edit in documents.EDITS.items()},
        "no number": (documents.no_number, REFUSED),
        "truncated JSON": (changes.truncated, REFUSED),
        "spoiled JSON": (changes.spoiled, REFUSED),
        "flipped bytes": (changes.flipped, EITHER),
        "harmless JSON": (changes.harmless, SAME),
    }
    return {
        f"{kind} in {file}": sealed(content(make, expected, file))
        for file in files
        for kind, (make, expected) in kinds.items()
    }


def others(*files: str) -> dict[str, Change]:
    """Return what may stand in the place of a folder or of one of its files."""
    kinds = [kind for kind in (*changes.PLACES, "link") if kind != "nothing"]
    return {f"{kind} for a file": changes.stands(kind, *files) for kind in kinds}


RUN_KINDS: dict[str, Change] = {**documents_of(RUN, RESULT, TRUTH), **others(RUN, RESULT, TRUTH)}
