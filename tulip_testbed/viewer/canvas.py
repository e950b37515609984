"""Log things on a time line: a style that holds for all rows, and columns with an entry a row."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from tulip_testbed.colours import rgb

TURN = np.linspace(0, 2 * np.pi, 73)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])  # of radius one, closed
PALE = (250, 250, 250)  # behind pictures of the plane
Colour = str | tuple[int, int, int]


@dataclass(frozen=True)
class Canvas:
    """A recording and a time line with the rows of what is logged."""

    recording: rr.RecordingStream
    index: rr.TimeColumn

    def rows(
        self,
        path: str,
        kind: Any,
        style: dict[str, Any],
        lengths: Sequence[int] | None = None,
        **columns: Any,
    ) -> None:
        """Log one of rerun's things, or as many as `lengths` says, by row: a shared style and columns."""
        self.recording.log(path, kind.from_fields(**style), static=True)
        data = kind.columns(**columns)
        self.recording.send_columns(path, [self.index], data if lengths is None else data.partition(lengths))

    def poses(self, path: str, rotation: Rotation, place: np.ndarray) -> None:
        """Log where an entity is, (m, 3) [m]."""
        columns = rr.Transform3D.columns(translation=place, quaternion=rotation.as_quat())
        self.recording.send_columns(path, [self.index], columns)

    def series(self, path: str, style: Any, values: np.ndarray) -> None:
        """Log a number for every row, drawn as lines or points."""
        self.recording.log(path, style, static=True)
        self.recording.send_columns(path, [self.index], rr.Scalars.columns(scalars=values))


def flat(colour: Colour, radius: float, **more: Any) -> dict[str, Any]:
    """Return the style of points or lines whose radius is in the picture's points, not in metres."""
    return styled(colour, rr.Radius.ui_points(radius), **more)


def styled(colour: Colour, radius: Any, **more: Any) -> dict[str, Any]:
    return {"colors": rgb(colour) if isinstance(colour, str) else colour, "radii": radius, **more}


def log_label(
    recording: rr.RecordingStream, path: str, places: Any, labels: Any, colour: Colour, radius: float = 0.0
) -> None:
    """Log texts at points of a plane; a text stands below its point, in the point's colour."""
    shown = rr.Points2D(places, **flat(colour, radius, labels=labels, show_labels=True))
    recording.log(path, shown, static=True)


def log_markdown(recording: rr.RecordingStream, lines: Sequence[str]) -> None:
    """Log a text that holds for all rows, under /text."""
    page = rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN)
    recording.log("text", page, static=True)


def plane_view(origin: str, name: str, x: Sequence[float], y: Sequence[float]) -> rrb.Spatial2DView:
    """Return the view of a plane from and to some x and y; y points downwards."""
    bounds = rrb.VisualBounds2D(x_range=[*x], y_range=[*y])
    return rrb.Spatial2DView(origin=origin, name=name, background=PALE, visual_bounds=bounds)


def blueprint(views: rrb.Horizontal, timeline: str = "posture") -> rrb.Blueprint:
    """Return an arrangement of views above a time line, with rerun's own panels closed."""
    return rrb.Blueprint(
        views,
        rrb.TimePanel(timeline=timeline, state="collapsed", fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
