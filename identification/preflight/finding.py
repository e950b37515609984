"""A finding of the preflight, and the levels at which checks warn and fail."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tulip_testbed.base.result import InMemory
from tulip_testbed.measurements import Measurements

# A healthy folder should fail in at most 1 % of cases and warn in at most 5 %, however many of the
# statistical checks are evaluated: Bonferroni over all of them.
STATISTICAL_CHECKS = 11
FAIL_LEVEL = 0.01 / STATISTICAL_CHECKS
WARN_LEVEL = 0.05 / STATISTICAL_CHECKS

RESULTS = ("pass", "warn", "fail", "not evaluated")


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes:
        result: one of `RESULTS`.
        seen, expected: found and expected state as text with numbers and units; for a check that was not
            evaluated, `seen` is the reason.
        where: posture, placement, joint or cell with the largest deviation.
        advice: action to take.
        p_value: p-value of a statistical check under the hypothesis of a healthy folder.
        gross: whether the fault is larger than any that a search for effects can explain.
    """

    name: str
    result: str
    seen: str
    expected: str = ""
    where: str = ""
    advice: str = ""
    p_value: float | None = None
    gross: InMemory[bool] = False


def skipped(name: str, reason: str) -> Finding:
    return Finding(name, "not evaluated", reason)


def result_of(p_value: float) -> str:
    """Return the result of a statistical check with this p-value."""
    return "fail" if p_value < FAIL_LEVEL else "warn" if p_value < WARN_LEVEL else "pass"


def worst_of(results: list[str]) -> str:
    """Return the worst of several results; "pass" if there are none."""
    order = ("not evaluated", "pass", "warn", "fail")
    return max(results, key=order.index, default="pass")


def bonferroni(p_values: ArrayLike) -> float:
    """Return the smallest p-value, adjusted for the number of tests."""
    every = np.ravel(p_values)
    return float(min(1.0, every.min() * every.size))


def row_name(measurements: Measurements, row: int) -> str:
    """Return the name of a posture with its placement, and its row if the robot is held in it."""
    place = f"placement {measurements.placement[row]}"
    held = f"row {row + 1}, " if measurements.joint_rates is None else ""
    return f"posture {measurements.posture[row]} ({held}{place})"


def few(texts: list[str]) -> list[str]:
    """Return the first three texts, and the number of the others."""
    return texts if len(texts) <= 3 else [*texts[:3], f"and {len(texts) - 3} more"]
