"""Drawn postures for a page."""

import base64
import io
from dataclasses import dataclass

import numpy as np
from PIL import Image

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.rendering import rendered
from tulip_testbed.sim.robot import Robot

PICTURES = 4  # how many postures are drawn
SIZE = (360, 480)  # pixels, of a picture


@dataclass(frozen=True)
class Picture:
    """A drawn posture as a data address, with its description."""

    address: str
    caption: str
    text: str


def posture_pictures(
    robot: Robot, postures: Measurements | PosturePlan, plates: np.ndarray, missing: list[str]
) -> tuple[Picture, ...]:
    """Draw postures spread over the experiment; a reason not to draw them is added to `missing`."""
    rows = np.unique(np.linspace(0, len(postures) - 1, PICTURES).astype(int))
    drawn = addresses(robot, postures, rows, plates, SIZE, missing)
    names = [f"Posture {postures.posture[k]}, placement {postures.placement[k]}" for k in rows[: len(drawn)]]
    return tuple(
        Picture(address, name, f"The robot on its two plates: {name}.")
        for name, address in zip(names, drawn, strict=True)
    )


def addresses(
    robot: Robot,
    postures: Measurements | PosturePlan,
    rows: np.ndarray,
    plates: np.ndarray,
    size: tuple[int, int],
    missing: list[str],
) -> list[str]:
    """Draw some rows as data addresses; if that fails, none: `missing` says why."""
    try:
        images = rendered(robot, postures.joint_angles[rows], postures.support[rows], plates[rows], *size)
    except InputError as error:
        missing.append(f"Pictures of postures: {error}.")
        return []
    drawn = []
    for image in images:
        Image.fromarray(image).save(file := io.BytesIO(), "WEBP", quality=85)
        drawn.append("data:image/webp;base64," + base64.b64encode(file.getvalue()).decode())
    return drawn
