"""Support polygon, CoP and projections of the CoM: in space, from above, close up."""

from __future__ import annotations

import numpy as np
import rerun as rr

from tulip_testbed.colours import ESTIMATE, MARGIN, MEASURED, NOMINAL, POLYGON, RESIDUAL, TRUTH, rgb
from tulip_testbed.identification.feasibility import place_polygon
from tulip_testbed.polygons import inset, nearest_on
from tulip_testbed.standing import soles_in_base
from tulip_testbed.viewer.subject import Subject

COM_COLOURS = {"estimate": ESTIMATE, "truth": TRUTH, "nominal model": NOMINAL}
ABOVE_GROUND = 0.002  # m, so that lines do not flicker in the boards' surface
MAGNIFIED_TO = 0.08  # m, about what the median residual is drawn as


def magnification(subject: Subject) -> int:
    """Factor by which the residual is drawn."""
    return 1 if subject.residual is None else factor_for(subject.residual)


def factor_for(residual: np.ndarray) -> int:
    """Return 1, 2 or 5 times a power of ten that makes residuals (m, 2) [m] long enough to be visible."""
    median = float(np.median(np.linalg.norm(residual, axis=1)))
    steps = np.array([step * 10**power for power in range(7) for step in (1, 2, 5)])
    return int(steps[np.argmin(np.abs(np.log(steps * max(median, 1e-9) / MAGNIFIED_TO)))])


def log_balance(recording: rr.RecordingStream, index: rr.TimeColumn, subject: Subject) -> None:
    """Log everything on the ground, under /world/balance [m] and from above under /above [mm]."""
    boards = [[_board(subject, row, plate) for plate in range(2)] for row in range(len(subject))]
    _strips_above(recording, "above/plates", index, boards, (158, 184, 204), 2.0)
    soles = soles_in_base(subject.nominal, subject.joint_angles, subject.support)
    _strips_above(
        recording, "above/soles", index, [[_closed(s) for s in row] for row in soles], (130, 130, 130), 2.0
    )
    _strips(recording, "support_polygon", index, [[_closed(p)] for p in subject.polygons], POLYGON)
    if subject.least_margin:
        inner = [inset(polygon, subject.least_margin) for polygon in subject.polygons]
        closed = [[_closed(p)] if p is not None else [] for p in inner]
        _strips(recording, "stability_margin", index, closed, MARGIN)
    judged = subject.com["nominal model"] if subject.cop is None else subject.cop
    nearest = [
        [np.array([point, nearest_on(point, polygon)])]
        for point, polygon in zip(judged, subject.polygons, strict=True)
    ]
    _strips(recording, "distance_to_edge", index, nearest, POLYGON)
    for name, points in subject.com.items():
        _points(recording, f"com_{name.replace(' ', '_')}", index, points, COM_COLOURS[name], f"CoM, {name}")
    if subject.cop is not None:
        _points(recording, "cop", index, subject.cop, MEASURED, "CoP")
    if subject.residual is not None:
        start = subject.com["estimate"]
        ends = start + magnification(subject) * subject.residual
        lines = [[np.array(pair)] for pair in zip(start, ends, strict=True)]
        _strips(recording, "residual", index, lines, RESIDUAL)


def log_close_up(recording: rr.RecordingStream, index: rr.TimeColumn, subject: Subject) -> None:
    """Log CoP and CoM relative to the estimate (else the nominal model), under /close_up [mm]."""
    if subject.cop is None:
        return
    reference, points, reach = close_up(subject)
    for k, (name, value) in enumerate(points.items()):
        colour = MEASURED if name == "CoP" else COM_COLOURS[name.removeprefix("CoM, ")]
        path = "close_up/" + name.replace(", ", "_").replace(" ", "_").lower()
        style = rr.Points2D.from_fields(colors=rgb(colour), radii=rr.Radius.ui_points(5))
        recording.log(path, style, static=True)
        columns = rr.Points2D.columns(positions=from_above(value - reference))
        recording.send_columns(path, [index], columns)
        # Beside each other's points labels would lie over each other.
        sign = rr.Points2D(
            [[-1.9 * reach, (0.5 * k - 0.8) * reach]],
            colors=rgb(colour),
            radii=rr.Radius.ui_points(5),
            labels=name,
            show_labels=True,
        )
        recording.log(f"close_up/legend/{k}", sign, static=True)
    lines = from_above(np.stack([np.zeros_like(reference), subject.cop - reference], axis=1))
    pink = rr.LineStrips2D.from_fields(colors=rgb(RESIDUAL), radii=rr.Radius.ui_points(1.5))
    recording.log("close_up/residual", pink, static=True)
    recording.send_columns("close_up/residual", [index], rr.LineStrips2D.columns(strips=list(lines)))
    turn = np.linspace(0, 2 * np.pi, 73)
    for radius in circles(reach):
        ring = radius * np.column_stack([np.cos(turn), np.sin(turn)])
        grey = rr.LineStrips2D([ring], colors=(190, 190, 190), radii=rr.Radius.ui_points(0.7))
        recording.log(f"close_up/circle/{radius:g}_mm", grey, static=True)


