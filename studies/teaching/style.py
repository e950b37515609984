"""The look that all teaching pictures share: palette, letters, a white card that is legible in both modes."""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tulip_testbed.base.files import write_text

DOCS = Path(__file__).resolve().parents[2] / "docs" / "pictures"
X, Y, GREY = "#0072B2", "#E69F00", "#6b6b6b"

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
def card(width: float, height: float) -> Iterator[tuple[Figure, Axes]]:
    """Yield a figure of the common style and its axes; it is closed afterwards.

    Args:
        width, height: [inches].
    """
    with mpl.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(width, height), layout="constrained")
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
