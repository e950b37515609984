"""The live view of `watch`: the robot in the last posture, misfit by channel, standard errors, verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from tulip_testbed.experiments.discovery_tables import CHANNEL_NAMES
from tulip_testbed.experiments.watching.watch_row import OK, Verdict
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.residual_channels import CHANNELS
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.standing import link_frames
from tulip_testbed.viewer import window
from tulip_testbed.viewer.canvas import blueprint
from tulip_testbed.viewer.layout import space_view
from tulip_testbed.viewer.robot_view import log_geometry
from tulip_testbed.viewer.subject import planned

TIMELINE = "row"
SHOWN = 1000.0  # mm: larger standard errors, of the first postures, would flatten the curve of all others


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
        begin(recording, plan, nominal)
        rows = iter(range(1, 10**9))
        yield lambda verdict: log_verdict(recording, plan, nominal, verdict, next(rows))


def begin(recording: rr.RecordingStream, plan: PosturePlan, nominal: Nominal) -> None:
    """Log the data that do not change, and the blueprint."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_geometry(recording, "world/robot", nominal.robot.visual_model)
    for channel in CHANNELS:
        line_name = rr.SeriesLines(names=CHANNEL_NAMES[channel])
        recording.log(f"misfit/{channel}", line_name, static=True)
    views = rrb.Horizontal(
        space_view(planned(plan, nominal.robot), "Robot in the last posture", ["$origin/**"]),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="misfit", name="Misfit, standard deviations"),
            rrb.TimeSeriesView(origin="errors", name="Standard errors, mm"),
            rrb.TextLogView(origin="verdicts", name="Verdicts"),
        ),
    )
    recording.send_blueprint(blueprint(views, TIMELINE, fps=None))


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
    if (errors < SHOWN).all():
        recording.log("errors/largest", rr.Scalars(float(errors.max())))
        recording.log("errors/median", rr.Scalars(float(np.median(errors))))
    level = rr.TextLogLevel.INFO if verdict.verdict == OK else rr.TextLogLevel.WARN
    recording.log("verdicts", rr.TextLog(str(verdict), level=level))
    there = np.flatnonzero(plan.posture == verdict.posture)[:1]
    if not len(there):
        return
    rotations, positions = link_frames(nominal, plan.joint_angles[there], plan.support[there])
    tree = nominal.parameters.tree
    for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
        quaternion = rr.Quaternion(xyzw=Rotation.from_matrix(rotations[0, frame]).as_quat())
        recording.log(
            f"world/robot/{link}", rr.Transform3D(translation=positions[0, frame], quaternion=quaternion)
        )
