"""Log postures: a plan's, a measurement folder's or a validation's."""

from __future__ import annotations

import numpy as np
import rerun as rr

from tulip_testbed.colours import COMMAND, SKELETON
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.viewer.balance_series import log_balance, log_close_up
from tulip_testbed.viewer.layout import laid_out, posture_views
from tulip_testbed.viewer.plates_view import log_plates, log_subject_loads
from tulip_testbed.viewer.plots import curves, log_curves, log_text
from tulip_testbed.viewer.robot_view import log_geometry, log_masses, log_motion, log_skeleton
from tulip_testbed.viewer.subject import Subject
from tulip_testbed.viewer.time_series import log_series


def log_postures(recording: rr.RecordingStream, subject: Subject) -> None:
    """Log all data of the postures and the blueprint."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    model = subject.nominal.robot.visual_model
    log_geometry(recording, "world/robot", model)
    index = rr.TimeColumn("posture", sequence=np.arange(1, len(subject) + 1))
    log_motion(recording, "world/robot", index, subject)
    masses = {"nominal model": standard_parameters(model)}
    for name, standard in subject.true_masses.items():
        if not np.allclose(standard, masses["nominal model"]):
            masses[name] = standard
    log_masses(recording, "world/masses", index, subject, masses)
    log_skeleton(recording, "world/masses/skeleton", index, subject, subject.joint_angles, SKELETON)
    if subject.command is not None:
        log_skeleton(recording, "world/commanded", index, subject, subject.command, COMMAND)
    log_plates(recording, "world/plates", index, subject)
    log_subject_loads(recording, "world/loads", index, subject)
    log_balance(recording, index, subject)
    log_close_up(recording, index, subject)
    for name, lines in curves(subject).items():
        log_curves(recording, f"plots/{name}", index, lines)
    log_text(recording, "text", index, subject)
    if subject.series is not None:
        log_series(recording, subject)
    recording.send_blueprint(laid_out(posture_views(subject)))
