"""The curve of a law in rerun, with the errors that the residuals of every posture show."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.base.numbers import number
from tulip_testbed.colours import ESTIMATE, MEASURED, rgb
from tulip_testbed.experiments.law_curves import LawCurve

WIDTH, HEIGHT = 100.0, 60.0  # pixels of the picture; rerun draws y downwards
MARGIN = 8.0
PALE = (250, 250, 250)


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
        ([0.0, HEIGHT + MARGIN / 2], f"{number(low[0], '.3g')} {law.x_unit}"),
        ([WIDTH, HEIGHT + MARGIN / 2], f"{number(high[0], '.3g')} {law.x_unit}"),
        ([-MARGIN / 2, HEIGHT], f"{number(low[1], '.3g')} {law.unit}"),
        ([-MARGIN / 2, 0.0], f"{number(high[1], '.3g')} {law.unit}"),
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
            x_range=[-2 * MARGIN, WIDTH + 2 * MARGIN], y_range=[-MARGIN, HEIGHT + 2 * MARGIN]
        ),
    )
