"""Preflight: parameters that these postures identify, and their predicted accuracy."""

import numpy as np

from tulip_testbed.identification.estimators import solve_least_squares
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding
from tulip_testbed.identification.rank import undetermined_directions
from tulip_testbed.identification.reading_noise import ReadingNoise
from tulip_testbed.identification.regressor import ENCODER_SD, SINGLE, encoder_blur, stacked_regressor
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors, standard_errors
from tulip_testbed.measurements import Measurements

DATA_PER_PARAMETER = 4  # the paper optimised sets of 50 postures for 25 parameters
MOST_CONDITION = 2600  # twice the worst of the shipped plan's sets of 50


def predicted_standard_errors(matrix: np.ndarray, noise: ReadingNoise) -> np.ndarray:
    """Predict standard errors of least squares with H, (2m, p), by the stated noise, C H'VH C, (p,) [m]."""
    half = matrix @ solve_least_squares(matrix, np.zeros(len(matrix)))[1]
    spread = noise.times(half.reshape(len(noise.own), 2, -1)).reshape(half.shape)
    return standard_errors(half.T @ spread)


def identifiable(measurements: Measurements, nominal: Nominal, noise: ReadingNoise | None) -> Finding:
    """Check number of postures, rank, condition number and, with a noise, predicted standard errors."""
    name, m = "identifiable", measurements
    count = len(nominal.value)
    postures, rule = len(m), DATA_PER_PARAMETER * count // 2
    expected = f"{count} parameters, {rule} postures or more, condition number below {MOST_CONDITION}"
    advice = "Measure more, and more different, postures: `tulip plan random` draws random ones."
    if m.joint_rates is not None:
        advice = "Measure longer, and let every joint move further."
    seen = f"{postures} postures ({2 * postures} data points)"
    matrix = stacked_regressor(nominal.parameters, m.joint_angles, m.support)
    sd = m.sensors.encoder_sd
    sd = ENCODER_SD if sd is None else sd
    blur = encoder_blur(nominal.parameters, m.joint_angles, sd, m.support)
    known = count - len(undetermined_directions(matrix, blur))
    if known < count or 2 * postures <= count:
        carried = known > SINGLE
        seen += f" determine at most {known} of {count} parameters"
        seen += "; `identify` takes CAD as prior, which carries the rest" if carried else ""
        return Finding(name, "warn" if carried else "fail", seen, expected, "", advice)
    condition = float(np.linalg.cond(matrix))
    seen += f", rank {count}, condition number {condition:.0f}"
    if noise is not None and m.sensors.cell_sd:
        error = predicted_standard_errors(matrix, noise)
        relative = relative_standard_errors(nominal.value, error)
        good = [str(k) for k in np.flatnonzero(relative < WELL_IDENTIFIED) + 1]
        bad = [str(k) for k in np.flatnonzero(relative >= WELL_IDENTIFIED) + 1]
        seen += (
            f"; standard errors predicted below {WELL_IDENTIFIED:.0f} % of the nominal value for "
            f"{len(good)} of {count}: {', '.join(good) or 'none'}; not for {', '.join(bad) or 'none'}"
        )
    few = postures < rule or condition > MOST_CONDITION
    return Finding(name, "warn" if few else "pass", seen, expected, "", advice)
