"""Tables of a campaign: its experiments, the posterior of each explanation, the error of the parameters."""

from __future__ import annotations

from tulip_testbed.base.table import Column, Table
from tulip_testbed.experiments.campaigns.campaign_record import CampaignRecord, Step


def campaign_parts(record: CampaignRecord) -> list[Table | str]:
    """Return the story of a campaign."""
    return [*campaign_story(record), experiment_table(record), posterior_table(record)]


def campaign_story(record: CampaignRecord) -> list[str]:
    """Tell a campaign in sentences."""
    lines = [_told(step) for step in record.steps]
    first, last = record.steps[0], record.steps[-1]
    minutes = f"{sum(step.minutes for step in record.steps):.0f} minutes of laboratory time (assumed)"
    before = ("", "") if first is last else (f"{first.error_mm:.2f} to ", f"{_relative(first)} to ")
    verb = "is" if first is last else "went from"
    lines.append(
        f"{record.ended} The r.m.s. error of the base parameters {verb} {before[0]}{last.error_mm:.2f} mm, "
        f"{before[1]}{_relative(last)} times their standard errors, in {minutes}."
    )
    return lines


def _relative(step: Step) -> str:
    return f"{step.error_over_standard_error:.2f}"


def _told(step: Step) -> str:
    return (
        f"Experiment {step.number} ({step.words}, {step.postures} postures): {step.verdict}. {step.story[0]}"
    )


def experiment_table(record: CampaignRecord) -> Table:
    """Return one row an experiment."""
    columns = (
        Column("no.", format="d"),
        Column("experiment"),
        Column("postures", format="d"),
        Column("time", "min", ".0f"),
        Column("verdict"),
        Column("doubt", "nat", ".2f"),
        Column("expected", "nat", ".2f"),
        Column("r.m.s. error", "mm", ".2f"),
        Column("error over s.e.", format=".2f"),
    )
    rows = [
        [
            *(step.number, step.words, step.postures, step.minutes, step.verdict),
            *(step.entropy, step.expected_entropy, step.error_mm, step.error_over_standard_error),
        ]
        for step in record.steps
    ]
    note = "Doubt: entropy of the explanations' posterior; expected: before the experiment."
    return Table("Experiments", columns, rows, note)


def posterior_table(record: CampaignRecord) -> Table:
    """Return the posterior probability of every explanation after every experiment."""
    columns = (Column("explanation"), *(Column(f"after {s.number}", "%", ".1f", 100.0) for s in record.steps))
    rows = [[label, *values] for label, values in posterior(record).items()]
    return Table("Posterior probability of each explanation of its gap", columns, rows)


def posterior(record: CampaignRecord) -> dict[str, list[float | None]]:
    """Return the probability of every explanation after every experiment, None: it was none any more."""
    labels = dict.fromkeys(one.label for step in record.steps for one in step.explanations)
    out: dict[str, list[float | None]] = {}
    for label in labels:
        found = [
            {one.label: one.probability for one in step.explanations}.get(label) for step in record.steps
        ]
        out[label] = found
    return out


def parameter_error_table(record: CampaignRecord) -> Table:
    """Return the error of every base parameter after the first and the last experiment."""
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("truth", "mm", ".2f"),
        *(Column(f"error after {s.number}", "mm", "+.2f") for s in record.steps),
        Column("s.e. at the end", "mm", ".2f"),
    )
    rows = [
        [
            *(last.number, last.name, last.truth_mm),
            *(step.parameters[k].estimate_mm - step.parameters[k].truth_mm for step in record.steps),
            last.standard_error_mm,
        ]
        for k, last in enumerate(record.steps[-1].parameters)
    ]
    return Table("Base parameters", columns, rows)
