"""The verdict: checks that pass, fail or are not evaluated, each with its threshold."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Figure
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.identification.distributions import f_ppf, t_ppf
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.sim.outcome import Truth

LEVEL = 0.01  # of every statistical check
IDEAL_ERROR = 1e-3  # m, noise-free data only
IDEAL_MASS_ERROR = 1e-3  # kg, noise-free data only
CORRELATION_TOLERANCE = 0.01
CORRELATION_LIMIT = -0.95  # the paper: -0.9928 and -0.9882

# Largest imbalance of a hold, as a share of the weight [N], of the weight at 1 m [Nm] and of 1 m: what is
# larger moves the centre of pressure by more than 0.1 mm.
IMBALANCE = 1e-4
BALANCES = {
    "weight": ("cells against weight", "N"),
    "moments": ("plates' moments against the feet's wrench", "Nm"),
    "torques": ("torques against statics", "Nm or N"),
    "centre": ("CoP against CoM", "mm"),
}
MILLIMETRES = {"centre": 1e3}

# Residual sigma per axis (eq. 14) without noise: middle and half-width [mm]. With noise it depends on the
# robot's weight and size, so its description gives it, for 30 placements. The fewer the placements, the
# more it scatters: as the root of their number.
IDEAL_SIGMA_MM = (0.025, 0.025)
SIGMA_PLACEMENTS = 30


@dataclass(frozen=True)
class Check:
    """One line of the verdict.

    Attributes:
        result: "pass", "fail" or "not evaluated".
        threshold: an upper limit, or low and high.
        source: where the threshold comes from, or why the check was not evaluated.
    """

    name: str
    result: Literal["pass", "fail", "not evaluated"]
    value: Figure | None
    threshold: float | tuple[float, float] | None
    source: str


def below(name: str, value: float, limit: float, source: str) -> Check:
    return Check(name, "pass" if value <= limit else "fail", float(value), float(limit), source)


def within(name: str, value: float, low: float, high: float, source: str) -> Check:
    passed = low <= value <= high
    return Check(name, "pass" if passed else "fail", float(value), (float(low), float(high)), source)


def skipped(name: str, source: str) -> Check:
    return Check(name, "not evaluated", None, None, source)


def verdict(checks: Sequence[Check]) -> str:
    """ "fail" if any check fails, else "pass"."""
    return "fail" if any(check.result == "fail" for check in checks) else "pass"


def check_table(checks: Sequence[Check]) -> Table:
    numbers = ("value", "", ".4g"), ("threshold", "", ".4g")
    rows = []
    for check in checks:
        limit = check.threshold
        bound = (-math.inf, limit) if isinstance(limit, int | float) else limit
        rows.append([check.name, Cell(check.result, check.result), check.value, bound, check.source])
    heads = ("check", "result", *numbers, "where the threshold comes from")
    return Table("Checks", heads, rows)


def sigma_check(preset: str, sigma: float, placements: int, known: dict[str, list[float]]) -> Check:
    """Hold the residual sigma (eq. 14) [m] against its preset's range; known: middle and half-width [mm]."""
    name = "residual sigma (mm)"
    ranges = {"ideal": IDEAL_SIGMA_MM, **known}
    if preset not in ranges:
        return skipped(name, f"the robot's description gives no range for preset '{preset}'")
    middle, half = ranges[preset]
    half *= np.sqrt(max(SIGMA_PLACEMENTS / placements, 1.0))
    source = f"range of preset {preset} for {placements} placements"
    return within(name, 1e3 * sigma, max(middle - half, 0.0), middle + half, source)


def joint_check(name: str, estimate: Estimate, truth: np.ndarray) -> Check:
    """All errors at once: e' V^-1 e under the placement-clustered covariance.

    The chi-square over p as F, with degrees of freedom of how well V is known (Fai and Cornelius 1996). How
    often it fails true laboratories: docs/reference/verdict.md.
    """
    error = estimate.value - truth
    statistic = float(error @ np.linalg.solve(estimate.clustered_covariance, error)) / len(error)
    limit = float(f_ppf(1 - LEVEL, len(error), estimate.joint_dof))
    source = f"chi-square / {len(error)} as F({len(error)}, {estimate.joint_dof:.0f}), level {LEVEL}"
    return below(name, statistic, limit, source)


