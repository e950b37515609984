"""A placement from above as SVG in millimetres of the paper: boards, foot marks, datum, calibration bar."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import numpy as np

from tulip_testbed.identification.feasibility import place_polygon
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.robot import Robot, sole_corners
from tulip_testbed.sim.scene import nominal_plates

SCALES = (1, 2, 2.5, 4, 5, 8, 10, 15, 20, 25, 50, 100)
WIDTH, HEIGHT = 112.0, 96.0  # mm of the paper, of the largest drawing
BAR = 100.0  # mm on the paper
EDGE, FOOTER = 6.0, 12.0  # mm around the drawing and below it
BOARD, SOLE, DATUM = "#8a939c", "#1f5fa8", "#c4461b"


@dataclass(frozen=True)
class Mark:
    """A point to be measured on boards or floor, in the base frame [mm], with its label and description."""

    label: str
    name: str
    x: float
    y: float


@dataclass(frozen=True)
class Placement:
    """Boards and soles of one placement in its base frame.

    Attributes:
        boards: poses of right and left board, (2, 3) [m, m, rad]. outlines: their corners, (2, 4, 2) [m].
        feet: poses of right and left foot, (2, 3) [m, m, rad]. soles: their corners, (2, 4, 2) [m].
        stands: whether each foot stands, (2,).
        datum: the foot below whose ankle the origin lies, 0: right.
    """

    boards: np.ndarray
    outlines: np.ndarray
    feet: np.ndarray
    soles: np.ndarray
    stands: tuple[bool, bool]
    datum: int


def placement_of(robot: Robot, boards: np.ndarray, feet: np.ndarray, support: np.ndarray) -> Placement:
    """Return boards and soles of a placement, (2, 3) [m, m, rad] each, by supports, (k,)."""
    corners = nominal_plates(robot)[0].corners
    soles = [sole_corners(robot.model, foot)[:, :2] for foot in robot.feet]
    return Placement(
        boards=boards,
        outlines=np.array([place_polygon(corners, pose) for pose in boards]),
        feet=feet,
        soles=np.array([place_polygon(sole, pose) for sole, pose in zip(soles, feet, strict=True)]),
        stands=(bool((support != "left").any()), bool((support != "right").any())),
        datum=int(base_foot(support[:1])[0]),
    )


def marks(placement: Placement) -> list[Mark]:
    """List the corners of boards and soles and the points below the ankles."""
    found, corners = [], [corner.replace("_", " ") for corner in CORNERS]
    for side, plate in enumerate(PLATES):
        names = [f"{plate} board, {corner}" for corner in corners]
        found += zip(("ABCD", "EFGH")[side], names, placement.outlines[side], strict=True)
    for side, plate in enumerate(PLATES):
        if placement.stands[side]:
            names = [f"{plate} sole, {corner}" for corner in corners]
            found += zip(("1234", "5678")[side], names, placement.soles[side], strict=True)
            found.append(("RL"[side], f"below the {plate} ankle", placement.feet[side, :2]))
    return [Mark(label, name, *(1e3 * point).tolist()) for label, name, point in found]


def scale_for(placements: list[Placement]) -> float:
    """Return the largest usual scale in which all placements fit their space on the paper, 1 : N."""
    sizes = [1e3 * np.ptp(_points(one), axis=0)[::-1] for one in placements]
    need = float((np.max(sizes, axis=0) / [WIDTH, HEIGHT]).max())
    return next((scale for scale in SCALES if scale >= need), SCALES[-1])


def drawing(placement: Placement, scale: float) -> str:
    """Return a placement, 1 : scale, as an SVG in millimetres of the paper; forward is up, left is left."""
    points = _points(placement)
    low, high = points.min(axis=0), points.max(axis=0)

    def at(point: np.ndarray) -> tuple[float, float]:
        x, y = 1e3 * (high - point)[::-1] / scale + EDGE
        return float(x), float(y)

    def polygon(corners: np.ndarray, style: str, name: str) -> str:
        text = " ".join(f"{x:.3f},{y:.3f}" for x, y in map(at, corners))
        return f'<polygon id="{name}" points="{text}" {style}/>'

    wide, tall = 1e3 * (high - low)[::-1] / scale + 2 * EDGE
    wide, tall = max(float(wide), BAR + 2 * EDGE), float(tall) + FOOTER
    parts = [
        polygon(outline, f'fill="#f3f5f7" stroke="{BOARD}" stroke-width="0.3"', f"{plate}-board")
        for plate, outline in zip(PLATES, placement.outlines, strict=True)
    ]
    for side, plate in enumerate(PLATES):
        if placement.stands[side]:
            style = f'fill="{SOLE}" fill-opacity="0.08" stroke="{SOLE}" stroke-width="0.3"'
            parts.append(polygon(placement.soles[side], style, f"{plate}-sole"))
            x, y = at(placement.feet[side, :2])
            cross = f"M{x - 1.5:.3f} {y:.3f}h3.0M{x:.3f} {y - 1.5:.3f}v3.0"
            parts.append(f'<path d="{cross}" stroke="{SOLE}" stroke-width="0.3"/>')
    parts += [_label(mark, at, placement) for mark in marks(placement)]
    x, y = at(np.zeros(2))
    reach = 9.0
    parts.append(
        f'<g stroke="{DATUM}" stroke-width="0.4" fill="none"><circle cx="{x:.3f}" cy="{y:.3f}" r="1.8"/>'
        f'<path d="M{x:.3f} {y:.3f}v{-reach}l-1 2m1 -2l1 2M{x:.3f} {y:.3f}h{-reach}l2 -1m-2 1l2 1"/></g>'
        f'<g fill="{DATUM}" font-size="3"><text x="{x + 1.2:.3f}" y="{y - reach + 1:.3f}">x</text>'
        f'<text x="{x - reach:.3f}" y="{y - 1.8:.3f}">y</text></g>'
    )
    y = tall - 6.0
    ticks = "".join(f"M{EDGE + 10 * k:.3f} {y:.3f}v{-1.5 - (k % 5 == 0)}" for k in range(11))
    parts.append(
        f'<path id="bar" d="M{EDGE:.3f} {y:.3f}h{BAR:g}" stroke="black" stroke-width="0.3" fill="none"/>'
        f'<path d="{ticks}" stroke="black" stroke-width="0.2" fill="none"/>'
        f'<text x="{EDGE:.3f}" y="{y + 3.6:.3f}" font-size="2.8">This bar measures {BAR:g} mm on paper; '
        "if not, print at 100 %.</text>"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide:.3f}mm" height="{tall:.3f}mm" '
        f'viewBox="0 0 {wide:.3f} {tall:.3f}" font-family="sans-serif" role="img" '
        f'aria-label="Boards and foot marks from above, 1 : {scale:g}">{"".join(parts)}</svg>'
    )


def _label(mark: Mark, at: Callable[[np.ndarray], tuple[float, float]], placement: Placement) -> str:
    """Return a mark's label: inside a board's corner, outside of a sole's, next to an ankle."""
    x, y = at(1e-3 * np.array([mark.x, mark.y]))
    if mark.label in "RL":
        return f'<text x="{x + 1.6:.3f}" y="{y + 3.6:.3f}" font-size="2.8" fill="{SOLE}">{mark.label}</text>'
    on_board = mark.label.isalpha()
    side = int(mark.name.startswith("left"))
    corners = (placement.outlines if on_board else placement.soles)[side]
    u, v = at(corners.mean(axis=0))
    away = np.array([np.sign(x - u), np.sign(y - v)]) * (-2.2 if on_board else 1.8)
    colour = "#444" if on_board else SOLE
    return (
        f'<text x="{x + away[0]:.3f}" y="{y + away[1] + 1.0:.3f}" font-size="2.8" text-anchor="middle" '
        f'fill="{colour}">{escape(mark.label)}</text>'
    )


def _points(placement: Placement) -> np.ndarray:
    """Return the corners of both boards and the datum, (9, 2) [m]."""
    return np.vstack([placement.outlines.reshape(-1, 2), placement.soles.reshape(-1, 2), np.zeros((1, 2))])
