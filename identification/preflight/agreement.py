"""Preflight: agreement between repeated postures, placements and single postures.

All checks use e = y - H theta with the covariance V that the data sheets state. Repeats compare e for the
nominal theta, so that tracking errors, which differ between approaches, cancel. Placements and postures are
tested one by one as mean shifts in the best fitting model (Cook and Weisberg 1982), relative to the scatter
of the others if that exceeds the stated one.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import pinvh

from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.distributions import chi2_sf, f_sf
from tulip_testbed.identification.noise_structure import Groups, Weights, groups
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import (
    Finding,
    bonferroni,
    few,
    result_of,
    row_name,
    skipped,
)
from tulip_testbed.identification.preflight.usual import Usual, singly
from tulip_testbed.identification.reading_noise import ReadingNoise, placement_levers, placement_sd
from tulip_testbed.identification.regressor import Regression
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.contract import LIKELY_REPEAT

STANDS_OUT = 4.0  # standard errors, about those at which the smallest of a hundred p-values fails
# Times what is stated, and probability, from which residuals are a fault and not only a warning.
SCATTERS, VANISHES = 2.0, 1e-9
MOST_UNDETECTED = 0.05  # m: a check that cannot detect a plate shifted by this much has no power
NO_CELL_SD = "the manifest states no sensors.cell_sd"


def repeats(measurements: Measurements, nominal: Nominal, noise: ReadingNoise) -> Finding:
    """Compare repeated postures: change of the centre of pressure minus the part that the angles explain.

    The changes are tested together, pair by pair, and as a drift in proportion to the time between repeats.
    """
    name, m = "repeats", measurements
    numbers, counts = np.unique(m.posture, return_counts=True)
    again = numbers[counts > 1]
    if not len(again):
        return skipped(name, "no posture was measured twice; repeat five or more")
    spread = {number: float(np.ptp(m.joint_angles[m.posture == number], axis=0).max()) for number in again}
    if (change := max(spread.values())) > LIKELY_REPEAT:
        number = max(again, key=spread.__getitem__)
        rows = np.flatnonzero(m.posture == number) + 1
        return Finding(
            name,
            "fail",
            f"posture {number} has {len(rows)} rows whose joints differ by up to {change:.2g} rad",
            f"rows of one number within {LIKELY_REPEAT:g} rad of each other",
            f"rows {', '.join(few(list(map(str, rows))))}",
            "Give every posture a number of its own, also across placements; look for a swapped row.",
        )
    if not m.sensors.cell_sd:
        return skipped(name, NO_CELL_SD)
    error = center_of_pressure(m) - nominal.center_of_mass(m.joint_angles)
    groups = [np.flatnonzero(m.posture == number) for number in again]
    differences = [_differences(error[r], noise.own[r], noise.shared[r], m.placement[r]) for r in groups]
    squares = np.array([d @ np.linalg.solve(v, d) for d, v in differences])
    sizes = np.array([len(d) for d, _ in differences])
    singly = chi2_sf(squares, sizes)
    worst = int(singly.argmin())
    rows, moved = groups[worst], np.linalg.norm(differences[worst][0].reshape(-1, 2), axis=1).max()
    drift = _drift_p_value(m.time, groups, differences)
    p_value = bonferroni([float(chi2_sf(squares.sum(), sizes.sum())), bonferroni(singly), drift])
    return Finding(
        name,
        result_of(p_value),
        f"{len(again)} postures repeated, chi-square {squares.sum():.0f}; "
        f"their joints differ by up to {1e3 * change:.1f} mrad",
        f"chi-square about {sizes.sum()} at the stated s.d.; joints may differ (friction)",
        f"worst: posture {again[worst]}, rows {', '.join(str(r + 1) for r in rows)}, "
        f"CoP {1e3 * moved:.1f} mm apart",
        "Look for a drifting tare, a board or foot that moved, or a stated cell_sd that is too small.",
        p_value,
    )


@dataclass(frozen=True)
class AgreementFit:
    """The best fitting model under the stated covariance V, prepared for tests of shifts.

    Attributes:
        weights: V^-1.
        model: columns of the model, X, (m, 2, p). weighted: V^-1 X. covariance: (X' V^-1 X)^-1, (p, p).
        score: V^-1 times the residuals, (m, 2) [1/m].
        square: the chi-square of the residuals.
        dof: 2m - p.
    """

    weights: Weights
    model: np.ndarray
    weighted: np.ndarray
    covariance: np.ndarray
    score: np.ndarray
    square: float
    dof: int


def shifts(
    found: AgreementFit, directions: np.ndarray, together: Groups
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Test a shift of each group's residuals, within a placement, in directions (m, 2, d), as the only one.

    Returns:
        the p-value by an F test with the scatter of the other residuals, or the stated one if that is larger,
        (g,); size and standard error of the shift in each direction, (g, d).
    """
    weighted = found.weights.of_postures @ directions
    if len(together) < len(directions):
        weighted = found.weights(directions)  # within the placement
    whole = together.sums(directions.mT @ weighted)
    across = together.sums(directions.mT @ found.weighted)
    score = together.sums((directions.mT @ found.score[..., None])[..., 0])
    power = whole - across @ found.covariance @ across.mT
    values, vectors = np.linalg.eigh(power)
    # Directions in the span of the model cannot be tested; rounding leaves a small part of them.
    usable = values > 1e-9 * np.trace(whole, axis1=1, axis2=2)[:, None]
    inverse = vectors * np.where(usable, 1 / np.where(usable, values, 1.0), 0.0)[:, None] @ vectors.mT
    size = (inverse @ score[..., None])[..., 0]
    explained = (size * (power @ size[..., None])[..., 0]).sum(axis=1)
    rank = usable.sum(axis=1)
    free = found.dof - rank
    tested = (rank > 0) & (free > 0)
    rank, free = np.where(tested, rank, 1), np.where(tested, free, 1)
    scale = np.maximum(1.0, (found.square - explained) / free)
    error = np.sqrt(scale[:, None] * np.diagonal(inverse, axis1=1, axis2=2))
    p_value = np.where(tested, f_sf(explained / rank / scale, rank, free), 1.0)
    return p_value, size, np.where(tested[:, None], error, np.inf)


def fit(measurements: Measurements, data: Regression, noise: ReadingNoise) -> AgreementFit | None:
    """Fit the model by generalised least squares; None without a stated cell_sd or degrees of freedom."""
    dof = len(data.output) - data.matrix.shape[1]
    if not measurements.sensors.cell_sd or dof < 1:
        return None
    m, weights = len(measurements), noise.weights
    model, output = data.matrix.reshape(m, 2, -1), data.output.reshape(m, 2, 1)
    weighted = weights(model)
    information = np.tensordot(model, weighted, axes=((0, 1), (0, 1)))
    size = np.sqrt(np.diag(information))
    unit = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)  # nothing tells of a zero column
    covariance = unit[:, None] * pinvh(unit[:, None] * information * unit) * unit
    theta = covariance @ np.tensordot(weighted, output, axes=((0, 1), (0, 1)))
    residual = output - model @ theta
    score = weights(residual)
    square = float(np.vdot(residual, score))
    return AgreementFit(weights, model, weighted, covariance, score[..., 0], square, dof)


