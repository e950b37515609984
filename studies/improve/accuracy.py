"""Make the centre of pressure more accurate, from balance boards to force plates (first way)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from studies.improve.output import BLACK, BLUE, ORANGE, Rows, log_axis, panels, save
from studies.improve.repeat import Model, monte_carlo_error, repeat, rms
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.sensors import PRESETS, Sensors

NON_ZERO = 13  # of the nominal robot's base parameters; they are the simplified model's
# Parts of the sensors that add to the uncertainty of a centre of pressure or of its model.
PARTS = {
    "cells": ("cell_repeatability", "cell_noise", "cell_resolution"),
    "plate records": ("placement_sd", "mark_sd"),
    "encoders": ("encoder_repeatability", "encoder_noise", "encoder_resolution"),
}


def between(part: float) -> Sensors:
    """Interpolate all figures of the sensors geometrically from `wii` (0) to `force-plate` (1)."""
    worse, better = PRESETS["wii"], PRESETS["force-plate"]
    scaled = {}
    for field in dataclasses.fields(Sensors):
        a, b = getattr(worse, field.name), getattr(better, field.name)
        if isinstance(a, float):
            scaled[field.name] = a ** (1 - part) * b**part
        elif isinstance(a, tuple):
            scaled[field.name] = tuple(x ** (1 - part) * y**part for x, y in zip(a, b, strict=True))
    return dataclasses.replace(worse, **scaled)


def improved(part: str) -> Sensors:
    """Return `wii` with one part of its sensors as good as that of `force-plate`."""
    better = {name: getattr(PRESETS["force-plate"], name) for name in PARTS[part]}
    return dataclasses.replace(PRESETS["wii"], **better)


def study(
    rig: Rig, plan: PosturePlan, parameters: BaseParameters, runs: int, seed: int, steps: int = 6
) -> Rows:
    """Return a row for each set of sensors; every set sees the same draws of noise."""
    arms = {f"{step}/{steps - 1}": between(step / (steps - 1)) for step in range(steps)}
    arms |= {f"wii, better {part}": improved(part) for part in PARTS}
    rows = []
    for name, sensors in arms.items():
        found = repeat(dataclasses.replace(rig, sensors=sensors), plan, parameters, runs, seed)
        sigma = 1e3 * float(np.median(found.full.sigma))
        rows.append(
            {
                "sensors": name,
                "sigma_mm": sigma,
                **_columns("full", found.full),
                **_columns("simplified", found.simplified),
                "runs": len(found.rows),
            }
        )
    return rows


def _columns(name: str, model: Model) -> dict[str, float]:
    root = 1e3 * rms(model.off)
    reported = 1e3 * np.sqrt((model.error**2).mean(axis=0))
    return {
        f"{name}_median_se_mm": float(np.median(reported)),
        f"{name}_worst_se_mm": float(reported.max()),
        f"{name}_median_rms_mm": float(np.median(root)),
        f"{name}_median_rms_mc": 1e3 * monte_carlo_error(lambda off: float(np.median(rms(off))), model.off),
        f"{name}_worst_rms_mm": float(root.max()),
        f"{name}_well": float(model.well.mean()),
        f"{name}_well_sd": float(model.well.std()),
    }


def draw(rows: Rows, path: Path) -> None:
    """Draw errors and counts over the accuracy of the centre of pressure."""
    steps = [r for r in rows if "/" in r["sensors"]]
    figure, (errors, counts) = panels(2)
    sigma = [r["sigma_mm"] for r in steps]
    for name, colour, size in (("full", BLUE, 25), ("simplified", ORANGE, 13)):
        for which, style in (("worst", "^--"), ("median", "o-")):
            values = [r[f"{name}_{which}_rms_mm"] for r in steps]
            errors.plot(sigma, values, style, color=colour, label=f"{name}, {which}")
        counts.errorbar(
            sigma,
            [r[f"{name}_well"] for r in steps],
            [r[f"{name}_well_sd"] for r in steps],
            fmt="o-",
            capsize=3,
            color=colour,
            label=f"{name} ({size} parameters)",
        )
    counts.axhline(NON_ZERO, color=BLACK, linestyle=":", label="not zero in the true robot (13)")
    for ax in (errors, counts):
        log_axis(ax, "x", (0.5, 1, 2, 4))
        ax.set_xlabel("residual sigma of the CoP (eq. 14), mm")
        ax.invert_xaxis()
    log_axis(errors, "y", (0.1, 0.3, 1, 3, 10, 30, 100))
    errors.set_ylim(0.1, 100)
    better = next(r for r in rows if r["sensors"] == "wii, better cells")
    errors.plot(
        better["sigma_mm"],
        better["full_median_rms_mm"],
        "*",
        color=BLACK,
        label="full, median; cells alone better",
    )
    errors.set_ylabel("RMS error of a parameter, mm")
    counts.set_ylabel("well identified (relative s.e. < 15 %)")
    counts.set_ylim(0, 17)
    errors.legend(frameon=False, loc="lower left", fontsize=9)
    counts.legend(frameon=False, loc="lower right", fontsize=9)
    save(figure, path)
