"""A discovery: the gap before and after side by side, residuals over the experiment, the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.base.numbers import number
from tulip_testbed.colours import ESTIMATE, MARGIN, MEASURED, NOMINAL, rgb
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.experiments.discovery_curves import (
    Curve,
    LawCurve,
    law_curves,
    residual_curves,
    time_order,
)
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.discovery_tables import CHANNEL_NAMES, behind, explanation_table, gap_table
from tulip_testbed.pages.words import VERDICTS
from tulip_testbed.viewer.balance_series import ABOVE_GROUND, factor_for, from_above, log_balance
from tulip_testbed.viewer.layout import space_view
from tulip_testbed.viewer.plates_view import log_plates, log_subject_loads
from tulip_testbed.viewer.robot_view import log_geometry, log_motion
from tulip_testbed.viewer.subject import of_measurements

COLOURS = {"before": MEASURED, "after": ESTIMATE}
LAYERS = {"before": "as_measured", "after": "corrected"}  # rerun draws in the order of names, the last on top
PALE = (250, 250, 250)
BAR, STEP = 100.0, 14.0  # pixels: the longest bar, from bar to bar
WIDTH, HEIGHT = 100.0, 60.0  # pixels of the picture of a law; rerun draws y downwards
SPACE = 8.0  # pixels around it


@dataclass(frozen=True)
class DiscoveryViews:
    """The views before they are arranged: `space` and `plane` hold before, then after."""

    space: Sequence[rrb.View]
    plane: list[rrb.View]
    channels: list[rrb.View]
    evidence: list[rrb.View]
    text: rrb.View


def log_discovery(recording: rr.RecordingStream, discovery: Discovered) -> None:
    """Log a discovery, its postures in the order of time, and the layout of its views."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    subject = replace(of_measurements(discovery.measurements, discovery.robot), com={})
    rank = np.empty(len(subject), int)
    rank[time_order(discovery)] = np.arange(1, len(subject) + 1)
    index = rr.TimeColumn("posture", sequence=rank)
    log_geometry(recording, "world/robot", discovery.robot.visual_model)
    log_motion(recording, "world/robot", index, subject)
    log_plates(recording, "world/plates", index, subject)
    log_subject_loads(recording, "world/loads", index, subject)
    log_balance(recording, index, subject)
    assert subject.cop is not None
    residual = {side: discovery.residual(side)[:, :2] for side in sides(discovery)}
    factor = factor_for(residual["before"])
    reach = 1.1e3 * float(np.abs(residual["before"]).max())
    curves = residual_curves(discovery)
    for side, values in residual.items():
        _log_residual(recording, side, index, subject.cop, factor * values)
        _log_plane(recording, side, index, values, curves)
    _log_channels(recording, curves, sides(discovery))
    _log_evidence(recording, discovery.explanations)
    laws = law_curves(discovery)
    for k, law in enumerate(laws):
        log_law(recording, k, law)
    recording.log(
        "text",
        rr.TextDocument(discovery_text(discovery, factor), media_type=rr.MediaType.MARKDOWN),
        static=True,
    )
    others = {"before": "after", "after": "before"}
    space = [
        space_view(
            subject,
            f"{side.capitalize()}: residual {factor} times",
            ["$origin/**", f"- $origin/{others[side]}/**"],
        )
        for side in residual
    ]
    views = _views(discovery, space, reach)
    seen = [law_view(k, law) for k, law in enumerate(laws)]
    recording.send_blueprint(laid_out(replace(views, evidence=[*seen, *views.evidence])))


def sides(discovery: Discovered) -> tuple[str, ...]:
    """Return the sides that exist; "after" exists only if an explanation was found."""
    return ("before", "after") if discovery.explanations else ("before",)


def _log_residual(
    recording: rr.RecordingStream, side: str, index: rr.TimeColumn, cop: np.ndarray, drawn: np.ndarray
) -> None:
    """Log the CoP minus the estimated CoM as a line from the CoP, on the ground."""
    lines = np.stack([cop, cop + drawn], axis=1)
    flat = np.concatenate([lines, np.full((*lines.shape[:2], 1), 3 * ABOVE_GROUND)], axis=2)
    style = rr.LineStrips3D.from_fields(colors=rgb(COLOURS[side]), radii=0.005)
    recording.log(f"world/{side}/residual", style, static=True)
    recording.send_columns(f"world/{side}/residual", [index], rr.LineStrips3D.columns(strips=list(flat)))