def single_postures(measurements: Measurements, found: AgreementFit) -> Finding:
    """Find a posture whose centre of pressure contradicts all the others."""
    m = len(measurements)
    p_values, size, error = shifts(found, np.tile(np.eye(2), (m, 1, 1)), Groups(np.arange(m)))
    row = int(p_values.argmin())
    p_value = bonferroni(p_values)
    far = int((p_values * len(p_values) < 0.01).sum())
    return Finding(
        "single postures",
        result_of(p_value),
        f"{far} of {len(measurements)} postures are outliers",
        "every posture's CoP agrees with the model that fits the others",
        f"worst: {row_name(measurements, row)}, CoP off by {_millimetres(size[row], error[row])}",
        "Compare the row with the notebook; leave the posture out if it cannot be corrected.",
        p_value,
    )


def single_placements(measurements: Measurements, found: AgreementFit) -> Finding:
    """Find a placement whose postures are shifted together, as by a wrongly recorded plate pose."""
    name, m = "single placements", measurements
    if not placement_sd(m)[:2].any():
        return skipped(name, "the manifest states no sensors.placement_sd")
    levers, together = placement_levers(m), groups(m.placement)
    each = [shifts(found, levers[..., 3 * p : 3 * p + 2], together) for p in range(len(PLATES))]
    # Placement by placement, and its plates one by one.
    p_values, size, error = (
        np.stack(part, axis=1).reshape(len(PLATES) * len(together), -1) for part in zip(*each, strict=True)
    )
    labels = [f"placement {number}, {plate} plate" for number in np.unique(m.placement) for plate in PLATES]
    worst = int(p_values.argmin())
    p_value = bonferroni(p_values[:, 0])
    undetected = STANDS_OUT * float(np.median(error.max(axis=1)))
    if result_of(p_value) == "pass" and undetected > MOST_UNDETECTED:
        reason = "no power: too few postures a placement to distinguish a shifted plate from the parameters"
        if np.isfinite(undetected):
            reason += f"; only a shift of more than about {1e3 * undetected:.0f} mm would be detected"
        return skipped(name, reason)
    return Finding(
        name,
        result_of(p_value),
        f"largest shift: {labels[worst]} by {_millimetres(size[worst], error[worst])}; "
        f"shifts of more than about {1e3 * undetected:.0f} mm would be detected",
        f"shifts of placement_sd, {1e3 * placement_sd(m)[:2].max():.1f} mm",
        labels[worst],
        "Measure that placement's plate poses again (sign, origin, a board that was moved), or leave it out.",
        p_value,
    )


