"""The page's sentences."""

from __future__ import annotations

from typing import Any

from tulip_testbed.experiments import parameter_tables
from tulip_testbed.experiments.montecarlo import calibration_tables
from tulip_testbed.experiments.montecarlo.calibration_report import CalibrationReport
from tulip_testbed.experiments.validation_record import Report

POLYGON_WORDS = (
    "From above, as the paper's Fig. 2 (x points up, y to the left): plates light blue, the support polygon "
    "of a placement's first posture orange, CoP of all its postures as vermilion dots, CoM by truth as green "
    "crosses. Below, some postures as in the paper's Fig. 3."
)
CALIBRATION_WORDS = (
    "Found over stated: the scatter of the errors over the runs against the standard error that the "
    "estimator stated. Coverage: share of the runs whose interval held the truth. Intervals of 95 % for "
    "every single figure; the verdict's are wider, since they hold for all at once."
)
NO_TRUE_COM = "The true centre of mass of each posture is not shown: the statics engine does not record it."

EVIDENCE_WORDS = (
    "Explanations of one gap whose ln of the Bayes factor is within 3 of the best cannot be distinguished "
    "by this experiment; all of them are listed. Others of the catalogue explain it less well.",
    "What was tried, and is not enough: it leaves more than noise.",
)
GAP_WORDS = (
    "Residuals of placements that took no part in the fit, as multiples of the noise: 1 is noise.",
    "Before and after, the base parameters are fitted to all four channels at once. A fit to the centre of "
    "pressure alone (tulip identify) leaves less in it before, because the parameters bend to the effect.",
)
ORDINARY_WORDS = (
    "Every encoder, cell, link, joint and plate is a little off. All of these errors are estimated together "
    "with the robot; those that the measurements determine are added to the model."
)
VERDICTS = {
    "calibrated": "Ordinary imperfections explain the measurements.",
    "named": "One explanation is left.",
    "described": "A law describes it.",
    "ambiguous": "Several explanations are left.",
    "unknown": "No explanation is good enough.",
    "none": "Nothing is missing that these postures can show.",
}


def validation_sentence(report: Report) -> str:
    """What a validation's verdict means."""
    failed = [check.name for check in report.checks if check.result == "fail"]
    evaluated = sum(check.result != "not evaluated" for check in report.checks)
    if failed:
        return f"The estimates cannot be trusted here: {len(failed)} of {evaluated} checks failed, " + (
            f"{', '.join(failed)}."
        )
    return (
        f"In this laboratory, with these sensors and postures, the estimates and the standard errors they "
        f"come with are right: all {evaluated} evaluated checks passed. They cannot rule out effects that "
        "the simulator does not model."
    )


def montecarlo_sentence(report: CalibrationReport) -> str:
    """What a Monte Carlo's verdict means."""
    failed = [check.name for check in report.checks if check.result == "fail"]
    if failed:
        return f"The estimator is wrong about its own errors: {', '.join(failed)}."
    if report.shown:
        return f"The estimator is right about its own errors: {report.identified} runs show it."
    return (
        f"Inconclusive: nothing in {report.identified} runs contradicts the estimator's own errors, but "
        "they are too few to show that these are right: some intervals reach beyond the bounds."
    )


def parameter_words(report: dict[str, Any]) -> tuple[str, ...]:
    """Return how the table of a validation's parameters is read."""
    return (f"Estimator: {report['estimator']}. {parameter_tables.LEGEND}",)


def calibration_words(report: dict[str, Any]) -> tuple[str, ...]:
    """Return how the figures of a Monte Carlo are read, and what its tables do not say."""
    return (calibration_tables.LEGEND, *calibration_tables.calibration_lines(report))


def dropped(report: dict[str, Any]) -> str:
    """Which postures could not be measured, and why."""
    if not report["dropped"]:
        return f"All {report['postures_planned']} planned postures could be measured."
    reasons = "; ".join(f"{entry['posture']}: {entry['reason']}" for entry in report["dropped"])
    return f"Dropped {len(report['dropped'])} of {report['postures_planned']} postures. {reasons}."
