"""The page of a discovery: the findings, the residuals before and after, and the evidence."""

from dataclasses import replace

import numpy as np

from tulip_testbed.experiments import discovery_tables
from tulip_testbed.experiments.discovery_curves import Curve, law_curves, residual_curves, time_order
from tulip_testbed.experiments.discovery_result import FAMILIES, Discovered
from tulip_testbed.experiments.discovery_tables import CHANNEL_NAMES, MOST_P
from tulip_testbed.experiments.family_tables import family_table
from tulip_testbed.experiments.proposed_experiment import experiment_table
from tulip_testbed.experiments.rig_folder import DIFF
from tulip_testbed.pages import discovery_figures as drawn
from tulip_testbed.pages.figures import Figure
from tulip_testbed.pages.page import Page, Section, how_it_was_made, title_of

EVIDENCE_WORDS = (
    "Explanations of one gap whose ln of the Bayes factor is within 3 of the best cannot be distinguished "
    "by this experiment; all of them are listed. Others of the catalogue explain it less well.",
    "These explanations were tried and are not sufficient: the residual that they leave exceeds the noise.",
)
GAP_WORDS = (
    "Residuals of placements that took no part in the fit, as multiples of the noise: 1 is noise.",
    "Before and after, the base parameters are fitted to all four channels at once. A fit to the centre of "
    "pressure alone (tulip identify) leaves a smaller residual there before, because the parameters absorb "
    "part of the effect.",
)
ORDINARY_WORDS = (
    "Every encoder, cell, link, joint and plate has a small error. All of these errors are estimated "
    "together with the robot; those that the measurements determine are added to the model."
)


def discovery_page(discovery: Discovered) -> Page:
    """Make the page of a discovery; parts that it does not have are left out."""
    curves, held, adopted = residual_curves(discovery), discovery.heldout, list(discovery.laws)
    gap = [
        (name, held.before[channel], held.after[channel], held.floor[channel])
        for channel, name in CHANNEL_NAMES.items()
        if channel in held.before
    ]
    posture = discovery.searched.posture[time_order(discovery)]
    changed = bool(discovery.explanations or discovery.calibrated)
    tables = [
        family_table(discovery.families, FAMILIES),
        discovery_tables.calibrated_table(discovery.calibrated),
    ]
    ordinary = tuple(table for table in tables if table.rows)
    words = (ORDINARY_WORDS, *([tables[1].note] if discovery.calibrated and not tables[1].rows else []))
    sections = [
        Section(
            "The gap",
            GAP_WORDS,
            (discovery_tables.gap_table(held),),
            (drawn.gap_figure(gap), *_planes(curves, changed)),
        ),
        *([Section("Ordinary imperfections", words, ordinary)] if ordinary else []),
        Section(
            "Residuals over the experiment",
            (
                "Vermilion: as measured. Blue: with the found effects removed. Band: 95 % of the noise. The "
                "swing foot's x, y and yaw are shown about their mean in a stance: angles give no more.",
            ),
            figures=tuple(
                drawn.curve_figure(k, curve, posture, changed)
                for k, curve in enumerate(curves)
                if np.isfinite(curve.sd).any()
            ),
        ),
        _base_parameters(discovery),
    ]
    if discovery.explanations:
        said = (EVIDENCE_WORDS[discovery.verdict == "unknown"],)
        figure = drawn.evidence_figure(discovery.explanations, discovery.runners_up)
        tables = (discovery_tables.explanation_table(discovery.explanations),)
        sections.insert(1, Section("Evidence", said, tables, (figure,)))
    if adopted:
        said = [law.finding for law, _ in adopted]
        said += [
            f"As good: {other.what} as a function of {other.of} ({other.shape})."
            for _, others in adopted
            for other in others
        ]
        figures = tuple(drawn.law_figure(k, curve) for k, curve in enumerate(law_curves(discovery)))
        sections.insert(1, Section("The law", tuple(said), figures=figures))
    if discovery.next_experiments:
        ranking = experiment_table(discovery.next_experiments)
        sections.append(Section("Next experiment", tables=(ranking,)))
    sections.append(_limits(discovery))
    if discovery.check:
        sections.append(Section("In full dynamics", (discovery_tables.dynamics_line(discovery.check),)))
    if DIFF in discovery.rig_files:
        words = "Changes by the adopted rig. Its folder is for --corrections of other commands."
        differences = (("Differences", discovery.rig_files[DIFF]),)
        sections.append(Section("The adopted rig", (words,), folded=differences))
    sections.append(how_it_was_made(discovery.document))
    measured = discovery.measurements
    facts = (
        ("measurements", str(discovery.document.configuration.get("measurements"))),
        ("postures", str(len(np.unique(measured.posture)))),
        ("readings", str(len(measured))),
        ("placements", str(len(np.unique(measured.placement)))),
        ("repeated pairs", str(discovery.repeats.pairs)),
        ("search, s", f"{discovery.wall_s:.1f}"),
    )
    sentence, *story = discovery.story
    sentence = "\n".join([sentence, *discovery.answers])
    title, verdict = title_of(discovery), discovery.verdict
    return Page(title, verdict, sentence, facts, tuple(sections), story=tuple(story))


def _base_parameters(discovery: Discovered) -> Section:
    """Return the section of the base parameters, whose table is folded if a correction moved none of them."""
    both = discovery.before, discovery.after, discovery.adopted
    table, title = discovery_tables.moved_table(*both), "Base parameters"
    if not discovery.adopted or discovery_tables.moved_table(*both, all_of_them=False).rows:
        return Section(title, tables=(table,))
    return Section(title, (table.note,), folded=((f"All {len(table.rows)}", replace(table, note="")),))


def _planes(curves: list[Curve], changed: bool) -> tuple[Figure, ...]:
    """Draw the centre of pressure before and after side by side, at one scale."""
    x, y = curves[:2]
    sides = {"before": (x.before, y.before)} | ({"after": (x.after, y.after)} if changed else {})
    reach = 1.1 * max(float(np.abs(values).max()) for side in sides.values() for values in side)
    sd = float(np.sqrt((np.mean(x.sd**2) + np.mean(y.sd**2)) / 2))
    return tuple(drawn.plane_figure(name, *side, sd, reach) for name, side in sides.items())


def _limits(discovery: Discovered) -> Section:
    """Return the section of remaining patterns, repeats and effects that the postures cannot detect."""
    tables = [
        discovery_tables.pattern_table(discovery.patterns),
        discovery_tables.repeat_table(discovery.repeats),
        discovery_tables.undetectable_table(discovery.undetectable),
        discovery_tables.weak_table(discovery.weakly_detectable),
    ]
    words = tuple(f"Noise not as stated: {text}." for text in discovery.noise.assumed)
    if not tables[0].rows:
        words += (f"The remaining residuals have no pattern (p above {MOST_P} for all that were tried).",)
    return Section("Limits of the finding", words, tuple(table for table in tables if table.rows))
