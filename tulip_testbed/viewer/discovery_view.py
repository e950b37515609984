"""A discovery: the gap before and after side by side, residuals over the experiment, the evidence."""

from collections.abc import Sequence
from dataclasses import replace

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
from tulip_testbed.viewer.balance_series import ABOVE_GROUND, factor_for, from_above
from tulip_testbed.viewer.canvas import (
    CIRCLE,
    Canvas,
    blueprint,
    flat,
    log_label,
    log_markdown,
    plane_view,
    styled,
)
from tulip_testbed.viewer.postures_view import log_standing
from tulip_testbed.viewer.robot_view import space_view
from tulip_testbed.viewer.subject import of_measurements

COLOURS = {"before": MEASURED, "after": ESTIMATE}
LAYERS = {"before": "as_measured", "after": "corrected"}  # rerun draws in the order of names, the last on top
DARK = (40, 40, 40)  # of labels
BAR, STEP = 100.0, 14.0  # pixels: the longest bar, from bar to bar
WIDTH, HEIGHT = 100.0, 60.0  # pixels of the picture of a law; rerun draws y downwards
SPACE = 8.0  # pixels around it


def log_discovery(recording: rr.RecordingStream, discovery: Discovered) -> None:
    """Log a discovery, its postures in the order of time, and the layout of its views."""
    subject = replace(of_measurements(discovery.searched, discovery.robot), com={})
    rank = np.empty(len(subject), int)
    rank[time_order(discovery)] = np.arange(1, len(subject) + 1)
    canvas = log_standing(recording, subject, rank)
    assert subject.cop is not None
    residual = {side: discovery.residual(side)[:, :2] for side in sides(discovery)}
    factor = factor_for(residual["before"])
    reach = 1.1e3 * float(np.abs(residual["before"]).max())
    curves = residual_curves(discovery)
    for side, values in residual.items():
        lines = np.stack([subject.cop, subject.cop + factor * values], axis=1)
        ground = np.concatenate([lines, np.full((*lines.shape[:2], 1), 3 * ABOVE_GROUND)], axis=2)
        style = styled(COLOURS[side], 0.005)
        canvas.rows(f"world/{side}/residual", rr.LineStrips3D, style, strips=list(ground))
        _log_plane(canvas, side, values, curves)
    _log_channels(recording, curves, sides(discovery))
    _log_evidence(recording, discovery.explanations)
    laws = law_curves(discovery)
    for k, law in enumerate(laws):
        log_law(recording, k, law)
    log_markdown(recording, discovery_text(discovery, factor))
    others = {"before": "after", "after": "before"}
    space = [
        space_view(
            subject,
            f"{side.capitalize()}: residual {factor} times",
            ["$origin/**", f"- $origin/{others[side]}/**"],
        )
        for side in residual
    ]
    plane = [
        plane_view(
            f"plane/{side}",
            f"{side.capitalize()}: CoP minus CoM, ± {reach:.2g} mm",
            (-reach, reach),
            (-reach, reach),
        )
        for side in residual
    ]
    channels = [
        rrb.TimeSeriesView(
            origin=f"channels/{channel}",
            name=f"{CHANNEL_NAMES[channel]}, over noise",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for channel in ("A", "F", "T", "C")
    ]
    x, y = (-2 * SPACE, WIDTH + 2 * SPACE), (-SPACE, HEIGHT + 2 * SPACE)
    told: list[rrb.View] = [rrb.TextDocumentView(origin="text", name="Verdict")]
    told += [plane_view(f"law/{k}", law.title, x, y) for k, law in enumerate(laws)]
    if count := len(discovery.explanations):
        name = "Evidence, ln of the Bayes factor"
        told.append(plane_view("evidence", name, (-5, BAR + 5), (-STEP, STEP * count)))
    before_and_after = rrb.Vertical(rrb.Horizontal(*space), rrb.Horizontal(*plane), row_shares=[1.3, 1])
    story = rrb.Vertical(*told, row_shares=[3, *[1] * (len(told) - 1)])
    columns = before_and_after, rrb.Vertical(*channels), story
    recording.send_blueprint(blueprint(rrb.Horizontal(*columns, column_shares=[1.7, 1, 1.1])))


def sides(discovery: Discovered) -> tuple[str, ...]:
    """Return the sides that exist; "after" exists only if an explanation was found."""
    return ("before", "after") if discovery.explanations else ("before",)


def _log_plane(canvas: Canvas, side: str, residual: np.ndarray, curves: list[Curve]) -> None:
    """Log residuals of all postures from above, this posture's large, and a circle of 95 % of the noise."""
    path, points = f"plane/{side}", from_above(residual)
    canvas.recording.log(f"{path}/all", rr.Points2D(points, **flat(COLOURS[side], 2)), static=True)
    canvas.rows(f"{path}/this", rr.Points2D, flat((0, 0, 0), 5), positions=points)
    sd = np.sqrt(np.mean([curve.sd**2 for curve in curves[:2]]))
    ring = rr.LineStrips2D([sd * np.sqrt(-2 * np.log(0.05)) * CIRCLE], **flat(NOMINAL, 1))
    canvas.recording.log(f"{path}/noise", ring, static=True)


def _log_channels(recording: rr.RecordingStream, curves: list[Curve], of: tuple[str, ...]) -> None:
    """Log every channel's residuals over their noise as points, with lines at -2 and 2."""
    for k, curve in enumerate(curves):
        there = np.isfinite(curve.sd)
        canvas = Canvas(recording, rr.TimeColumn("posture", sequence=np.flatnonzero(there) + 1))
        for side in of:
            style = rr.SeriesPoints(
                colors=rgb(COLOURS[side]), markers="circle", marker_sizes=1.5, names=f"{curve.name}, {side}"
            )
            values = getattr(curve, side)[there] / curve.sd[there]
            canvas.series(f"channels/{curve.channel}/{LAYERS[side]}/{k}", style, values)
        ends = Canvas(recording, rr.TimeColumn("posture", sequence=[1, len(there)]))
        for level in (-2.0, 2.0):
            grey = rr.SeriesLines(colors=rgb(NOMINAL), widths=1.0, names="noise")
            ends.series(f"channels/{curve.channel}/noise/{level:+g}", grey, np.full(2, level))


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
        place, text = [[BAR / 2, STEP * (k + 0.15)]], f"{one.instance.label}: {factor:.1f}"
        log_label(recording, f"evidence/{k}/label", place, text, DARK)


def discovery_text(discovery: Discovered, factor: int) -> list[str]:
    """Return the story, the gap and the explanations as lines of Markdown."""
    explained = [explanation_table(discovery.explanations).markdown()] if discovery.explanations else []
    return [
        f"## Verdict: {discovery.verdict}",
        discovery.answers[0],
        "",
        *(f"{line}\n" for line in discovery.story),
        gap_table(discovery.heldout).markdown(),
        *(line for table in explained for line in ("", table)),
        "",
        "Vermilion: as measured. Blue: with the found effects removed. The robot stands as measured. "
        f"Lines on the ground: CoP minus estimated CoM (eq. 12) from the CoP, {factor} times. Below, "
        "x up, y left; circle: 95 % of the noise. Channels: residuals over their noise, lines at -2 and 2; "
        "postures in the order of time.",
    ]


def log_law(recording: rr.RecordingStream, k: int, law: LawCurve) -> None:
    """Log the curve of law k over its range, the postures' errors, and the ends of both scales."""
    low = np.array([min(law.x.min(), law.at.min()), min(law.curve.min(), law.error.min())])
    high = np.array([max(law.x.max(), law.at.max()), max(law.curve.max(), law.error.max())])
    span = np.maximum(high - low, 1e-12)

    def placed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        part = (np.column_stack([x, y]) - low) / span
        return np.column_stack([WIDTH * part[:, 0], HEIGHT * (1 - part[:, 1])])

    points = rr.Points2D(placed(law.at, law.error), **flat(MEASURED, 2))
    recording.log(f"law/{k}/residuals", points, static=True)
    strip = rr.LineStrips2D([placed(law.x, law.curve)], **flat(ESTIMATE, 2))
    recording.log(f"law/{k}/curve", strip, static=True)
    ends = [
        ([0.0, HEIGHT + SPACE / 2], f"{number(low[0], '.3g')} {law.x_unit}"),
        ([WIDTH, HEIGHT + SPACE / 2], f"{number(high[0], '.3g')} {law.x_unit}"),
        ([-SPACE / 2, HEIGHT], f"{number(low[1], '.3g')} {law.unit}"),
        ([-SPACE / 2, 0.0], f"{number(high[1], '.3g')} {law.unit}"),
    ]
    places, labels = zip(*ends, strict=True)
    log_label(recording, f"law/{k}/scales", places, labels, DARK)