def scatter(found: AgreementFit, usual: Usual) -> Finding:
    """Compare the residuals of the best fit with the stated noise and ordinary imperfections.

    Large residuals need not be a fault of the folder: the robot may differ from the model. Only those that no
    estimate survives fail.
    """
    weighted = found.weights(usual.center)
    across = np.tensordot(weighted, found.model, axes=((0, 1), (0, 1)))
    power = np.tensordot(weighted, usual.center, axes=((0, 1), (0, 1)))
    power -= across @ found.covariance @ across.T
    pull = np.tensordot(usual.center, found.score, axes=((0, 1), (0, 1)))
    # Of (V + K K')^-1, with the model's columns projected out.
    inverse = np.linalg.inv(np.eye(len(pull)) + power)
    square = found.square - float(pull @ inverse @ pull)
    ratio = np.sqrt(square / found.dof)
    score, information = pull - power @ inverse @ pull, np.diag(power - power @ inverse @ power)
    tested = singly(score, information, usual.names, [float(chi2_sf(square, found.dof))])
    survives = ratio <= SCATTERS and tested.p_value >= VANISHES
    return Finding(
        "scatter about the model",
        "warn" if tested.result == "fail" and survives else tested.result,
        f"{ratio:.2f} times what is stated (chi-square {square:.0f}, {found.dof} degrees of freedom)"
        + tested.words,
        "about 1 by the sensors' s.d. and tolerances, no more than "
        f"{SCATTERS:g}; less where the right plate was recorded better than the left",
        "",
        "Check the stated s.d., swapped cells or columns, and effects that the model lacks "
        "(elasticity, an encoder's zero, link lengths): standard errors will be too small.",
        tested.p_value,
    )


def _differences(
    error: np.ndarray, noise: np.ndarray, levers: np.ndarray, placement: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences of a posture's k rows to its first one, (2k - 2,) [m], and their covariance."""
    count = len(error)
    full = np.zeros((count, 2, count, 2))
    for i in range(count):
        full[i, :, i] += noise[i]
        for j in range(count):
            if placement[i] == placement[j]:
                full[i, :, j] += levers[i] @ levers[j].T
    contrasts = np.kron(np.column_stack([-np.ones(count - 1), np.eye(count - 1)]), np.eye(2))
    return contrasts @ error.ravel(), contrasts @ full.reshape(2 * count, 2 * count) @ contrasts.T


def _drift_p_value(
    time: np.ndarray, groups: list[np.ndarray], differences: list[tuple[np.ndarray, np.ndarray]]
) -> float:
    """Return the p-value of a drift of the centre of pressure in proportion to the time between repeats."""
    if not np.isfinite(time).all():
        return 1.0
    power, along = np.zeros((2, 2)), np.zeros(2)
    for rows, (difference, spread) in zip(groups, differences, strict=True):
        elapsed = np.kron((time[rows[1:]] - time[rows[0]])[:, None], np.eye(2))
        power += elapsed.T @ np.linalg.solve(spread, elapsed)
        along += elapsed.T @ np.linalg.solve(spread, difference)
    return float(chi2_sf(along @ np.linalg.solve(power, along), 2)) if power[0, 0] > 0 else 1.0


def _millimetres(shift: np.ndarray, error: np.ndarray) -> str:
    (x, y), (x_error, y_error) = 1e3 * shift, 1e3 * error
    return f"({x:+.1f}, {y:+.1f}) mm, s.e. ({x_error:.1f}, {y_error:.1f})"
