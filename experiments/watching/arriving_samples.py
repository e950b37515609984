"""Rows of a motion while its samples arrive in a CSV file that grows.

A row comes with the first sample at or after the end of its window. It depends on the samples in the window
alone, and not on how many arrive at a time.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.watching.arriving_rows import Arrived, ArrivingRows, Line
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import OF_ROWS
from tulip_testbed.measurements.logs.series_reduction import reduced_window
from tulip_testbed.measurements.measurement_folder import mapped_samples, samples_from

TABLE = "motion.csv"


@dataclass(kw_only=True)
class ArrivingSamples(ArrivingRows):
    """Samples of a file that grows, and the rows that they give.

    Attributes:
        weight: of the robot [N]. window: length of a row [s].
    """

    held: ClassVar[bool] = False
    weight: float
    window: float
    _count: int = 0  # of rows
    _segments: list[int] = field(default_factory=list)
    _waiting: list[Measurements] = field(default_factory=list)  # samples since the next window's start
    _start: float = 0.0  # of the segment's first window
    _next: int = 0  # window of the segment

    def _taken(self, lines: Iterable[Line]) -> Iterator[Arrived]:
        for some, samples, problem in self._parsed(list(lines)):
            if samples is None:
                yield Arrived(some[0], None, problem)
                continue
            for k, line in enumerate(some):
                one = samples.take(np.array([k]))
                if problem := self._misplaced(one):
                    yield Arrived(line, None, f"{self.path}: line {line.number}: {problem}")
                else:
                    yield from self._with_sample(one, line)

    def _parsed(self, lines: list[Line]) -> Iterator[tuple[list[Line], Measurements | None, str]]:
        """Yield samples of lines that can be read together, and of each that cannot be read what is wrong."""
        if not lines:
            return
        try:
            mapped = mapped_samples(self.manifest, self._table(lines), self.where)
            yield lines, samples_from(self.manifest, mapped, self.where), ""
        except InputError as error:
            if len(lines) == 1:
                yield lines, None, self._problem(lines[0], error)
                return
            for half in (lines[: len(lines) // 2], lines[len(lines) // 2 :]):
                yield from self._parsed(half)

    def _misplaced(self, one: Measurements) -> str:
        """Say why a sample cannot follow those before it; "": it can."""
        segment, last = int(one.posture[0]), self._waiting[-1] if self._waiting else None
        if not self._segments or segment != self._segments[-1]:
            if segment in self._segments:
                return f"found segment {segment} again, expected the rows of a segment one after the other"
            return ""
        assert last is not None
        if one.time[0] <= last.time[0]:
            return f"found time {one.time[0]:g} after {last.time[0]:g}, expected a time that increases"
        for name in ("placement", "support"):
            if getattr(one, name)[0] != getattr(last, name)[0]:
                return f"found another {name}, expected one {name} in a segment"
        return ""

    def _with_sample(self, one: Measurements, line: Line) -> Iterator[Arrived]:
        """Take a sample in, and yield the row or the problem of a window that ends before it."""
        segment, time = int(one.posture[0]), float(one.time[0])
        if not self._segments or segment != self._segments[-1]:
            self._segments.append(segment)
            self._waiting, self._start, self._next = [], time, 0
        start = self._start + self.window * self._next
        self._waiting.append(one)
        if time < start + self.window - 1e-9:
            return
        found = reduced_window(joined(self._waiting), self.weight, start, self.window)
        if len(found.measurements):
            self._count += 1
            yield Arrived(line, replace(found.measurements, posture=np.array([self._count])))
        else:
            (cause,) = found.dropped
            problem = f"found no row from {start:.2f} s on, of a window {cause}"
            yield Arrived(line, None, f"{self.path}: line {line.number}: {problem}")
        # Windows without a sample give nothing.
        self._next = max(self._next + 1, int((time - self._start) / self.window + 1e-9))
        self._waiting = [one]


def joined(samples: list[Measurements]) -> Measurements:
    arrays = {
        name: np.concatenate([getattr(one, name) for one in samples])
        for name, values in vars(samples[0]).items()
        if name in OF_ROWS and values is not None
    }
    return replace(samples[0], **arrays)  # pyrefly: ignore[bad-argument-type]
