"""A matrix as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
import plotly.graph_objects as go

from tulip_testbed.pages.figures import plotly_script

CELL, MARGIN, LEAST = 9, 260, 500  # px


def heat_map(
    values: np.ndarray, labels: Sequence[str], title: str, unit: str, most: float, bound: float
) -> str:
    """Return a square matrix as an HTML heat map; dark is small, values below `bound` have another colour.

    Args:
        values: (n, n), 0 to `most`.
        bound: shown as the step from warm to cool.
    """
    step = bound / most
    # Small ones warm, the others from grey to white: distinguishable by colour-blind readers and in print.
    scale = [[0.0, "#7f2704"], [step, "#fdae6b"], [step, "#4a5a70"], [1.0, "#f7fbff"]]
    ticks = sorted({0.0, bound, *np.linspace(0.0, most, 4)[1:].tolist()})
    side = max(CELL * len(labels), LEAST) + MARGIN
    figure = go.Figure(
        go.Heatmap(
            z=values,
            x=list(labels),
            y=list(labels),
            zmin=0.0,
            zmax=most,
            colorscale=scale,
            colorbar={"title": {"text": unit, "side": "right"}, "thickness": 14, "tickvals": ticks},
            hovertemplate=f"%{{y}}<br>%{{x}}<br>%{{z:.1f}} {unit}<extra></extra>",
            xgap=0.5,
            ygap=0.5,
        )
    )
    font = {"size": 8}
    figure.update_layout(
        width=side + 60,
        height=side,
        margin={"l": MARGIN - 60, "b": MARGIN - 60, "t": 20, "r": 20},
        xaxis={"tickangle": -90, "tickfont": font, "dtick": 1, "showgrid": False},
        yaxis={"autorange": "reversed", "tickfont": font, "dtick": 1, "showgrid": False},
        plot_bgcolor="white",
    )
    drawn = figure.to_html(include_plotlyjs=False, full_html=False)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><script>{plotly_script()}</script></head>\n"
        f"<body><main><h1 style='font: bold 18px sans-serif'>{escape(title)}</h1>{drawn}</main></body></html>"
    )
