"""Pictures of a plan: support polygons with centres of mass (the paper's Fig. 2), postures (its Fig. 3).

The polygons are SVG: it needs no library, stands in an HTML page as it is, and any browser shows it.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder, write_bytes, write_text
from tulip_testbed.identification.feasibility import place_polygon, stability_margin, support_polygon
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.polygons import inset, nearest_on
from tulip_testbed.rendering import rendered
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, sole_corners
from tulip_testbed.sim.scene import boards_under, nominal_plates

SCALE = 400.0  # pixels a metre
MOST_COLUMNS = 4
GAP, HEAD, LEGEND = 16, 22, 64  # pixels
BOARD, SOLE, POLYGON, COM = "#c3cbd3", "#5b6770", "#1f5fa8", "#c4461b"
THUMB = (168, 224)  # pixels, of a rendered posture
SHEET_COLUMNS = 10
PORTRAIT = (480, 640)  # pixels


def write_pictures(folder: Path, robot: Robot, plan: PosturePlan) -> InputError | None:
    """Write both pictures into a new folder.

    Returns:
        why there is no picture of the postures; None: there is one.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    with new_folder(folder) as working:
        write_text(working / "support-polygons.svg", support_polygons(robot, plan))
        try:
            sheet = contact_sheet(robot, plan)
        except InputError as problem:
            return problem
        write_bytes(working / "postures.png", sheet)
    return None


