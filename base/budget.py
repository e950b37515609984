"""How much processor time and memory a long search may use."""

import os
import time
from dataclasses import dataclass, field
from pathlib import Path

ROWS = 2000  # up to which a budget is the same
ROOM = 1e-4  # GB a row, which the next calibration takes for a while
STATUS = Path("/proc/self/statm")  # in pages, where there is one


@dataclass(frozen=True)
class Budget:
    """Processor time and memory of a search in so many rows, which begins now."""

    rows: int
    began: float = field(default_factory=time.process_time)
    ended: list[bool] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Return the processor time [s]."""
        return 600.0 * max(self.rows / ROWS, 1.0)

    @property
    def gigabytes(self) -> float:
        """Return the memory of the process [GB]."""
        return 2.0 + 2.0 * max(self.rows - ROWS, 0) / 8000

    def __str__(self) -> str:
        return f"{self.seconds / 60:.0f} min of processor time and {self.gigabytes:.1f} GB of memory"

    @property
    def spent(self) -> bool:
        """Return whether no more may be begun, now or after memory was short once: something was left out."""
        pages = int(STATUS.read_text().split()[1]) if STATUS.exists() else 0
        used = 1e-9 * os.sysconf("SC_PAGE_SIZE") * pages
        late = time.process_time() - self.began > self.seconds
        if late or used + ROOM * self.rows > self.gigabytes:
            self.ended.append(True)
        return bool(self.ended)
