"""Measure more postures, up to 500 data points a parameter (second way)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.improve.output import BLACK, BLUE, GREEN, ORANGE, Rows, log_axis, panels, save
from studies.improve.repeat import Repeated, monte_carlo_error, repeat, rms
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.statistics import WELL_IDENTIFIED
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.rig import Rig

PER_PLACEMENT = 5
LEAST = 13.0  # postures for 25 unknowns
NEGLIGIBLE = 1e-4  # m: a true value that no relative error can be measured by


def study(
    rig: Rig, pool: PosturePlan, parameters: BaseParameters, sizes: dict[int, int], seed: int
) -> tuple[Rows, Rows]:
    """Return a row for each size and a row for each parameter.

    Args:
        pool: random postures; a plan is its first ones.
        sizes: number of postures to number of runs.
    """
    found = {}
    for size, runs in sizes.items():
        plan = pool.take(pool.placement <= size // PER_PLACEMENT)
        found[size] = repeat(rig, plan, parameters, runs, seed + size)
    return [_size(size, result) for size, result in found.items()], _parameters(found, parameters)


def _size(size: int, found: Repeated) -> dict[str, float | int]:
    columns: dict[str, float | int] = {"postures": size, "measured": float(found.rows.mean())}
    for name, model in (("full", found.full), ("simplified", found.simplified)):
        root = 1e3 * rms(model.off)
        columns |= {
            f"{name}_sigma_mm": 1e3 * float(np.median(model.sigma)),
            f"{name}_median_rms_mm": float(np.median(root)),
            f"{name}_median_rms_mc": 1e3
            * monte_carlo_error(lambda off: float(np.median(rms(off))), model.off),
            f"{name}_worst_rms_mm": float(root.max()),
            f"{name}_well": float(model.well.mean()),
        }
    return columns | {"runs": len(found.rows)}


def _parameters(found: dict[int, Repeated], parameters: BaseParameters) -> Rows:
    """Return the RMS errors by size, the slope of their logarithm, and the postures that 15 % needs."""
    sizes = np.array(list(found))
    truth = next(iter(found.values())).full.truth[0]
    root = np.array([rms(f.full.off) for f in found.values()])
    weight = np.sqrt([len(f.rows) for f in found.values()])  # a log RMS has the s.d. 1 / sqrt(2 runs)
    # n mean(e^2) is the same at all sizes if errors fall as 1 / sqrt(n); runs weigh alike.
    constant = np.average(sizes[:, None] * root**2, axis=0, weights=weight**2)
    rows = []
    for k, name in enumerate(parameters.names):
        slope = np.polyfit(np.log(sizes), np.log(root[:, k]), 1, w=weight)[0]
        limit = WELL_IDENTIFIED / 100 * abs(truth[k])
        needed = max(float(constant[k] / limit**2), LEAST) if abs(truth[k]) > NEGLIGIBLE else np.inf
        below = sizes[root[:, k] < limit]
        rows.append(
            {
                "number": k + 1,
                "name": name,
                "truth_mm": 1e3 * float(truth[k]),
                **{f"rms_{size}_mm": 1e3 * float(root[i, k]) for i, size in enumerate(sizes)},
                "slope": float(slope),
                "below_15_at": int(below[0]) if len(below) else "",
                "postures_needed": needed,
            }
        )
    return rows


def draw(sizes: Rows, rows: Rows, path: Path) -> None:
    """Draw the errors over the number of postures, and the number that each parameter needs."""
    figure, (errors, needs) = panels(2, 5.2)
    count = np.array([r["postures"] for r in sizes], float)
    curves = (
        ("full_worst_rms_mm", "^--", BLUE, "full, worst"),
        ("full_median_rms_mm", "o-", BLUE, "full, median"),
        ("simplified_worst_rms_mm", "^--", ORANGE, "simplified, worst"),
        ("simplified_median_rms_mm", "o-", ORANGE, "simplified, median"),
    )
    for key, style, colour, label in curves:
        values = np.array([r[key] for r in sizes])
        errors.plot(count, values, style, color=colour, label=label)
        errors.plot(count, values[-1] * np.sqrt(count[-1] / count), ":", color=BLACK, linewidth=1)
    errors.plot([], [], ":", color=BLACK, label="1/√n through the last")
    log_axis(errors, "x", count)
    log_axis(errors, "y", (0.3, 1, 3, 10, 30, 100))
    errors.set_xlabel("number of postures n")
    errors.set_ylabel("RMS error of a parameter, mm")
    errors.legend(frameon=False, fontsize=9)
    most = 1e6
    ordered = sorted(rows, key=lambda r: -r["postures_needed"])
    for at, entry in enumerate(ordered):
        needed = entry["postures_needed"]
        beyond = needed > most
        needs.plot(min(needed, most), at, ">" if beyond else "o", color=BLUE, clip_on=False)
    needs.set_yticks(
        range(len(ordered)), [f"{r['number']} {r['name'].replace('_', ' ')}" for r in ordered], fontsize=8
    )
    needs.set_xscale("log")
    needs.set_xlim(10, most)
    for at, colour, label in (
        (150, GREEN, "150 postures"),
        (count[-1], ORANGE, f"{int(count[-1])} postures"),
    ):
        needs.axvline(at, color=colour, linestyle="--", label=label)
    needs.set_xlabel("postures for an RMS error below 15 % of the true value")
    needs.legend(framealpha=1, fontsize=9, loc="upper center", bbox_to_anchor=(0.6, 0.93))
    needs.text(most, len(ordered) - 0.2, "▸ more, or true value zero", ha="right", va="bottom", fontsize=8)
    save(figure, path)