def _log_plane(
    recording: rr.RecordingStream, side: str, index: rr.TimeColumn, residual: np.ndarray, curves: list[Curve]
) -> None:
    """Log residuals of all postures from above, this posture's large, and a circle of 95 % of the noise."""
    path, colour = f"plane/{side}", rgb(COLOURS[side])
    points = from_above(residual)
    small = rr.Points2D(points, colors=colour, radii=rr.Radius.ui_points(2))
    recording.log(f"{path}/all", small, static=True)
    large = rr.Points2D.from_fields(colors=(0, 0, 0), radii=rr.Radius.ui_points(5))
    recording.log(f"{path}/this", large, static=True)
    recording.send_columns(f"{path}/this", [index], rr.Points2D.columns(positions=points))
    sd = np.sqrt(np.mean([curve.sd**2 for curve in curves[:2]]))
    turn = np.linspace(0, 2 * np.pi, 73)
    ring = sd * np.sqrt(-2 * np.log(0.05)) * np.column_stack([np.cos(turn), np.sin(turn)])
    grey = rr.LineStrips2D([ring], colors=rgb(NOMINAL), radii=rr.Radius.ui_points(1))
    recording.log(f"{path}/noise", grey, static=True)


def _log_channels(recording: rr.RecordingStream, curves: list[Curve], of: tuple[str, ...]) -> None:
    """Log every channel's residuals over their noise as points, with lines at -2 and 2."""
    for k, curve in enumerate(curves):
        there = np.isfinite(curve.sd)
        index = rr.TimeColumn("posture", sequence=np.flatnonzero(there) + 1)
        for side in of:
            path = f"channels/{curve.channel}/{LAYERS[side]}/{k}"
            style = rr.SeriesPoints(
                colors=rgb(COLOURS[side]), markers="circle", marker_sizes=1.5, names=f"{curve.name}, {side}"
            )
            recording.log(path, style, static=True)
            values = getattr(curve, side)[there] / curve.sd[there]
            recording.send_columns(path, [index], rr.Scalars.columns(scalars=values))
        ends = rr.TimeColumn("posture", sequence=[1, len(there)])
        for level in (-2.0, 2.0):
            path = f"channels/{curve.channel}/noise/{level:+g}"
            recording.log(path, rr.SeriesLines(colors=rgb(NOMINAL), widths=1.0, names="noise"), static=True)
            recording.send_columns(path, [ends], rr.Scalars.columns(scalars=[level, level]))


def _log_evidence(recording: rr.RecordingStream, explanations: Sequence[Explanation]) -> None:
    """Log ln of the Bayes factor of every remaining explanation, as bars."""
    most = max((one.log_bayes_factor for one in explanations), default=1.0)
    for k, (one, short) in enumerate(zip(explanations, behind(explanations), strict=True)):
        factor = one.log_bayes_factor
        length = max(BAR * factor / most, 0.5) if most else 0.5
        bar = rr.LineStrips2D(
            [[[0.0, STEP * k], [length, STEP * k]]],
            colors=rgb(ESTIMATE if short == 0 else MARGIN),
            radii=0.15 * STEP,
        )
        recording.log(f"evidence/{k}/bar", bar, static=True)
        # A label stands below its point, in the point's colour.
        label = rr.Points2D(
            [[BAR / 2, STEP * (k + 0.15)]],
            colors=(40, 40, 40),
            radii=rr.Radius.ui_points(0.0),
            labels=f"{one.instance.label}: {factor:.1f}",
            show_labels=True,
        )
        recording.log(f"evidence/{k}/label", label, static=True)


def discovery_text(discovery: Discovered, factor: int) -> str:
    """Return the story, the gap and the explanations as Markdown."""
    lines = [f"## Verdict: {discovery.verdict}", VERDICTS[discovery.verdict], ""]
    lines += [f"{line}\n" for line in discovery.story]
    lines.append(gap_table(discovery.heldout).markdown())
    if discovery.explanations:
        lines += ["", explanation_table(discovery.explanations).markdown()]
    lines += [
        "",
        "Vermilion: as measured. Blue: with the found effects removed. The robot stands as measured. "
        f"Lines on the ground: CoP minus estimated CoM (eq. 12) from the CoP, {factor} times. Below, "
        "x up, y left; circle: 95 % of the noise. Channels: residuals over their noise, lines at -2 and 2; "
        "postures in the order of time.",
    ]
    return "\n".join(lines)