def largest_z_check(name: str, estimate: Estimate, truth: np.ndarray) -> Check:
    """Check the largest error in standard errors, by the t distribution of the parameter known worst."""
    z = np.abs(estimate.value - truth) / standard_errors(estimate.clustered_covariance)
    limit = float(t_ppf(1 - LEVEL / 2 / len(z), estimate.interval_dof.min()))
    return below(name, z.max(), limit, f"Bonferroni over {len(z)}, level {LEVEL}")


def ideal_error_check(name: str, estimate: Estimate, truth: np.ndarray, pairs: list[list[int]]) -> Check:
    """Largest error where nothing is noisy; correlated pairs by their sum."""
    error = dict(zip(estimate.numbers.tolist(), estimate.value - truth, strict=True))
    for a, b in pairs:
        if a in error and b in error:
            error[a] = error.pop(b) + error[a]
    worst = max(abs(e) for e in error.values())
    return below(name, 1e3 * worst, 1e3 * IDEAL_ERROR, "noise-free data: within 1 mm, pairs by their sum")


def correlation_checks(actual: np.ndarray, planned: np.ndarray, pairs: list[list[int]]) -> Iterator[Check]:
    """Compare the nearly collinear pairs with what the plan's own regressor predicts.

    A plan that by itself weakens the correlation is not held to the paper's limit.

    Args:
        actual, planned: correlations (eq. 15) of the regressor of measured and planned angles, (p, p).
        pairs: numbers of the full model's parameters, from 1.
    """
    for a, b in pairs:
        predicted = planned[a - 1, b - 1]
        low, high = max(predicted - CORRELATION_TOLERANCE, -1.0), predicted + CORRELATION_TOLERANCE
        limit = f"not held to {CORRELATION_LIMIT}, which this plan weakens by itself"
        if predicted < CORRELATION_LIMIT:
            high, limit = min(high, CORRELATION_LIMIT), f"below {CORRELATION_LIMIT}"
        source = f"plan predicts {predicted:.4f}, within {CORRELATION_TOLERANCE}; {limit}"
        yield within(f"correlation ({a}, {b})", actual[a - 1, b - 1], low, high, source)


def data_correlation_checks(data: np.ndarray, planned: np.ndarray, pairs: list[list[int]]) -> Iterator[Check]:
    """Check the nearly collinear pairs in an estimate that calibrates its laboratory.

    Members that only their prior knows have errors of their own, which hide the correlation.

    Args:
        data: correlations of the estimate without those members, (p, p).
        planned, pairs: see `correlation_checks`; a plan that weakens the correlation itself is not judged.
    """
    for a, b in pairs:
        name, place = f"correlation ({a}, {b}), estimate", (a - 1, b - 1)
        if planned[place] < CORRELATION_LIMIT:
            source = f"below {CORRELATION_LIMIT}, without members known by their prior only"
            yield within(name, data[place], -1.0, CORRELATION_LIMIT, source)
        else:
            yield skipped(name, f"plan predicts {planned[place]:.4f}")


def worst_balance(truth: Truth) -> dict[str, float] | None:
    """Find the worst of every balance kept in the dynamics, over all held postures; None in statics."""
    books = [dataclasses.asdict(held.balance) for held in truth.held]
    if not books:
        return None
    worst = {name: max(abs(b[name]) for b in books) for name in (*BALANCES, "kinetic")}
    return worst | {"least_dissipated": min(b["dissipated"] for b in books)}


def balance_check(worst: dict[str, float], weight: float, whole: bool) -> Check:
    """Compare the forces and moments that every hold leaves over with a bound that no real hold comes near.

    Args:
        worst: see `worst_balance`. weight: of the robot [N].
        whole: judge cells and centre of mass as well, which a known or hidden effect may set apart.
    """
    force = IMBALANCE * weight
    bounds = {"torques": force} | ({"weight": force, "moments": force, "centre": IMBALANCE} if whole else {})
    name = max(bounds, key=lambda key: worst[key] / bounds[key])
    what, unit = BALANCES[name]
    found, bound = (number(MILLIMETRES.get(name, 1.0) * one[name], ".2g") for one in (worst, bounds))
    source = f"{what} {found} {unit}, bound {bound} {unit}"
    return below("imbalance over its bound", worst[name] / bounds[name], 1.0, source)


def mass_check(value: float, standard_error: float, truth: float, count: int, noisy: bool) -> Check:
    if not noisy:
        return below("total mass", abs(value - truth), IDEAL_MASS_ERROR, "noise-free data: within 1 g (kg)")
    half = float(t_ppf(1 - LEVEL / 2, count - 1)) * standard_error
    return within("total mass", value, truth - half, truth + half, f"{100 * (1 - LEVEL):.0f} % interval (kg)")
