"""Both plates at their recorded poses, and the loads on their cells."""

from __future__ import annotations

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from tulip_testbed.colours import CELL_COLOURS, rgb
from tulip_testbed.identification.center_of_pressure import cell_positions
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.viewer.canvas import Canvas
from tulip_testbed.viewer.subject import Subject

CELL_RADIUS = 0.012  # m
BOARD_COLOUR, THICKNESS = (158, 184, 204), 0.6  # share of the height that is board, not cell
METRES_PER_WEIGHT = 1.0  # an arrow of this length carries the robot's whole weight


def log_plates(canvas: Canvas, subject: Subject) -> None:
    """Log boards and cells at their recorded poses; the boards' top is z = 0."""
    for k, plate in enumerate(PLATES):
        poses, height = subject.plates[:, k], float(subject.top_height[k])
        half = [*(subject.board.size / 2), THICKNESS * (height or subject.board.top_height) / 2]
        place = np.column_stack([poses[:, :2], np.zeros(len(poses))])
        entity = f"world/plates/{plate}"
        canvas.poses(entity, Rotation.from_rotvec(poses[:, 2, None] * [0, 0, 1]), place)
        board = rr.Boxes3D(
            half_sizes=[half],
            centers=[[0, 0, -half[2]]],
            colors=[BOARD_COLOUR],
            fill_mode=rr.components.FillMode.Solid,
        )
        canvas.recording.log(f"{entity}/board", board, static=True)
        if not len(subject.cells[k]):
            continue
        cells = np.column_stack([subject.cells[k], np.full(4, CELL_RADIUS - height)])
        feet = rr.Points3D(cells, radii=CELL_RADIUS, colors=[rgb(colour) for colour in CELL_COLOURS])
        canvas.recording.log(f"{entity}/cells", feet, static=True)


def log_subject_loads(canvas: Canvas, subject: Subject) -> None:
    """Log the load on every cell, or on each foot if there are no cells; a plan has no loads."""
    if subject.measurements is not None and subject.cell_forces is not None:
        positions = cell_positions(subject.measurements)
        log_loads(canvas, positions, subject.cell_forces, subject.weight)
    elif subject.foot_loads is not None and subject.load_points is not None:
        log_loads(canvas, subject.load_points, subject.foot_loads, subject.weight)


def log_loads(canvas: Canvas, positions: np.ndarray, forces: np.ndarray, weight: float) -> None:
    """Log the load on every cell as an arrow down onto the board; a negative reading points up.

    Args:
        positions: of the cells, or of the load on each foot, in the base frame, (m, k, 2) [m].
        forces: (m, k) [N].
        weight: of the robot [N].
    """
    length = METRES_PER_WEIGHT * forces / weight
    zero = np.zeros_like(length)
    origins = np.dstack([positions, length]).reshape(-1, 3)
    vectors = np.dstack([zero, zero, -length]).reshape(-1, 3)
    count = forces.shape[1]
    colours = [rgb(colour) for colour in CELL_COLOURS] * 2 if count == 8 else [rgb(CELL_COLOURS[0])]
    style, lengths = {"colors": colours, "radii": 0.006}, [count] * len(forces)
    canvas.rows("world/loads", rr.Arrows3D, style, lengths, origins=origins, vectors=vectors)
