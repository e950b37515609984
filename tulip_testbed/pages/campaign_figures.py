"""Figures of a campaign's page."""

from __future__ import annotations

import plotly.graph_objects as go

from tulip_testbed.colours import PALETTE
from tulip_testbed.experiments.campaigns.campaign_record import CampaignRecord
from tulip_testbed.experiments.campaigns.campaign_tables import posterior
from tulip_testbed.pages.figures import Figure, figure


def posterior_figure(run: CampaignRecord) -> Figure:
    """Draw the posterior probability of every explanation after every experiment."""
    drawn, said = go.Figure(), []
    at = [f"{step.number}: {step.words}" for step in run.steps]
    for k, (label, values) in enumerate(posterior(run).items()):
        shown = [0.0 if value is None else 100 * value for value in values]
        drawn.add_bar(x=at, y=shown, name=label, marker={"color": PALETTE[k % len(PALETTE)]})
        said.append(f"{label}: {', '.join(f'{value:.0f} %' for value in shown)}")
    drawn.update_layout(barmode="group")
    drawn.update_yaxes(title="posterior probability, %", range=[0, 105])
    return figure("posterior", "Explanations after each experiment.", "; ".join(said) + ".", drawn)


def error_figure(run: CampaignRecord) -> Figure:
    """Draw the error of every base parameter after every experiment."""
    drawn = go.Figure()
    names = [f"{row.number} {row.name}" for row in run.steps[0].parameters]
    for k, step in enumerate(run.steps):
        errors = [row.estimate_mm - row.truth_mm for row in step.parameters]
        marker = {"color": PALETTE[k % len(PALETTE)], "size": 9}
        drawn.add_scatter(x=names, y=errors, mode="markers", name=f"after {step.number}", marker=marker)
    drawn.update_yaxes(title="estimate minus truth, mm", zeroline=True)
    text = "; ".join(f"after experiment {s.number}: r.m.s. {s.error_mm:.2f} mm" for s in run.steps)
    return figure("errors", "Error of every base parameter after each experiment.", text + ".", drawn, 420)
