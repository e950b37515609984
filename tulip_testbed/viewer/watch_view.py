"""The live view of `watch`: the robot in the last posture, misfit by channel, standard errors, verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from tulip_testbed.experiments.watching.watch_row import OK, Verdict
from tulip_testbed.experiments.watching.watch_tables import line
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.residual_channels import CHANNELS
from tulip_testbed.sim.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.standing import link_frames
from tulip_testbed.viewer import window
from tulip_testbed.viewer.robot_view import log_geometry

TIMELINE = "row"


@contextmanager
def served_watch(
    plan: PosturePlan, robot: Robot, announce: Callable[[str], None]
) -> Iterator[Callable[[Verdict], None]]:
    """Serve a view of the day to browsers of this machine while the context lasts.

    Args:
        announce: called with the address.

    Yields:
        The function to call with the verdict of each posture.
    """
    nominal = nominal_robot(robot, common_support(plan.support))
    with window.serve_live("watch", announce) as recording:
        begin(recording, nominal)
        rows = iter(range(1, 10**9))
        yield lambda verdict: log_verdict(recording, plan, nominal, verdict, next(rows))


def begin(recording: rr.RecordingStream, nominal: Nominal) -> None:
    """Log the data that do not change, and the blueprint."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_geometry(recording, "world/robot", nominal.robot.visual_model)
    recording.send_blueprint(
        rrb.Blueprint(
            rrb.Horizontal(
                rrb.Spatial3DView(origin="world", name="Robot"),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin="misfit", name="Misfit, standard deviations"),
                    rrb.TimeSeriesView(origin="errors", name="Standard errors, mm"),
                    rrb.TextLogView(origin="verdicts", name="Verdicts"),
                ),
            ),
            rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        )
    )


def log_verdict(
    recording: rr.RecordingStream, plan: PosturePlan, nominal: Nominal, verdict: Verdict, row: int
) -> None:
    """Log one posture.

    Args:
        row: number of the verdict, from 1.
    """
    recording.set_time(TIMELINE, sequence=row)
    for channel in CHANNELS:
        if np.isfinite(verdict.misfit[channel]):
            recording.log(f"misfit/{channel}", rr.Scalars(verdict.misfit[channel]))
    errors = 1e3 * np.array(list(verdict.standard_errors.values()))
    if np.isfinite(errors).all():
        recording.log("errors/largest", rr.Scalars(float(errors.max())))
        recording.log("errors/median", rr.Scalars(float(np.median(errors))))
    level = rr.TextLogLevel.INFO if verdict.verdict == OK else rr.TextLogLevel.WARN
    recording.log("verdicts", rr.TextLog(line(verdict), level=level))
    planned = np.flatnonzero(plan.posture == verdict.posture)[:1]
    if not len(planned):
        return
    rotations, positions = link_frames(nominal, plan.joint_angles[planned], plan.support[planned])
    tree = nominal.parameters.tree
    for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
        quaternion = rr.Quaternion(xyzw=Rotation.from_matrix(rotations[0, frame]).as_quat())
        recording.log(
            f"world/robot/{link}", rr.Transform3D(translation=positions[0, frame], quaternion=quaternion)
        )
