"""The look that all teaching pictures share: palette, letters, a white card that is legible in both modes."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

from tulip_testbed.base.files import write_text

DOCS = Path(__file__).resolve().parents[2] / "docs" / "pictures"
X, Y, GREY = "#0072B2", "#E69F00", "#6b6b6b"
WIDTH = 800 / 96  # inches: 800 pixels of a browser
DPI = 192  # of PNGs: two pixels for one of a browser

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.labelsize": 10.5,
    "legend.fontsize": 10.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "tulip",
}


@contextmanager
def card(rows: int, columns: int, width: float, height: float, **options: Any) -> Iterator:
    """Yield a figure of the common style and its axes (rows, columns); it is closed afterwards.

    Args:
        width, height: [inches]. options: of `plt.subplots`.
    """
    with mpl.rc_context(STYLE):
        figure, axes = plt.subplots(
            rows, columns, figsize=(width, height), layout="constrained", squeeze=False, **options
        )
        try:
            yield figure, axes
        finally:
            plt.close(figure)


def save_svg(figure: Figure, path: Path) -> Path:
    """Write a picture as SVG with its letters as text and without a date."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
    # A tenth of a point is enough for a dot; whoever lacks the font has another of the same width.
    text = re.sub(r'(<use [^>]*?x="-?\d+\.\d)\d*(" y="-?\d+\.\d)\d*', r"\1\2", content.getvalue())
    text = text.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    lines = (line.strip() for line in text.splitlines())
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, "\n".join(lines) + "\n")
    return path


def save_png(figure: Figure, path: Path) -> Path:
    """Write a picture as PNG of 256 colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    picture_of(figure, DPI).quantize(256).save(path, optimize=True)
    return path


def picture_of(figure: Figure, dpi: float) -> Image.Image:
    """Draw a figure as an image."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return Image.open(content).convert("RGB")
