"""The figures of a page; no other module imports plotly.

The browser gives texts and lines the page's colours.
"""

import gzip
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np
import plotly.graph_objects as go

from tulip_testbed.colours import ESTIMATE, MARGIN, MEASURED, NOMINAL, POLYGON, RESIDUAL, TRUTH
from tulip_testbed.identification.feasibility import place_polygon

MODEL_COLOURS = {"full": ESTIMATE, "simplified": POLYGON}
SYMBOLS = {"full": "circle", "simplified": "diamond"}


def of_model(model: str, size: int) -> dict[str, Any]:
    return {
        "mode": "markers",
        "marker": {"color": MODEL_COLOURS[model], "symbol": SYMBOLS[model], "size": size},
    }


@dataclass(frozen=True)
class Figure:
    """A figure of the page.

    Attributes:
        name: its id in the page. caption: below it. text: the description for a screen reader.
        json: plotly's, safe inside a script element.
        small: several may be placed next to each other.
    """

    name: str
    caption: str
    text: str
    json: str
    small: bool = False


def plotly_script() -> str:
    """Return plotly's JavaScript library without maps and 3D, to be included in the page.

    The file is that of the npm package plotly.js-cartesian-dist-min, with its licence, in the version that
    plotly for Python has.
    """
    packed = files("tulip_testbed.pages").joinpath("plotly-cartesian.min.js.gz").read_bytes()
    return gzip.decompress(packed).decode()


def figure(name: str, caption: str, text: str, drawn: go.Figure, height: int = 380) -> Figure:
    """Finish a figure: transparent, small margins, no text that a browser could read as the script's end."""
    content = drawn.to_dict()
    named = [line for line in content["data"] if line.get("name") and line.get("showlegend", True)]
    legend = content["layout"].get("showlegend", True) and len(named) > 1
    drawn.update_xaxes(title_standoff=6, title_font_size=12, automargin=True)
    drawn.update_yaxes(title_standoff=6, title_font_size=12)
    drawn.update_layout(
        template="none",
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        height=height,
        margin={"l": 60, "r": 15, "t": 50 if legend else 14, "b": 56},
        legend={"orientation": "h", "y": 1, "yref": "container", "yanchor": "top", "x": 0},
        font={"size": 13},
    )
    content = drawn.to_json()
    assert content is not None
    return Figure(name, caption, text, content.replace("</", "<\\/"))


def residual_norms(posture: np.ndarray, placement: np.ndarray, norms: dict[str, np.ndarray]) -> Figure:
    """Draw the norm of error of every row, (m,) [mm], by both models (the paper's Fig. 4)."""
    drawn = go.Figure()
    row = np.arange(1, len(posture) + 1)
    hover = np.column_stack([posture, placement])
    for model, values in norms.items():
        drawn.add_scatter(
            x=row,
            y=values,
            name=f"{model}, mean {values.mean():.2f} mm",
            **of_model(model, 7),
            customdata=hover,
            hovertemplate="posture %{customdata[0]}, placement %{customdata[1]}: %{y:.2f} mm",
        )
        drawn.add_hline(y=values.mean(), line={"color": MODEL_COLOURS[model], "width": 1})
    drawn.update_xaxes(title="row of the measurements, by time")
    drawn.update_yaxes(title="norm of error, mm", rangemode="tozero")
    text = "Norm of the error of every posture. " + "; ".join(
        f"{model} model: mean {values.mean():.2f}, largest {values.max():.2f} mm"
        for model, values in norms.items()
    )
    caption = "Norm of error per posture (eq. 12), as the paper's Fig. 4."
    return figure("residuals", caption, text + ".", drawn)


