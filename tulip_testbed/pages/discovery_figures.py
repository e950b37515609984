"""Figures of a discovery's page."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from tulip_testbed.base.numbers import number
from tulip_testbed.colours import ESTIMATE, MARGIN, MEASURED, NOMINAL, rgb
from tulip_testbed.discovery.experiment_information import Explanation, probabilities
from tulip_testbed.experiments.discovery_curves import Curve, LawCurve
from tulip_testbed.experiments.discovery_tables import behind
from tulip_testbed.pages.figures import Figure, figure

BEFORE, AFTER = MEASURED, ESTIMATE
RUNNER_UP = "#C4C9CF"
TICKS = [0.2, 0.5, *(digit * 10**k for k in range(5) for digit in (1, 2, 5))]  # of a logarithmic axis
WIDE = 1.96  # s.d. that 95 % of the noise stay within


def gap_figure(rows: Sequence[tuple[str, float, float, float]]) -> Figure:
    """Draw each channel before and after, relative to the noise, with the bound by chance alone."""
    drawn = go.Figure()
    names = [name for name, *_ in rows]
    for side, colour, symbol, at in (("before", BEFORE, "circle", 1), ("after", AFTER, "diamond", 2)):
        marker = {"color": colour, "symbol": symbol, "size": 12}
        values = [row[at] for row in rows]
        drawn.add_scatter(x=values, y=names, mode="markers", name=side, marker=marker)
    ticks = {"symbol": "line-ns-open", "size": 22, "color": NOMINAL, "line": {"width": 3}}
    floor = [row[3] for row in rows]
    drawn.add_scatter(x=floor, y=names, mode="markers", name="by chance up to", marker=ticks)
    drawn.update_xaxes(type="log", title="residual over noise, r.m.s.", tickvals=TICKS, ticktext=TICKS)
    drawn.update_yaxes(autorange="reversed", automargin=True)
    text = "; ".join(f"{name}: {before:.2f} before, {after:.2f} after" for name, before, after, _ in rows)
    caption = "Residuals on placements that took no part in the fit; 1 is the noise."
    return figure("gap", caption, text + ".", drawn, 320)


def curve_figure(k: int, curve: Curve, posture: np.ndarray, changed: bool) -> Figure:
    """Draw a residual over the noise, before and after, by posture number in the order of time, (m,)."""
    drawn = go.Figure()
    there = np.isfinite(curve.sd)
    row, sd, posture = np.arange(1, len(posture) + 1)[there], curve.sd[there], posture[there]
    band = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
    drawn.add_scatter(x=row, y=-WIDE * sd, **band)
    drawn.add_scatter(
        x=row, y=WIDE * sd, fill="tonexty", fillcolor=_clear(MARGIN), name="noise, 95 %", **band
    )
    sides = [("before", curve.before[there], BEFORE, "circle")]
    if changed:
        sides.append(("after", curve.after[there], AFTER, "diamond"))
    for side, values, colour, symbol in sides:
        marker = {"color": colour, "symbol": symbol, "size": 4}
        said = {"customdata": posture, "hovertemplate": "posture %{customdata}: %{y:.3f} " + curve.unit}
        drawn.add_scatter(x=row, y=np.round(values, 5), mode="markers", name=side, marker=marker, **said)
    drawn.update_xaxes(title="postures in the order of time")
    drawn.update_yaxes(title=curve.unit)
    drawn.update_layout(showlegend=False)
    spread = " before, ".join(number(float(np.nanstd(values)), ".3g") for _, values, _, _ in sides)
    text = f"{curve.name} over the experiment, s.d. {spread} {curve.unit}"
    text += " after." if changed else "."
    caption = f"{curve.channel}: {curve.name}"
    return replace(figure(f"residual-{k}", caption, text, drawn, 260), small=True)


def law_figure(k: int, law: LawCurve) -> Figure:
    """Draw the curve of a law, with the error that the residuals of every posture show."""
    drawn = go.Figure()
    bars = {"array": np.round(WIDE * law.sd, 5), "thickness": 0.6, "width": 0, "color": _clear(AFTER)}
    dots = {"mode": "markers", "name": "by the residuals", "marker": {"color": BEFORE, "size": 4}}
    drawn.add_scatter(
        x=np.round(law.at, 4), y=np.round(law.error, 5), error_y=bars | {"type": "data"}, **dots
    )
    line = {"mode": "lines", "name": "law", "line": {"color": AFTER, "width": 3}}
    drawn.add_scatter(x=np.round(law.x, 4), y=np.round(law.curve, 5), **line)
    drawn.update_xaxes(title=law.x_unit)
    drawn.update_yaxes(title=law.unit)
    low, high = float(law.curve.min()), float(law.curve.max())
    text = f"{law.title}: from {number(low, '.3g')} to {number(high, '.3g')} {law.unit}."
    caption = (
        "The law, and the error of the reading as the residuals of every posture show it with 95 % intervals."
    )
    return figure(f"law-{k}", caption, text, drawn, 320)


def plane_figure(side: str, x: np.ndarray, y: np.ndarray, sd: float, reach: float) -> Figure:
    """Draw the CoP minus the estimated CoM of all postures, (m,) [mm] each, from above.

    The reach of the picture, the same before and after, and the s.d. of the noise are in mm.
    """
    drawn = go.Figure()
    turn = np.linspace(0, 2 * np.pi, 73)
    radius = sd * np.sqrt(-2 * np.log(0.05))
    circle = {"color": NOMINAL, "width": 2}
    drawn.add_scatter(
        x=radius * np.cos(turn), y=radius * np.sin(turn), mode="lines", line=circle, hoverinfo="skip"
    )
    colour = BEFORE if side == "before" else AFTER
    drawn.add_scatter(x=np.round(y, 4), y=np.round(x, 4), mode="markers", marker={"color": colour, "size": 5})
    drawn.update_layout(showlegend=False)
    drawn.update_xaxes(range=[reach, -reach], title="y, mm", constrain="domain")
    drawn.update_yaxes(range=[-reach, reach], title="x, mm", scaleanchor="x", constrain="domain")
    rms = float(np.sqrt(np.mean((x**2 + y**2) / 2)))
    size = f"r.m.s. per axis {rms:.2f} mm"
    text = f"Centre of pressure minus estimated centre of mass of every posture, {side}: {size}."
    caption = f"{side.capitalize()}: CoP minus estimated CoM (eq. 12), all placements; {size}"
    return replace(figure(f"plane-{side}", caption, text, drawn, 340), small=True)


def evidence_figure(explanations: Sequence[Explanation], runners_up: Sequence[Explanation]) -> Figure:
    """Draw ln of the Bayes factor of every remaining explanation and of the runners-up, as bars."""
    drawn = go.Figure()
    rows = sorted(
        [(e, AFTER if b == 0 else MARGIN) for e, b in zip(explanations, behind(explanations), strict=True)]
        + [(one, RUNNER_UP) for one in runners_up],
        key=lambda row: (row[0].gap, -row[0].log_bayes_factor),
    )
    factors = np.array([one.log_bayes_factor for one, _ in rows])
    gaps = np.array([one.gap for one, _ in rows])
    share = np.concatenate([100 * probabilities(factors[gaps == gap]) for gap in np.unique(gaps)])
    which = " (gap {})" if gaps[-1] > gaps[0] else ""
    names = [f"{one.instance.label}{which.format(one.gap)} " for one, _ in rows]
    words = [f"{factor:.1f}, {percent:.0f} %" for factor, percent in zip(factors, share, strict=True)]
    style = {"marker": {"color": [colour for _, colour in rows]}, "textposition": "auto"}
    drawn.add_bar(x=factors, y=names, orientation="h", text=words, cliponaxis=False, **style)
    drawn.update_xaxes(title="ln of the Bayes factor", rangemode="tozero")
    drawn.update_yaxes(autorange="reversed", automargin=True)
    text = "; ".join(f"{name.strip()}: {said}" for name, said in zip(names, words, strict=True))
    caption = (
        "Evidence against no effect, and the probability of each explanation if all were as likely before. "
        "Blue: the best of each gap (dark) and what is within 3 of it."
    )
    if runners_up:
        caption += " Grey: the next best, by their predictions alone."
    return figure("evidence", caption, f"Evidence. {text}.", drawn, 150 + 34 * len(rows))


def _clear(colour: str) -> str:
    red, green, blue = rgb(colour)
    return f"rgba({red},{green},{blue},0.35)"
