"""How much processor time and memory a long search may use."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROWS = 2000  # up to which a budget is the same
SECONDS, GIGABYTES = 600.0, 2.0  # up to so many rows
MORE_GIGABYTES = 2.0 / 8000  # for every row more


@dataclass(frozen=True)
class Budget:
    """Processor time and memory of a search.

    Attributes:
        seconds: processor time from the beginning. gigabytes: memory of the process.
        began: processor time at the beginning [s].
    """

    seconds: float
    gigabytes: float
    began: float

    @staticmethod
    def of(rows: int) -> Budget:
        """Return the budget of a search that begins now, in so many rows."""
        seconds = SECONDS * max(rows / ROWS, 1.0)
        return Budget(seconds, GIGABYTES + MORE_GIGABYTES * max(rows - ROWS, 0), time.process_time())

    def __str__(self) -> str:
        return f"{self.seconds / 60:.0f} min of processor time and {self.gigabytes:.1f} GB of memory"

    @property
    def spent(self) -> bool:
        """Return whether no more may be begun."""
        return time.process_time() - self.began > self.seconds or _in_use() > self.gigabytes


def _in_use() -> float:
    """Return the memory of this process [GB]; 0 where the system does not tell."""
    if sys.platform != "linux":
        return 0.0
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e9