def close_up(subject: Subject) -> tuple[np.ndarray, dict[str, np.ndarray], float]:
    """Return the point in the middle, (m, 2) [m], the points around it, and the reach of the picture [mm]."""
    assert subject.cop is not None
    points = {f"CoM, {name}": value for name, value in subject.com.items()}
    if "estimate" in subject.com:  # centimetres away, it would set the scale
        del points["CoM, nominal model"]
    points["CoP"] = subject.cop
    reference = subject.com.get("estimate", subject.com["nominal model"])
    furthest = np.max([np.abs(value - reference).max(axis=1) for value in points.values()], axis=0)
    return reference, points, max(1.1e3 * float(np.quantile(furthest, 0.95)), 1e-6)


def circles(reach: float) -> list[float]:
    """Return the radii of the scale's two circles: round numbers below the reach [mm]."""
    steps = [step * 10.0**power for power in range(-7, 5) for step in (1, 2, 5)]
    return [step for step in steps if step < reach][-2:]


def from_above(points: np.ndarray) -> np.ndarray:
    """Map the base frame to a picture with x up and y to the left, (..., 2) [m] -> [mm]."""
    return -1e3 * points[..., ::-1]


def _board(subject: Subject, row: int, plate: int) -> np.ndarray:
    x, y = subject.board.size / 2
    corners = np.array([[x, y], [x, -y], [-x, -y], [-x, y]])
    return _closed(place_polygon(corners, subject.plates[row, plate]))


def _closed(polygon: np.ndarray) -> np.ndarray:
    return np.vstack([polygon, polygon[:1]])


def _strips(
    recording: rr.RecordingStream,
    name: str,
    index: rr.TimeColumn,
    strips: list[list[np.ndarray]],
    colour: str,
) -> None:
    """Log lines on the ground, some for every row, in space and from above."""
    path = f"world/balance/{name}"
    flat = [np.column_stack([s, np.full(len(s), ABOVE_GROUND)]) for row in strips for s in row]
    recording.log(path, rr.LineStrips3D.from_fields(colors=rgb(colour), radii=0.003), static=True)
    columns = rr.LineStrips3D.columns(strips=flat).partition([len(row) for row in strips])
    recording.send_columns(path, [index], columns)
    _strips_above(recording, f"above/{name}", index, strips, rgb(colour), 3.0)


def _strips_above(
    recording: rr.RecordingStream,
    path: str,
    index: rr.TimeColumn,
    strips: list[list[np.ndarray]],
    colour: tuple[int, int, int],
    radius: float,
) -> None:
    recording.log(path, rr.LineStrips2D.from_fields(colors=colour, radii=radius / 2), static=True)
    flat = [from_above(strip) for row in strips for strip in row]
    columns = rr.LineStrips2D.columns(strips=flat).partition([len(row) for row in strips])
    recording.send_columns(path, [index], columns)


def _points(
    recording: rr.RecordingStream,
    name: str,
    index: rr.TimeColumn,
    points: np.ndarray,
    colour: str,
    label: str,
) -> None:
    """Log a point on the ground for every row, in space and from above."""
    space, above = f"world/balance/{name}", f"above/{name}"
    style = {"colors": rgb(colour), "labels": label, "show_labels": False}
    recording.log(space, rr.Points3D.from_fields(radii=0.008, **style), static=True)
    ground = np.column_stack([points, np.full(len(points), 2 * ABOVE_GROUND)])
    recording.send_columns(space, [index], rr.Points3D.columns(positions=ground))
    recording.log(above, rr.Points2D.from_fields(radii=rr.Radius.ui_points(3.5), **style), static=True)
    recording.send_columns(above, [index], rr.Points2D.columns(positions=from_above(points)))