def _views(discovery: Discovered, space: Sequence[rrb.View], reach: float) -> DiscoveryViews:
    bounds = rrb.VisualBounds2D(x_range=[-reach, reach], y_range=[-reach, reach])
    plane: list[rrb.View] = [
        rrb.Spatial2DView(
            origin=f"plane/{side}",
            name=f"{side.capitalize()}: CoP minus CoM, ± {reach:.2g} mm",
            background=PALE,
            visual_bounds=bounds,
        )
        for side in sides(discovery)
    ]
    channels: list[rrb.View] = [
        rrb.TimeSeriesView(
            origin=f"channels/{channel}",
            name=f"{CHANNEL_NAMES[channel]}, over noise",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for channel in ("A", "F", "T", "C")
    ]
    count = len(discovery.explanations)
    evidence: list[rrb.View] = [
        rrb.Spatial2DView(
            origin="evidence",
            name="Evidence, ln of the Bayes factor",
            background=PALE,
            visual_bounds=rrb.VisualBounds2D(x_range=[-5, BAR + 5], y_range=[-STEP, STEP * count]),
        )
    ]
    text = rrb.TextDocumentView(origin="text", name="Verdict")
    return DiscoveryViews(space, plane, channels, evidence if count else [], text)


def laid_out(views: DiscoveryViews) -> rrb.Blueprint:
    """Arrange before and after side by side, the channels below each other, and the story on the right."""
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.Horizontal(*views.space), rrb.Horizontal(*views.plane), row_shares=[1.3, 1]),
            rrb.Vertical(*views.channels),
            rrb.Vertical(views.text, *views.evidence, row_shares=[3, *[1] * len(views.evidence)]),
            column_shares=[1.7, 1, 1.1],
        ),
        rrb.TimePanel(timeline="posture", state="collapsed", fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def log_law(recording: rr.RecordingStream, k: int, law: LawCurve) -> None:
    """Log the curve of law k over its range, the postures' errors, and the ends of both scales."""
    low = np.array([min(law.x.min(), law.at.min()), min(law.curve.min(), law.error.min())])
    high = np.array([max(law.x.max(), law.at.max()), max(law.curve.max(), law.error.max())])
    span = np.maximum(high - low, 1e-12)

    def placed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        part = (np.column_stack([x, y]) - low) / span
        return np.column_stack([WIDTH * part[:, 0], HEIGHT * (1 - part[:, 1])])

    points = rr.Points2D(placed(law.at, law.error), colors=rgb(MEASURED), radii=rr.Radius.ui_points(2))
    recording.log(f"law/{k}/residuals", points, static=True)
    strip = rr.LineStrips2D([placed(law.x, law.curve)], colors=rgb(ESTIMATE), radii=rr.Radius.ui_points(2))
    recording.log(f"law/{k}/curve", strip, static=True)
    ends = [
        ([0.0, HEIGHT + SPACE / 2], f"{number(low[0], '.3g')} {law.x_unit}"),
        ([WIDTH, HEIGHT + SPACE / 2], f"{number(high[0], '.3g')} {law.x_unit}"),
        ([-SPACE / 2, HEIGHT], f"{number(low[1], '.3g')} {law.unit}"),
        ([-SPACE / 2, 0.0], f"{number(high[1], '.3g')} {law.unit}"),
    ]
    labels = rr.Points2D(
        [place for place, _ in ends],
        colors=(40, 40, 40),
        radii=rr.Radius.ui_points(0.0),
        labels=[text for _, text in ends],
        show_labels=True,
    )
    recording.log(f"law/{k}/scales", labels, static=True)


def law_view(k: int, law: LawCurve) -> rrb.View:
    """Return the view of law k."""
    return rrb.Spatial2DView(
        origin=f"law/{k}",
        name=law.title,
        background=PALE,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-2 * SPACE, WIDTH + 2 * SPACE], y_range=[-SPACE, HEIGHT + 2 * SPACE]
        ),
    )
