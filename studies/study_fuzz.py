"""Change 2,000 folders, robots, names and arguments: a right result or one message? (docs/studies/reliability.md)

Hypothesis draws the changes, for one seed always the same. A case that ends otherwise is shrunk and described
on stderr.
"""

from __future__ import annotations

import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from threading import get_ident

import joblib

from studies.runner import Settings, header, row
from tests.fuzz.changes import drawn
from tests.fuzz.judge import Judge
from tests.fuzz.targets import KINDS

SETTINGS = Settings(seed=1_000, only=tuple(KINDS))
EXAMPLES = {  # of a kind, or as many as there are
    "measurements": 8,
    "plan": 8,
    "robot": 4,
    "run": 3,
    "discovery": 3,
    "montecarlo": 3,
    "resume": 3,
    "rig": 4,
    "state": 2,
    "names": 2,
    "folders": 3,
    "arguments": 8,
}
OUTCOMES = ("accepted, right", "refused", "FAILED")


@cache
def judge_of(thread: int, place: str) -> Judge:
    """Return the judge of a thread, whose commands run in a process of its own."""
    return Judge(Path(tempfile.mkdtemp(dir=place)), brief=False)


def cases(place: str, target: str, kind: str, examples: int, stream: str) -> Counter[str]:
    """Count the outcomes of one kind of change."""
    try:
        messages = drawn(partial(judge_of(get_ident(), place).message, target, kind), examples, stream)
    except Exception:  # whatever a case raises is a failure to count; the other kinds go on
        print(f"\n{target}: {kind}", file=sys.stderr)
        traceback.print_exc()
        return Counter({"FAILED": 1})
    return Counter("refused" if message else "accepted, right" for message in messages)


def study(settings: Settings) -> Iterator[str]:
    """Yield the table of outcomes by input."""
    kinds = [(target, kind) for target in settings.only for kind in KINDS[target]]
    with tempfile.TemporaryDirectory() as place:
        calls = [(place, t, k, settings.count(EXAMPLES[t]), f"{settings.seed} {t} {k}") for t, k in kinds]
        with joblib.parallel_config(backend="threading"):  # a process of joblib's could not end the judge's
            tallies = settings.parallel("kinds of change", cases, calls)
    yield header("input", "kinds of change", "cases", *OUTCOMES)
    for name in (*settings.only, "all"):
        found = [tally for (target, _), tally in zip(kinds, tallies, strict=True) if name in (target, "all")]
        counts = [sum(tally[outcome] for tally in found) for outcome in OUTCOMES]
        yield row(name, len(found), sum(counts), *counts)