def errors_over_se(z: dict[str, tuple[list[int], np.ndarray]]) -> Figure:
    """Draw the error of every parameter over its stated standard error: numbers and (p,) by model."""
    drawn = go.Figure()
    for model, (numbers, values) in z.items():
        drawn.add_scatter(x=numbers, y=values, name=model, **of_model(model, 9))
    for level in (-2, 2):
        drawn.add_hline(y=level, line={"color": NOMINAL, "dash": "dash", "width": 1})
    drawn.update_xaxes(title="number of the parameter", tickangle=0)
    drawn.update_yaxes(title="error over standard error")
    worst = {model: float(np.abs(values).max()) for model, (_, values) in z.items()}
    text = "; ".join(f"{model} model: largest {value:.2f}" for model, value in worst.items())
    caption = (
        "Error (estimate minus truth) over the standard error that the estimator states; dashed: -2 and 2, "
        "which one parameter in twenty may exceed."
    )
    return figure("errors", caption, f"Errors over standard errors. {text}.", drawn)


def correlation_map(matrix: np.ndarray, pairs: list[tuple[list[int], str]]) -> Figure:
    """Draw the correlations (eq. 15), (p, p), as a map; marked are pairs that one joint distinguishes."""
    numbers = list(range(1, len(matrix) + 1))
    drawn = go.Figure(
        go.Heatmap(
            z=matrix,
            x=numbers,
            y=numbers,
            zmin=-1,
            zmax=1,
            colorscale=[[0, MEASURED], [0.5, "#F7F7F7"], [1, ESTIMATE]],  # apart for every kind of sight
            colorbar={"thickness": 12, "len": 0.7, "tickvals": [-1, -0.5, 0, 0.5, 1]},
            hovertemplate="%{x}, %{y}: %{z:.4f}<extra></extra>",
        )
    )
    frame = {"type": "rect", "line": {"color": "#000000", "width": 3}}
    for (a, b), _ in pairs:
        for x, y in ((a, b), (b, a)):
            drawn.add_shape(frame, x0=x - 0.5, x1=x + 0.5, y0=y - 0.5, y1=y + 0.5)
    drawn.update_xaxes(tick0=0, dtick=5, constrain="domain")
    drawn.update_yaxes(tick0=0, dtick=5, autorange="reversed", scaleanchor="x", constrain="domain")
    marked = "; ".join(f"{a} and {b}: {matrix[a - 1, b - 1]:.4f}" for (a, b), _ in pairs)
    caption = (
        "Correlations of the full model's parameters (eq. 15) by the regressor of the measured angles, "
        "independent of the estimator."
    )
    if pairs:
        said = "; ".join(f"{a}, {b}: {matrix[a - 1, b - 1]:.4f} ({joint})" for (a, b), joint in pairs)
        caption += f" Framed: the pairs that only one joint distinguishes, {said}."
    return figure("correlations", caption, f"Map of correlations. {marked}.", drawn, 520)


def support_polygon_figure(
    placement: int, plates: np.ndarray, polygon: np.ndarray, points: dict[str, np.ndarray], board: np.ndarray
) -> Figure:
    """Draw the plates, the support polygon and the centres of pressure from above (the paper's Fig. 2).

    The plates are poses, (2, 3) [m, m, rad], of boards by their corners, (4, 2) [m]; points, (n, 2) [m].
    """
    drawn = go.Figure()
    outlines = [(place_polygon(board, pose), MARGIN) for pose in plates]
    for outline, colour in [*outlines, (polygon, POLYGON)]:
        closed = 1e3 * np.vstack([outline, outline[:1]])
        line = {"color": colour, "width": 2}
        drawn.add_scatter(x=closed[:, 1], y=closed[:, 0], mode="lines", line=line, hoverinfo="skip")
    styles = {"CoP": (MEASURED, "circle"), "CoM, truth": (TRUTH, "x-thin-open")}
    for name, where in points.items():
        colour, symbol = styles[name]
        marker = {"color": colour, "size": 7, "symbol": symbol}
        drawn.add_scatter(x=1e3 * where[:, 1], y=1e3 * where[:, 0], mode="markers", name=name, marker=marker)
    drawn.update_layout(showlegend=False)
    drawn.update_xaxes(autorange="reversed", constrain="domain", title="y, mm")
    drawn.update_yaxes(scaleanchor="x", constrain="domain", title="x, mm")
    caption = f"Placement {placement}"
    text = f"Plates, support polygon and centres of pressure of placement {placement}, from above."
    return replace(figure(f"polygon-{placement}", caption, text, drawn, 300), small=True)


