"""Write tables as CSV and Markdown; the parts that all figures share."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.runner import header, row
from tulip_testbed.base.files import write_text

# Okabe and Ito: colour-blind readers can distinguish these.
BLUE, ORANGE, GREEN, RED, BLACK, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#000000", "#56B4E9"

Rows = list[dict[str, Any]]


def table(path: Path, rows: Rows) -> Iterator[str]:
    """Write a table as CSV and yield its lines as Markdown; figures have four significant digits.

    Args:
        rows: cells by their column; the first row has all columns.
    """
    texts = [{key: f"{v:.4g}" if isinstance(v, float) else v for key, v in r.items()} for r in rows]
    content = io.StringIO()
    writer = csv.DictWriter(content, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(texts)
    write_text(path, content.getvalue())
    yield f"\n{path.stem}\n\n{header(*rows[0])}"
    yield from (row(*cells.values()) for cells in texts)


def panels(count: int, height: float = 3.8, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` panels side by side in each row."""
    size = (4.8 * count, height * rows)
    figure, axes = plt.subplots(rows, count, figsize=size, layout="constrained", squeeze=False)
    for ax in axes.flat:
        ax.grid(True, which="major", alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, list(axes.flat)


def log_axis(ax: Axes, axis: str, ticks: Sequence[float] | np.ndarray) -> None:
    """Make the axis "x" or "y" logarithmic with these ticks alone."""
    ax.set(**{f"{axis}scale": "log"})
    ax.set(**{f"{axis}ticks": ticks, f"{axis}ticklabels": [f"{tick:g}" for tick in ticks]})
    ax.minorticks_off()


def save(figure: Figure, path: Path) -> None:
    """Write the picture without its date, so that the same figure gives the same file."""
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)
