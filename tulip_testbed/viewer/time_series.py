"""The dynamics of the holds: raw readings on the `time` line, thinned so that a view stays small."""

from __future__ import annotations

import dataclasses

import numpy as np
import rerun as rr

from tulip_testbed.colours import COMMAND
from tulip_testbed.identification.center_of_pressure import cell_positions, center_of_pressure
from tulip_testbed.viewer.balance_series import log_balance, log_close_up
from tulip_testbed.viewer.canvas import Canvas
from tulip_testbed.viewer.plates_view import log_loads, log_plates
from tulip_testbed.viewer.plots import curves, log_curves, log_text
from tulip_testbed.viewer.robot_view import log_motion, log_skeleton
from tulip_testbed.viewer.subject import Subject

MOST_POSES, MOST_READINGS = 2_000, 20_000


def log_series(recording: rr.RecordingStream, subject: Subject) -> None:
    """Log curves of at most `MOST_READINGS` samples, and the robot at `MOST_POSES` of them.

    Ground and numbers are those of the window's averages, from its start on.
    """
    dense, t = sampled(subject, MOST_READINGS)
    canvas = Canvas(recording, rr.TimeColumn("time", duration=t))
    for name, lines in curves(dense).items():
        if name.split("/")[0] in ("cells", "tracking", "joints", "cop"):
            log_curves(canvas, name, lines)
    dense, t = sampled(subject, MOST_POSES)
    canvas = Canvas(recording, rr.TimeColumn("time", duration=t))
    log_motion(canvas, dense)
    if dense.command is not None:
        log_skeleton(canvas, "world/commanded", dense, dense.command, COMMAND)
    log_plates(canvas, dense)
    assert dense.measurements is not None
    positions = cell_positions(dense.measurements)
    log_loads(canvas, positions, dense.measurements.cell_forces, dense.weight)
    assert subject.measurements is not None
    if np.isfinite(subject.measurements.time).all():
        begun = Canvas(recording, rr.TimeColumn("time", duration=subject.measurements.time))
        log_balance(begun, subject)
        log_close_up(begun, subject)
        log_text(begun, subject)


def sampled(subject: Subject, most: int) -> tuple[Subject, np.ndarray]:
    """Return the series as a subject with one row per sample in the order of time, and the times (n,) [s].

    A sample belongs to the row of its posture that began last before it.
    """
    series, measurements = subject.series, subject.measurements
    assert series is not None
    assert measurements is not None
    chosen = np.argsort(series.t, kind="stable")[:: -(-len(series.t) // most)]
    chosen = chosen[np.isin(series.posture[chosen], measurements.posture)]
    begun = np.where(np.isfinite(measurements.time), measurements.time, -np.inf)
    mine = series.posture[chosen, None] == measurements.posture
    # The row's own start counts, else the first of that posture.
    score = np.where(mine, np.where(begun <= series.t[chosen, None] + 1e-9, begun, -1e300), -np.inf)
    score = np.where(mine & np.isneginf(score), -1e308, score)
    row = np.argmax(score, axis=1)
    count = len(subject.nominal.parameters.tree.joints)
    readings = series.readings[chosen]
    taken = dataclasses.replace(
        measurements,
        **{name: getattr(measurements, name)[row] for name in _ROWS},
        joint_angles=readings[:, :count],
        cell_forces=readings[:, count:],
        command=None if measurements.command is None else measurements.command[row],
    )
    dense = dataclasses.replace(
        subject,
        joint_angles=taken.joint_angles,
        posture=taken.posture,
        placement=taken.placement,
        support=taken.support,
        plates=taken.plate_poses,
        com={},
        polygons=[],
        margin=subject.margin[row],
        command=taken.command,
        cell_forces=taken.cell_forces,
        cop=center_of_pressure(taken),
        measurements=taken,
    )
    return dense, series.t[chosen]


_ROWS = ("posture", "placement", "support", "time", "window", "samples", "plate_poses")
