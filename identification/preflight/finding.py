"""One finding of the preflight, and the levels at which it warns and fails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.sim.measurements import Measurements

# A healthy folder should fail in at most 1 % of cases and warn in at most 5 %, whatever number of its
# statistical checks is evaluated: Bonferroni over all that there are.
STATISTICAL_CHECKS = 11
FAIL_LEVEL = 0.01 / STATISTICAL_CHECKS
WARN_LEVEL = 0.05 / STATISTICAL_CHECKS

RESULTS = ("pass", "warn", "fail", "not evaluated")


@dataclass(frozen=True)
class Finding:
    """What one check saw.

    Attributes:
        result: one of `RESULTS`.
        seen, expected: in words, with numbers and units; `seen` is the reason where the check
            was not evaluated.
        where: posture, placement, joint or cell that stands out most.
        advice: what to do about it.
        p_value: chance of a healthy folder looking at least as bad, for statistical checks.
    """

    name: str
    result: str
    seen: str
    expected: str = ""
    where: str = ""
    advice: str = ""
    p_value: float | None = None


def skipped(name: str, reason: str) -> Finding:
    return Finding(name, "not evaluated", reason)


def result_of(p_value: float) -> str:
    """Result of a statistical check with this p-value."""
    return "fail" if p_value < FAIL_LEVEL else "warn" if p_value < WARN_LEVEL else "pass"


def worst_of(results: list[str]) -> str:
    """The worst of several results; "pass" if there is none."""
    order = ("not evaluated", "pass", "warn", "fail")
    return max(results, key=order.index, default="pass")


def bonferroni(p_values: np.ndarray) -> float:
    """Chance that the smallest of so many p-values is as small as this one, at most."""
    p_values = np.ravel(p_values)
    return float(min(1.0, p_values.min() * p_values.size))


def row_name(measurements: Measurements, row: int) -> str:
    """A posture as a laboratory finds it again."""
    return f"posture {measurements.posture[row]} (row {row + 1}, placement {measurements.placement[row]})"


def few(texts: list[str], most: int = 3) -> list[str]:
    """The first few texts, and how many more there are."""
    return texts if len(texts) <= most else [*texts[:most], f"and {len(texts) - most} more"]
