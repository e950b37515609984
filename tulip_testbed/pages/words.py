"""The page's sentences."""

from __future__ import annotations

from typing import Any

from tulip_testbed.experiments import parameter_tables
from tulip_testbed.experiments.montecarlo import coverage_tables
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.validation_record import Report

POLYGON_WORDS = (
    "View from above, as in the paper's Fig. 2 (x points up, y to the left): plates light blue, the support "
    "polygon of a placement's first posture orange, the CoP of all its postures as vermilion dots, the true "
    "CoM as green crosses. Below, some postures as in the paper's Fig. 3."
)
NO_TRUE_COM = "The true centre of mass of each posture is not shown: the statics engine does not record it."

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
VERDICTS = {
    "calibrated": "Ordinary imperfections explain the measurements.",
    "named": "One explanation fits.",
    "described": "A law describes the gap.",
    "ambiguous": "Several explanations fit.",
    "unknown": "No explanation is sufficient.",
    "none": "These postures show no effect that the model lacks.",
}


def validation_sentence(report: Report) -> str:
    """Return the meaning of a validation's verdict in a sentence."""
    failed = [check.name for check in report.checks if check.result == "fail"]
    evaluated = sum(check.result != "not evaluated" for check in report.checks)
    if failed:
        return f"The estimates cannot be trusted here: {len(failed)} of {evaluated} checks failed, " + (
            f"{', '.join(failed)}."
        )
    return (
        f"In this laboratory, with these sensors and postures, the estimates and their standard "
        f"errors are right: all {evaluated} evaluated checks passed. They cannot rule out effects that "
        "the simulator does not model."
    )


def montecarlo_sentence(run: MonteCarlo) -> str:
    """Return the meaning of a Monte Carlo's verdict in a sentence."""
    failed = [check.name for check in run.checks if check.result == "fail"]
    if failed:
        return f"The estimator is wrong about its own errors: {', '.join(failed)}."
    if run.shown:
        return f"The estimator is right about its own errors: {run.identified} runs show it."
    return (
        f"Inconclusive: nothing in {run.identified} runs contradicts the estimator's own errors, but "
        "they are too few to show that these are right: some intervals reach beyond the bounds."
    )


def parameter_words(report: dict[str, Any]) -> tuple[str, ...]:
    """Return the explanation of the table of a validation's parameters."""
    return (f"Estimator: {report['estimator']}. {parameter_tables.LEGEND}",)


def coverage_words(report: dict[str, Any]) -> tuple[str, ...]:
    """Return the explanation of the figures of a Monte Carlo, with the results that its tables lack."""
    return (coverage_tables.LEGEND, *coverage_tables.coverage_lines(report))


def dropped(report: dict[str, Any]) -> str:
    """Return the postures that could not be measured, with the reasons."""
    if not report["dropped"]:
        return f"All {report['postures_planned']} planned postures could be measured."
    reasons = "; ".join(f"{entry['posture']}: {entry['reason']}" for entry in report["dropped"])
    return f"Dropped {len(report['dropped'])} of {report['postures_planned']} postures. {reasons}."
