"""Log postures: a plan's, a measurement folder's or a validation's."""

from __future__ import annotations

import numpy as np
import rerun as rr

from tulip_testbed.colours import COMMAND, SKELETON
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.viewer.balance_series import log_balance, log_close_up
from tulip_testbed.viewer.canvas import Canvas
from tulip_testbed.viewer.layout import laid_out, posture_views
from tulip_testbed.viewer.plates_view import log_plates, log_subject_loads
from tulip_testbed.viewer.plots import curves, log_curves, posture_text
from tulip_testbed.viewer.robot_view import log_geometry, log_masses, log_motion, log_skeleton
from tulip_testbed.viewer.subject import Subject


def log_postures(recording: rr.RecordingStream, subject: Subject) -> None:
    """Log all data of the postures and the blueprint."""
    canvas = log_standing(recording, subject)
    log_links(canvas, subject)
    if subject.command is not None:
        log_skeleton(canvas, "world/commanded", subject, subject.command, COMMAND)
    log_close_up(canvas, subject)
    for name, lines in curves(subject).items():
        log_curves(canvas, name, lines)
    texts = [posture_text(subject, row) for row in range(len(subject))]
    canvas.rows("text", rr.TextDocument, {"media_type": rr.MediaType.MARKDOWN}, text=texts)
    recording.send_blueprint(laid_out(posture_views(subject), canvas.index.timeline_name()))


def log_standing(
    recording: rr.RecordingStream, subject: Subject, sequence: np.ndarray | None = None
) -> Canvas:
    """Log the robot on its plates with everything on the ground.

    Args:
        sequence: number of each row on the time line, (m,); None: 1, 2, ...
    """
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_geometry(recording, "world/robot", subject.nominal.robot.visual_model)
    canvas = Canvas(recording, _time_line(subject, sequence))
    log_motion(canvas, subject)
    log_plates(canvas, subject)
    log_subject_loads(canvas, subject)
    log_balance(canvas, subject)
    return canvas


def _time_line(subject: Subject, sequence: np.ndarray | None) -> rr.TimeColumn:
    """Return the time of a robot that moves, otherwise the numbers of the rows."""
    m = subject.measurements
    if sequence is None and m is not None and m.joint_rates is not None and np.isfinite(m.time).all():
        return rr.TimeColumn("time", duration=m.time + m.window / 2)
    return rr.TimeColumn("posture", sequence=np.arange(1, len(subject) + 1) if sequence is None else sequence)


def log_links(canvas: Canvas, subject: Subject) -> None:
    """Log the masses of the links, the true ones too where they differ, and the skeleton."""
    nominal = standard_parameters(subject.nominal.robot.visual_model)
    others = {name: true for name, true in subject.true_masses.items() if not np.allclose(true, nominal)}
    log_masses(canvas, subject, {"nominal model": nominal} | others)
    log_skeleton(canvas, "world/masses/skeleton", subject, subject.joint_angles, SKELETON)
