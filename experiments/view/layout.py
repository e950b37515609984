"""Blueprints: which views stand where."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from experiments.view.balance import from_above
from experiments.view.plots import TITLES, curves
from experiments.view.subject import Subject

MARGIN_ABOVE = 40.0  # mm around the plates
EYE = (2.0, -1.45, 1.15)  # m, of a robot as tall as TULip
TULIP_HEIGHT = 1.25  # m


def posture_blueprint(subject: Subject, timeline: str = "posture") -> rrb.Blueprint:
    """The robot large, the ground beside it, numbers, curves below."""
    tabs = [
        rrb.TimeSeriesView(origin=f"plots/{name}", name=TITLES[name], plot_legend=rrb.Corner2D.RightTop)
        for name in curves(subject)
    ]
    ground: list[rrb.View] = [above_view(subject.plates, subject.board.size)]
    if subject.cop is not None:
        ground.append(close_up_view(subject))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.Tabs(*space_views(subject)), rrb.Tabs(*tabs), row_shares=[2.2, 1]),
            rrb.Vertical(
                *ground,
                rrb.TextDocumentView(origin="text", name="Posture"),
                row_shares=[1.25, *([0.85] if len(ground) > 1 else []), 1.3],
            ),
            column_shares=[1.7, 1],
        ),
        rrb.TimePanel(timeline=timeline, state="collapsed", fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def space_views(subject: Subject) -> list[rrb.Spatial3DView]:
    """The robot on its plates, and its skeleton with the links' masses."""
    height = _height(subject)
    eye = rrb.EyeControls3D(
        position=tuple(height / TULIP_HEIGHT * np.array(EYE)),
        look_target=(0.0, 0.1, 0.42 * height),
        eye_up=(0.0, 0.0, 1.0),
    )
    plain = {"origin": "world", "background": (238, 241, 244), "line_grid": False, "eye_controls": eye}
    return [
        rrb.Spatial3DView(
            name="Robot on its plates", contents=["$origin/**", "- $origin/masses/**"], **plain
        ),
        rrb.Spatial3DView(
            name="Masses of the links",
            contents=["$origin/masses/**", "$origin/plates/**", "$origin/balance/**"],
            **plain,
        ),
    ]


def above_view(plates: np.ndarray, size: np.ndarray) -> rrb.Spatial2DView:
    """The ground from above, x up and y to the left, all placements in the picture."""
    reach = np.linalg.norm(size) / 2
    corners = np.vstack([plates[..., :2].reshape(-1, 2) - reach, plates[..., :2].reshape(-1, 2) + reach])
    low, high = from_above(corners).min(axis=0), from_above(corners).max(axis=0)
    return rrb.Spatial2DView(
        origin="above",
        name="From above, mm (x up, y left)",
        background=(250, 250, 250),
        visual_bounds=rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], high[1]]),
    )


def close_up_view(subject: Subject) -> rrb.Spatial2DView:
    """CoP and CoM around the reference, wide enough for all postures."""
    assert subject.cop is not None
    reference = subject.com.get("estimate", subject.com["nominal model"])
    others = [subject.cop, *([subject.com["truth"]] if "truth" in subject.com else [])]
    reach = 1.3e3 * max(float(np.abs(other - reference).max()) for other in others)
    name = "estimated CoM" if "estimate" in subject.com else "nominal CoM"
    return rrb.Spatial2DView(
        origin="close_up",
        name=f"Around the {name}, {2 * reach:.3g} mm high (x up, y left)",
        background=(250, 250, 250),
        visual_bounds=rrb.VisualBounds2D(x_range=[-reach, reach], y_range=[-reach, reach]),
    )


def _height(subject: Subject) -> float:
    """Of the highest frame over the ground with the legs as they stand, plus what is above it [m]."""
    from experiments.view.robot import link_frames

    _, positions = link_frames(subject.nominal, subject.joint_angles)
    return 2.0 * float(np.median(positions[..., 2].max(axis=1)))
