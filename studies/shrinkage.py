"""Draw how families of ordinary imperfections shrink: one that is there, and one that is not."""

from __future__ import annotations

import io
from dataclasses import replace

import matplotlib as mpl
import numpy as np

mpl.use("agg")
from matplotlib import pyplot as plt
from PIL import Image

from studies.runner import shipped_plan
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.families import families_of, tolerances_of
from tulip_testbed.calibration.linearisation import mixing_of
from tulip_testbed.calibration.reml import given
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.sim.robot import load_robot

SHOWN = ("encoder-offset", "encoder-gain")
SPREAD = 0.7  # tolerances, of the family that is there
FREE = 20.0  # tolerances: as good as no prior
SEED = 7
SIZE, DPI = (9.0, 3.6), 130
GREY, BLUE, VERMILION = "#9a9a9a", "#0072b2", "#d55e00"


@one_blas_thread
def shrinkage() -> Image.Image:
    """Simulate encoders whose zeros are off and whose gains are right; draw the estimates of both."""
    robot = load_robot()
    laboratory = Laboratory(robot, "wii")
    plain = observe(laboratory.run(shipped_plan(robot), SEED, "statics").measurements, nominal_robot(robot))
    families = families_of(robot, tolerances_of(plain.measurements.sensors))
    (zeros,) = (family for family in families if family.name == SHOWN[0])
    true = SPREAD * zeros.tolerance * np.random.default_rng(SEED).standard_normal(len(zeros))
    hidden = replace(laboratory, hidden=tuple(zeros.instances(true)))
    run = hidden.run(shipped_plan(robot), SEED, "statics")
    found = self_calibrate(observe(run.measurements, nominal_robot(robot)))
    mixing, owner = mixing_of(found.all)
    p = len(found.theta)
    figure, axes = plt.subplots(1, 2, figsize=SIZE, sharey=True, layout="constrained")
    first = 0
    for j, one in enumerate(found.families):
        where = slice(first, first + len(one.family))
        first = where.stop
        if one.family.name not in SHOWN:
            continue
        wide = np.where(owner == j, FREE, found.solved.spreads)
        free = given(found.problem, found.solved.scales, wide)
        value = (mixing @ free.estimate[p + 1 :])[where]
        sd = np.sqrt(np.diag(mixing @ free.conditional[p + 1 :, p + 1 :] @ mixing.T)[where])
        truth = true if one.family.name == SHOWN[0] else 0 * value
        axis, at = axes[SHOWN.index(one.family.name)], np.arange(len(value))
        unit = one.family.tolerance
        bars = {"fmt": "o", "markersize": 4, "linewidth": 1.2}
        axis.errorbar(at - 0.12, value / unit, 1.96 * sd / unit, color=GREY, label="without a prior", **bars)
        half = 1.96 * one.standard_error / unit
        axis.errorbar(at + 0.12, one.value / unit, half, color=BLUE, label="with its family", **bars)
        axis.plot(at, truth / unit, "_", color=VERMILION, markersize=14, markeredgewidth=2, label="truth")
        axis.axhline(0, color="black", linewidth=0.6)
        axis.set_title(f"{one.family.name}: spread {one.spread:.2f} tolerances", fontsize=10)
        axis.set_xticks(at, one.family.targets, rotation=60, ha="right", fontsize=7)
    axes[0].set_ylabel("estimate and 95 % interval [tolerances]", fontsize=9)
    axes[0].legend(fontsize=8, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, format="png")
    plt.close(figure)
    return Image.open(buffer)