def interval_bars(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    return {"type": "data", "symmetric": False, "array": high - values, "arrayminus": values - low}


def with_intervals(
    name: str,
    caption: str,
    axis: str,
    rows: dict[str, list[tuple[int, float, list[float]]]],
    target: float,
    bounds: tuple[float, float],
) -> Figure:
    """Draw a quantity of every parameter (number, value, interval by model) with a target and bounds."""
    drawn = go.Figure()
    for k, (model, found) in enumerate(rows.items()):
        values = np.array([value for _, value, _ in found])
        ends = np.array([interval for _, _, interval in found])
        numbers = np.array([number for number, _, _ in found]) + 0.25 * k
        bars = interval_bars(values, *ends.T) | {"thickness": 1.5, "width": 0}
        drawn.add_scatter(x=numbers, y=values, name=model, error_y=bars, **of_model(model, 8))
    drawn.add_hline(y=target, line={"color": NOMINAL, "width": 1})
    for bound in bounds:
        drawn.add_hline(y=bound, line={"color": MEASURED, "dash": "dash", "width": 1})
    drawn.update_xaxes(title="number of the parameter", tickangle=0)
    drawn.update_yaxes(title=axis)
    spans = "; ".join(
        f"{model} model: {min(v for _, v, _ in r):.3f} to {max(v for _, v, _ in r):.3f}"
        for model, r in rows.items()
    )
    return figure(name, caption, f"{axis}, by parameter. {spans}.", drawn)


def error_boxes(model: str, numbers: Sequence[int], errors_mm: np.ndarray) -> Figure:
    """Draw the errors of all runs, (runs, p) [mm], as a box plot for each parameter."""
    drawn = go.Figure()
    for k, number in enumerate(numbers):
        style = {"marker": {"color": ESTIMATE, "size": 3}, "line": {"width": 1}, "showlegend": False}
        drawn.add_box(y=np.round(errors_mm[:, k], 4), name=str(number), **style)
    drawn.add_hline(y=0, line={"color": RESIDUAL, "width": 1})
    drawn.update_xaxes(title="number of the parameter")
    drawn.update_yaxes(title="estimate minus truth, mm")
    widest = int(np.argmax(errors_mm.std(axis=0)))
    text = (
        f"Errors of the {model} model over {len(errors_mm)} runs; the widest are those of parameter "
        f"{numbers[widest]}, s.d. {errors_mm[:, widest].std(ddof=1):.1f} mm."
    )
    return figure(f"boxes-{model}", f"Errors of all runs, {model} model.", text, drawn)


def error_bars(
    split: str, rows: dict[str, dict[str, tuple[float, tuple[float | None, float | None]]]]
) -> Figure:
    """Draw the r.m.s. error of every model with its interval [mm], along both axes, for one split."""
    drawn, text = go.Figure(), []
    for (axis, of_axis), colour in zip(rows.items(), (ESTIMATE, POLYGON), strict=True):
        values = np.array([value for value, _ in of_axis.values()])
        low, high = np.array([both for _, both in of_axis.values()], float).T  # NaN: none is drawn
        drawn.add_bar(
            x=values,
            y=list(of_axis),
            orientation="h",
            name=axis,
            marker={"color": colour},
            error_x=interval_bars(values, low, high),
        )
        text += [f"{model} in {axis} {value:.2f} mm" for model, (value, _) in of_axis.items()]
    drawn.update_xaxes(title="r.m.s. error, mm", rangemode="tozero")
    drawn.update_yaxes(autorange="reversed", automargin=True)
    caption = f"Centre of pressure of the postures left out by {split}; lines: 95 % intervals."
    said = f"R.m.s. error of the centre of pressure, left out by {split}: {', '.join(text)}."
    return replace(figure(split, caption, said, drawn), small=True)
