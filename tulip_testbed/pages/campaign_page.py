"""The page of a campaign: the explanations and the errors of the parameters after each experiment."""

from __future__ import annotations

from tulip_testbed.experiments.campaigns.campaign_record import CampaignRecord
from tulip_testbed.experiments.campaigns.campaign_tables import (
    campaign_story,
    experiment_table,
    parameter_error_table,
    posterior,
    posterior_table,
)
from tulip_testbed.pages.campaign_figures import error_figure, posterior_figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, title_of
from tulip_testbed.pages.words import VERDICTS

KNOWN_WORDS = (
    "Each experiment was the one that was expected to settle most of the doubt a minute of laboratory time. "
    "Probabilities are those of the explanations that discovery could not distinguish; one that has none was "
    "no explanation any more."
)
ERROR_WORDS = (
    "Identified with what discovery adopted. An effect that is not adopted, because several explanations are "
    "left, biases the parameters that imitate it."
)


def campaign_page(run: CampaignRecord) -> Page:
    """Make the page of a campaign."""
    last, story = run.steps[-1], campaign_story(run)
    sections = [
        Section(
            "Explanations after each experiment",
            (KNOWN_WORDS,),
            (experiment_table(run), posterior_table(run)),
            (posterior_figure(run),) if posterior(run) else (),
        ),
        Section("Base parameters", (ERROR_WORDS,), (parameter_error_table(run),), (error_figure(run),)),
        how_it_was_made(run),
    ]
    facts = (
        ("experiments", str(len(run.steps))),
        ("postures", str(sum(step.postures for step in run.steps))),
        ("laboratory time (assumed), min", f"{sum(step.minutes for step in run.steps):.0f}"),
        ("computing, s", f"{sum(step.wall_s for step in run.steps):.0f}"),
        ("hidden", ", ".join(run.document.configuration.effects) or "nothing"),
    )
    sentence = f"{VERDICTS[last.verdict]} {run.ended}"
    return Page(title_of(run), last.verdict, sentence, facts, tuple(sections), story=tuple(story))
