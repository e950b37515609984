"""Compute what is missing and write it down as it comes."""

from __future__ import annotations

from collections.abc import Callable

from tulip_testbed.experiments.montecarlo.chunks import Chunks
from tulip_testbed.experiments.montecarlo.engine import Work, compute


def collect(chunks: Chunks, work: Work, advance: Callable[[int], None]) -> None:
    """Compute every missing chunk on the engine in force and write each as soon as it is there.

    Args:
        work: from run numbers to their columns.
        advance: called with the number of runs of each chunk that was written.

    Raises:
        InputError: a chunk could not be computed or written; those before it stay.
    """
    results = compute(work, (chunks.runs_of(index) for index in chunks.missing()))
    try:
        for columns in results:
            advance(chunks.write(columns))
    finally:
        results.close()