def support_polygons(robot: Robot, plan: PosturePlan) -> str:
    """Draw an SVG with one panel per placement, observed from above, forward up.

    Boards, soles, the polygon of the soles that carry the robot, inside it the line that d_s leaves, and
    every posture's nominal centre of mass with the shortest way to the polygon's edge, d_e.
    """
    model = robot.model
    com = nominal_robot(robot, "mixed").center_of_mass(plan.joint_angles, plan.support)
    inner = planning_ranges(robot).stability_margin if "planning" in robot.settings else None
    size = nominal_plates(robot)[0].size
    corners = [sole_corners(model, foot)[:, :2] for foot in robot.feet]
    placements = list(dict.fromkeys(plan.placement.tolist()))
    first = [int(np.flatnonzero(plan.placement == number)[0]) for number in placements]
    boards = boards_under(preset_rig("ideal", robot), plan.foot_poses[first])
    half = size / 2
    low, high = boards[..., :2].min(axis=(0, 1)) - half, boards[..., :2].max(axis=(0, 1)) + half
    width, height = SCALE * (high - low)[::-1]
    columns = min(MOST_COLUMNS, len(placements))
    panels = []
    for k, (number, row) in enumerate(zip(placements, first, strict=True)):
        rows = np.flatnonzero(plan.placement == number)
        soles = np.array([place_polygon(*foot) for foot in zip(corners, plan.foot_poses[row], strict=True)])
        x = GAP + (k % columns) * (width + GAP)
        y = LEGEND + (k // columns) * (height + HEAD + GAP) + HEAD
        parts = [_rectangle(pose, half, low, high) for pose in boards[k]]
        on = feet_in_contact(plan.support[rows])
        parts += [_shape(sole, low, high, f'fill="none" stroke="{SOLE}"') for sole in soles[on.any(axis=0)]]
        least = np.inf
        for support in dict.fromkeys(plan.support[rows].tolist()):
            polygon = support_polygon(soles[feet_in_contact(np.array([support]))[0]])
            parts.append(
                _shape(polygon, low, high, f'fill="{POLYGON}" fill-opacity="0.10" stroke="{POLYGON}"')
            )
            if inner is not None and (kept := inset(polygon, inner)) is not None:
                parts.append(
                    _shape(kept, low, high, f'fill="none" stroke="{POLYGON}" stroke-dasharray="3 3"')
                )
            for r in rows[plan.support[rows] == support]:
                least = min(least, stability_margin(com[r], polygon))
                parts.append(_mass(com[r], polygon, int(plan.posture[r]), low, high))
        title = f"placement {number}, least margin {1e3 * least:.0f} mm"
        parts.append(f'<text x="0" y="-7" font-size="12">{title}</text>')
        panels.append(f'<g transform="translate({x:.1f} {y:.1f})">{"".join(parts)}</g>')
    total = GAP + columns * (width + GAP)
    total = max(total, 640.0)
    tall = LEGEND + -(-len(placements) // columns) * (height + HEAD + GAP)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total:.0f} {tall:.0f}" width="{total:.0f}" '
        f'height="{tall:.0f}" font-family="sans-serif" fill="#222"><rect width="100%" height="100%" '
        f'fill="white"/>{_legend(inner)}{"".join(panels)}</svg>\n'
    )


def contact_sheet(robot: Robot, plan: PosturePlan) -> bytes:
    """Draw a PNG of every different posture of a plan, rendered by MuJoCo, with its number.

    Raises:
        InputError: see `rendered`.
    """
    _, once = np.unique(plan.posture, return_index=True)
    shown = plan.take(np.sort(once))
    width, height = THUMB
    boards = boards_under(preset_rig("ideal", robot), shown.foot_poses)
    # Twice as large: smooth edges.
    images = rendered(robot, shown.joint_angles, shown.support, boards, 2 * width, 2 * height)
    columns = min(SHEET_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    sheet = Image.new("RGB", (columns * width, rows * height), "white")
    font = ImageFont.load_default(13)
    for k, (image, number) in enumerate(zip(images, shown.posture, strict=True)):
        at = (k % columns * width, k // columns * height)
        sheet.paste(Image.fromarray(image).resize(THUMB, Image.Resampling.LANCZOS), at)
        ImageDraw.Draw(sheet).text((at[0] + 6, at[1] + 4), str(number), fill="#222222", font=font)
    file = io.BytesIO()
    sheet.save(file, "PNG", optimize=True)
    return file.getvalue()


def standing_picture(robot: Robot) -> bytes:
    """Draw the keyframe `stand` on the plates; a PNG.

    Raises:
        InputError: nothing draws here.
    """
    angles = robot.model.key("stand").qpos[7:][None]
    pose = nominal_robot(robot).swing_sole(angles)[:, [0, 1, 5]]
    boards = boards_under(preset_rig("ideal", robot), np.stack([np.zeros_like(pose), pose], axis=1))
    image = rendered(robot, angles, np.array(["double"]), boards, *PORTRAIT)[0]
    out = io.BytesIO()
    Image.fromarray(image).save(out, "png")
    return out.getvalue()


def _pixels(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """x forward is up, y left is left."""
    return SCALE * (high - points)[..., ::-1]


def _shape(points: np.ndarray, low: np.ndarray, high: np.ndarray, style: str) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in _pixels(points, low, high))
    return f'<polygon points="{text}" {style}/>'


def _rectangle(pose: np.ndarray, half: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    corners = half * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return _shape(place_polygon(corners, pose), low, high, f'fill="#f3f5f7" stroke="{BOARD}"')


def _mass(point: np.ndarray, polygon: np.ndarray, number: int, low: np.ndarray, high: np.ndarray) -> str:
    """Draw the centre of mass, its number, and the shortest way to the edge."""
    (x, y), (u, v) = _pixels(np.array([point, nearest_on(point, polygon)]), low, high)
    away = np.array([x - u, y - v]) / max(np.hypot(x - u, y - v), 1e-9)
    tx, ty = x + 9 * away[0], y + 9 * away[1] + 3
    return (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}" stroke="{COM}" stroke-width="1"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.6" fill="{COM}"/>'
        f'<text x="{tx:.1f}" y="{ty:.1f}" font-size="9" text-anchor="middle" '
        f'stroke="white" stroke-width="2" stroke-opacity="0.8" paint-order="stroke">{number}</text>'
    )


def _legend(inner: float | None) -> str:
    box = '<rect x="0" y="-9" width="14" height="10"'
    entries = [
        (f'{box} fill="#f3f5f7" stroke="{BOARD}"/>', "board"),
        (f'{box} fill="none" stroke="{SOLE}"/>', "sole"),
        (f'{box} fill="{POLYGON}" fill-opacity="0.1" stroke="{POLYGON}"/>', "support polygon"),
        (f'<circle cx="7" cy="-4" r="3" fill="{COM}"/>', "centre of mass"),
        (f'<line x1="0" y1="-4" x2="14" y2="-4" stroke="{COM}"/>', "margin"),
    ]
    if inner is not None:
        line = f'<line x1="0" y1="-4" x2="14" y2="-4" stroke="{POLYGON}" stroke-dasharray="3 3"/>'
        entries.insert(3, (line, f"{1e3 * inner:.0f} mm inside"))
    x, parts = float(GAP), []
    for drawn, text in entries:
        parts.append(
            f'<g transform="translate({x:.0f} 44)">{drawn}<text x="20" y="0" font-size="11">{text}</text></g>'
        )
        x += 34 + 6.2 * len(text)
    style = f'x="{GAP}" y="24" font-size="14" font-weight="bold"'
    return f"<text {style}>Support polygons, from above, forward up</text>{''.join(parts)}"
