"""Support polygon, CoP and projections of the CoM: in space, from above, close up."""

import numpy as np
import rerun as rr
from scipy.spatial import HalfspaceIntersection, QhullError

from tulip_testbed.colours import ESTIMATE, MARGIN, MEASURED, NOMINAL, POLYGON, RESIDUAL, TRUTH
from tulip_testbed.identification.feasibility import inner_normals, place_polygon, support_polygon
from tulip_testbed.viewer.canvas import CIRCLE, Canvas, Colour, flat, log_label, styled
from tulip_testbed.viewer.subject import Subject

COM_COLOURS = {"estimate": ESTIMATE, "truth": TRUTH, "nominal model": NOMINAL}
ABOVE_GROUND = 0.002  # m, so that lines do not flicker in the boards' surface
MAGNIFIED_TO = 0.08  # m, about what the median residual is drawn as


def magnification(subject: Subject) -> int:
    return 1 if subject.residual is None else factor_for(subject.residual)


def factor_for(residual: np.ndarray) -> int:
    """Return 1, 2 or 5 times a power of ten that makes residuals (m, 2) [m] long enough to be visible."""
    median = float(np.median(np.linalg.norm(residual, axis=1)))
    steps = np.array([step * 10**power for power in range(7) for step in (1, 2, 5)])
    return int(steps[np.argmin(np.abs(np.log(steps * max(median, 1e-9) / MAGNIFIED_TO)))])


def log_balance(canvas: Canvas, subject: Subject) -> None:
    """Log everything on the ground, under /world/balance [m] and from above under /above [mm]."""
    corners = subject.board.corners
    boards = [[_closed(place_polygon(corners, plate)) for plate in plates] for plates in subject.plates]
    soles = subject.nominal.geometry(subject.rows.joint_angles, subject.rows.support).soles
    if not subject.sensors_in_feet:
        _strips_above(canvas, "above/plates", boards, (158, 184, 204), 2.0)
    _strips_above(canvas, "above/soles", [[_closed(s) for s in row] for row in soles], (130, 130, 130), 2.0)
    _strips(canvas, "support_polygon", [[_closed(p)] for p in subject.polygons], POLYGON)
    if subject.least_margin:
        inner = [inset(polygon, subject.least_margin) for polygon in subject.polygons]
        _strips(canvas, "stability_margin", [[_closed(p)] if p is not None else [] for p in inner], MARGIN)
    judged = subject.com["nominal model"] if subject.cop is None else subject.cop
    nearest = [
        [np.array([point, nearest_on(point, polygon)])]
        for point, polygon in zip(judged, subject.polygons, strict=True)
    ]
    _strips(canvas, "distance_to_edge", nearest, POLYGON)
    for name, points in subject.com.items():
        _points(canvas, f"com_{name.replace(' ', '_')}", points, COM_COLOURS[name], f"CoM, {name}")
    if subject.cop is not None:
        _points(canvas, "cop", subject.cop, MEASURED, "CoP")
    if subject.residual is not None:
        start = subject.com["estimate"]
        ends = start + magnification(subject) * subject.residual
        lines = [[np.array(pair)] for pair in zip(start, ends, strict=True)]
        _strips(canvas, "residual", lines, RESIDUAL)


def log_close_up(canvas: Canvas, subject: Subject) -> None:
    """Log CoP and CoM relative to the estimate (else the nominal model), under /close_up [mm]."""
    if subject.cop is None:
        return
    reference, points, reach = close_up(subject)
    for k, (name, value) in enumerate(points.items()):
        colour = MEASURED if name == "CoP" else COM_COLOURS[name.removeprefix("CoM, ")]
        path = "close_up/" + name.replace(", ", "_").replace(" ", "_").lower()
        canvas.rows(path, rr.Points2D, flat(colour, 5), positions=from_above(value - reference))
        # Beside each other's points labels would lie over each other.
        place = [[-1.9 * reach, (0.5 * k - 0.8) * reach]]
        log_label(canvas.recording, f"close_up/legend/{k}", place, name, colour, 5)
    lines = from_above(np.stack([np.zeros_like(reference), subject.cop - reference], axis=1))
    canvas.rows("close_up/residual", rr.LineStrips2D, flat(RESIDUAL, 1.5), strips=list(lines))
    for radius in circles(reach):
        ring = rr.LineStrips2D([radius * CIRCLE], **flat((190, 190, 190), 0.7))
        canvas.recording.log(f"close_up/circle/{radius:g}_mm", ring, static=True)


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


def _closed(polygon: np.ndarray) -> np.ndarray:
    return np.vstack([polygon, polygon[:1]])


def _strips(canvas: Canvas, name: str, strips: list[list[np.ndarray]], colour: str) -> None:
    """Log lines on the ground, some for every row, in space and from above."""
    ground = [np.column_stack([s, np.full(len(s), ABOVE_GROUND)]) for row in strips for s in row]
    lengths = [len(row) for row in strips]
    style = styled(colour, 0.003)
    canvas.rows(f"world/balance/{name}", rr.LineStrips3D, style, lengths, strips=ground)
    _strips_above(canvas, f"above/{name}", strips, colour, 3.0)


def _strips_above(
    canvas: Canvas, path: str, strips: list[list[np.ndarray]], colour: Colour, radius: float
) -> None:
    seen = [from_above(strip) for row in strips for strip in row]
    lengths = [len(row) for row in strips]
    canvas.rows(path, rr.LineStrips2D, styled(colour, radius / 2), lengths, strips=seen)


def _points(canvas: Canvas, name: str, points: np.ndarray, colour: str, label: str) -> None:
    """Log a point on the ground for every row, in space and from above."""
    named = {"labels": label, "show_labels": False}
    ground = np.column_stack([points, np.full(len(points), 2 * ABOVE_GROUND)])
    canvas.rows(f"world/balance/{name}", rr.Points3D, styled(colour, 0.008, **named), positions=ground)
    canvas.rows(f"above/{name}", rr.Points2D, flat(colour, 3.5, **named), positions=from_above(points))


def inset(polygon: np.ndarray, distance: float) -> np.ndarray | None:
    """Return the convex polygon of points at least `distance` [m] inside its edges; None: there are none."""
    outward = -inner_normals(polygon)
    offset = distance - (outward * polygon).sum(axis=1)
    middle = polygon.mean(axis=0)
    if (outward @ middle + offset >= 0).any():
        return None
    try:
        return support_polygon(
            HalfspaceIntersection(np.column_stack([outward, offset]), middle).intersections
        )
    except QhullError:
        return None


def nearest_on(point: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return the point of a polygon's edges that is nearest, (2,) [m]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    along = ((point - polygon) * edges).sum(axis=1) / (edges**2).sum(axis=1)
    feet = polygon + np.clip(along, 0, 1)[:, None] * edges
    return feet[np.argmin(np.linalg.norm(feet - point, axis=1))]
