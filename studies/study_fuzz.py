"""Change 1,000 folders and 200 robots: a right result or one message? (docs/reliability.md; ten minutes)

Hypothesis draws the changes, for one seed always the same. A case that ends otherwise is shrunk and described
on stderr.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from functools import cache, partial
from multiprocessing.util import Finalize
from pathlib import Path

from studies.runner import Settings, header, row
from tests.fuzz.changes import drawn
from tests.fuzz.judge import KINDS, Judge

SETTINGS = Settings(seed=1_000, only=tuple(KINDS))
EXAMPLES = {"measurements": 8, "plan": 8, "robot": 4}  # of a kind, or as many as there are
OUTCOMES = ("accepted, right", "refused", "FAILED")


@cache
def judge_in(place: str) -> Judge:
    """Return the one judge of this process."""
    # A process that spawns names its own way of starting to the other, which does not know joblib's.
    multiprocessing.set_start_method("spawn", force=True)
    judge = Judge(Path(tempfile.mkdtemp(dir=place)), brief=False)
    # joblib ends a process that has grown, and waits for those that it has started.
    Finalize(None, lambda: judge.pool.shutdown(), exitpriority=1)
    return judge


def cases(place: str, target: str, kind: str, examples: int, stream: str) -> Counter[str]:
    """Count the outcomes of one kind of change."""
    try:
        messages = drawn(partial(judge_in(place).message, target, kind), examples, stream)
    except AssertionError:
        traceback.print_exc()
        return Counter({"FAILED": 1})
    return Counter("refused" if message else "accepted, right" for message in messages)


def study(settings: Settings) -> Iterator[str]:
    """Yield the table of outcomes by input."""
    kinds = [(target, kind) for target in settings.only for kind in KINDS[target]]
    with tempfile.TemporaryDirectory() as place:
        calls = [(place, t, k, settings.count(EXAMPLES[t]), f"{settings.seed} {t} {k}") for t, k in kinds]
        tallies = settings.parallel("kinds of change", cases, calls)
    yield header("input", "kinds of change", "cases", *OUTCOMES)
    for name in (*settings.only, "all"):
        found = [tally for (target, _), tally in zip(kinds, tallies, strict=True) if name in (target, "all")]
        counts = [sum(tally[outcome] for tally in found) for outcome in OUTCOMES]
        yield row(name, len(found), sum(counts), *counts)
