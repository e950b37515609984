"""Readings and placements that scatter several times as much as their data sheet says.

Scales of the noise are estimated, so that what the model lacks can hide in them: a floor that tilts passes
for plates that were recorded badly. A scale several times its sheet is therefore a finding of its own.
"""

import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.calibration.calibration_result import HALF_95, SelfCalibration
from tulip_testbed.calibration.linearisation import sources_of
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import fields, has_twist, packed
from tulip_testbed.identification.variance_components import MARK_RATIO

SEVERAL = 3.0  # times its sheet, beyond which noise is a finding, with 97.5 % certainty


def excessive_noise(calibration: SelfCalibration) -> list[str]:
    """Say which sources of noise scatter more than `SEVERAL` times what a data sheet states, and where."""
    observed, solved = calibration.observed, calibration.solved
    if observed.moves and observed.in_feet:  # a log has no data sheet of its windows' means
        return []
    names, sheet, at = sources_of(observed), observed.measurements.sensors, fields(observed)
    plates = at["plates"].start
    stated = {
        "encoders": (sheet.encoder_sd, "rad", at["angles"], "The encoders scatter"),
        "cells": (sheet.cell_sd if has_twist(observed) else None, "N", at["cells"], "The cells scatter"),
    }
    if sheet.placement_sd is not None and not observed.in_feet:
        place, words = (
            sheet.placement_sd[0],
            "plate stands off its recorded place, from placement to placement,",
        )
        stated["right plate"] = MARK_RATIO * place, "m", slice(plates, plates + 2), f"The right {words}"
        stated["left plate"] = place, "m", slice(plates + 3, plates + 5), f"The left {words}"
    out = []
    for k, name in enumerate(names):
        sd, unit, part, words = stated.get(name, (None, "", slice(0), ""))
        if not sd:
            continue
        low = solved.scales[k] * np.exp(-HALF_95 * np.sqrt(solved.scale_covariance[k, k]))
        if low > SEVERAL:
            errors = packed(observed) - packed(calibration.linear.smooth)
            size = np.sqrt((errors[:, part] ** 2).mean(axis=1)) / sd
            out.append(
                f"{words} {solved.scales[k]:.0f} times as much as stated ({solved.scales[k] * sd:.2g} {unit} "
                f"for {sd:.2g} {unit}){_where(observed, size)}."
            )
    return out


def _where(observed: Observation, size: np.ndarray) -> str:
    """Say in which placements errors, (m,) in multiples of the sheet, are large, and since when."""
    placement, time = observed.measurements.placement, observed.measurements.time
    numbers = np.unique(placement)
    large = np.array([np.sqrt((size[placement == k] ** 2).mean()) > SEVERAL for k in numbers])
    if not large.any() or large.mean() > 0.5:
        return ", in most placements" if large.any() else ""
    first = time[placement == numbers[large][0]].min()
    late = [time[placement == k].min() >= first for k in numbers]
    since = f", since {first:.0f} s" if len(numbers) > 1 and np.array_equal(late, large) else ""
    return f", most in placements {listed(map(str, numbers[large].tolist()))}{since}"
