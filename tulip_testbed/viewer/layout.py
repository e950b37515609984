"""Blueprints: the arrangement of the views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from tulip_testbed.viewer.balance_series import circles, close_up, from_above
from tulip_testbed.viewer.canvas import blueprint, plane_view
from tulip_testbed.viewer.plots import curves, title_of
from tulip_testbed.viewer.robot_view import height_of
from tulip_testbed.viewer.subject import Subject

EYE = (1.5, -1.05, 0.85)  # m, of a robot as tall as TULip
TULIP_HEIGHT = 1.25  # m


@dataclass(frozen=True)
class Views:
    """The views before they are arranged."""

    space: list[rrb.View]
    ground: list[rrb.View]
    curves: list[rrb.View]
    text: list[rrb.View]


def posture_views(subject: Subject) -> Views:
    """Return the views of postures."""
    ground: list[rrb.View] = [above_view(subject.plates, subject.board.size)]
    if subject.cop is not None:
        ground.append(close_up_view(subject))
    curve_views: list[rrb.View] = [
        rrb.TimeSeriesView(origin=f"plots/{name}", name=title_of(name), plot_legend=rrb.Corner2D.RightTop)
        for name in curves(subject)
    ]
    text: list[rrb.View] = [rrb.TextDocumentView(origin="text", name="Posture")]
    return Views([*space_views(subject)], ground, curve_views, text)


def laid_out(views: Views, timeline: str = "posture") -> rrb.Blueprint:
    """Arrange the robot large, the curves below it, the ground and the numbers on the right."""
    beside = [*views.ground, *views.text]
    shares = [1.1, *[0.8] * (len(views.ground) - 1), 1.6]
    return blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.Tabs(*views.space), rrb.Tabs(*views.curves), row_shares=[2.2, 1]),
            rrb.Vertical(*beside, row_shares=shares),
            column_shares=[1.7, 1],
        ),
        timeline,
    )


def space_views(subject: Subject) -> list[rrb.Spatial3DView]:
    """The robot on its plates, and its skeleton with the links' masses."""
    return [
        space_view(subject, "Robot on its plates", ["$origin/**", "- $origin/masses/**"]),
        space_view(
            subject,
            "Masses of the links",
            ["$origin/masses/**", "$origin/plates/**", "$origin/balance/**"],
        ),
    ]


def space_view(subject: Subject, name: str, contents: list[str]) -> rrb.Spatial3DView:
    """Return the view of a part of the world, observed from the robot's front right."""
    height = height_of(subject)
    eye = rrb.EyeControls3D(
        position=tuple(height / TULIP_HEIGHT * np.array(EYE)),
        look_target=(0.0, 0.1, 0.4 * height),
        eye_up=(0.0, 0.0, 1.0),
    )
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        contents=contents,
        background=(238, 241, 244),
        line_grid=False,
        eye_controls=eye,
    )


def above_view(plates: np.ndarray, size: np.ndarray) -> rrb.Spatial2DView:
    """Return the view of the ground from above, x up and y to the left, with all placements."""
    reach = np.linalg.norm(size) / 2
    corners = np.vstack([plates[..., :2].reshape(-1, 2) - reach, plates[..., :2].reshape(-1, 2) + reach])
    low, high = from_above(corners).min(axis=0), from_above(corners).max(axis=0)
    name = "From above, mm (x up, y left)"
    return plane_view("above", name, (low[0], high[0]), (low[1], high[1]))


def close_up_view(subject: Subject) -> rrb.Spatial2DView:
    """Return the view of CoP and CoM around the reference."""
    _, _, reach = close_up(subject)
    name = "estimated" if "estimate" in subject.com else "nominal"
    scale = " and ".join(f"{radius:g}" for radius in circles(reach))
    name = f"Close-up around the {name} CoM: circles of {scale} mm (x up, y left)"
    return plane_view("close_up", name, (-reach, reach), (-reach, reach))
