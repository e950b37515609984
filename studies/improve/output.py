"""Tables as CSV and Markdown, and what the figures share."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.runner import header, row

# Okabe and Ito: told apart by colour-blind readers.
BLUE, ORANGE, GREEN, RED, BLACK, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#000000", "#56B4E9"

Rows = list[dict[str, Any]]


def show(title: str, rows: Rows) -> None:
    """Print a table as Markdown."""
    print(f"\n{title}\n\n{header(*rows[0])}")
    for entry in rows:
        print(row(*(_text(value) for value in entry.values())), flush=True)


def write_csv(path: Path, rows: Rows) -> None:
    """Write a table; four significant digits, the first row's keys as names."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows({key: _text(value) for key, value in entry.items()} for entry in rows)


def panels(count: int, height: float = 3.8, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels side by side in each row."""
    size = (4.8 * count, height * rows)
    figure, axes = plt.subplots(rows, count, figsize=size, layout="constrained", squeeze=False)
    for ax in axes.flat:
        ax.grid(True, which="major", alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, list(axes.flat)


def save(figure: Figure, path: Path) -> None:
    """Write the picture; without the date, so that the same figure gives the same file."""
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _text(value: Any) -> Any:
    return f"{value:.4g}" if isinstance(value, float) else value
