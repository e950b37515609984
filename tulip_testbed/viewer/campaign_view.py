"""A campaign: the postures of all experiments, and over the experiments doubt, explanations and errors."""

from __future__ import annotations

import re

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.experiments.campaigns.campaign_record import CampaignRecord
from tulip_testbed.experiments.campaigns.campaign_tables import campaign_story, posterior
from tulip_testbed.viewer.balance_series import log_balance
from tulip_testbed.viewer.layout import Views, above_view, laid_out, space_views
from tulip_testbed.viewer.plates_view import log_plates
from tulip_testbed.viewer.plots import log_curves
from tulip_testbed.viewer.robot_view import log_geometry, log_motion
from tulip_testbed.viewer.subject import planned

PLOTS = {"posterior": "Explanations, %", "errors": "Error of the base parameters, mm", "doubt": "Doubt, nat"}


def log_campaign(recording: rr.RecordingStream, run: CampaignRecord) -> None:
    """Log a campaign: the robot in the postures of the first experiment, and curves over the experiments."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    subject = planned(run.plan, run.robot)
    index = rr.TimeColumn("posture", sequence=np.arange(1, len(subject) + 1))
    log_geometry(recording, "world/robot", run.robot.visual_model)
    log_motion(recording, "world/robot", index, subject)
    log_plates(recording, "world/plates", index, subject)
    log_balance(recording, index, subject)
    number = rr.TimeColumn("experiment", sequence=np.array([step.number for step in run.steps]))
    for name, curves in plots(run).items():
        log_curves(recording, f"plots/{name}", number, curves)
    told = [f"# {run.robot.name}: campaign", "", *(f"- {line}" for line in campaign_story(run))]
    document = rr.TextDocument("\n".join(told), media_type=rr.MediaType.MARKDOWN)
    recording.log("text", document, static=True)
    views = Views(
        space=[*space_views(subject)],
        ground=[above_view(subject.plates, subject.board.size)],
        curves=[
            rrb.TimeSeriesView(
                origin=f"plots/{name}",
                name=f"{title} (time line: experiment)",
                plot_legend=rrb.Corner2D.RightTop,
            )
            for name, title in PLOTS.items()
        ],
        text=[rrb.TextDocumentView(origin="text", name="Campaign")],
    )
    recording.send_blueprint(laid_out(views))


def plots(run: CampaignRecord) -> dict[str, dict[str, np.ndarray]]:
    """Return what is plotted over the experiments, by plot, (k,) each."""
    shares = {
        re.sub(r"\W", "_", label): np.array([0.0 if value is None else 100 * value for value in values])
        for label, values in posterior(run).items()
    }
    errors = {"r.m.s.": np.array([step.error_mm for step in run.steps])}
    errors |= {
        first.name: np.array([s.parameters[k].estimate_mm - s.parameters[k].truth_mm for s in run.steps])
        for k, first in enumerate(run.steps[0].parameters)
    }
    doubt = np.array([np.nan if step.entropy is None else step.entropy for step in run.steps])
    return {"posterior": shares, "errors": errors, "doubt": {"doubt": doubt}}
