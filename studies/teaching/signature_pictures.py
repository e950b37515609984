"""Draw the signature of every effect of the catalogue, a small picture each."""

import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studies.runner import shipped_plan
from studies.teaching.signature import Signature, examples, noise_sd, signature
from studies.teaching.style import GREY, X, Y, card, save_svg
from studies.teaching.variables import ORDER, VARIABLES
from tulip_testbed.sim.robot import load_robot

PRESET = "force-plate"
SMALL = (4.2, 2.75)  # inches, of an effect's picture
NONE = 0.05  # mm: a smaller error is none
LETTERS = 48  # of a line under it


def catalogue_pictures(folder: Path) -> Iterator[Path]:
    """Draw the signature of every effect of the catalogue, one file each."""
    robot = load_robot()
    plan = shipped_plan(robot)
    noise = {name: noise_sd(robot, plan, name) for name in (PRESET, "plate-ft")}
    for instance in examples(robot):
        preset = "plate-ft" if instance.effect.instrument == "wrenches" else PRESET
        yield one_effect(folder, signature(instance, robot, plan), noise[preset])


def one_effect(folder: Path, found: Signature, noise: np.ndarray) -> Path:
    """Draw one signature with a band of two s.d. of the noise.

    Args:
        noise: s.d. of the CoP's error, x and y, (2,) [mm].
    """
    effect, instance = found.instance.effect, found.instance
    label, quantity = VARIABLES.get(effect.name, ORDER)
    with card(*SMALL) as (figure, ax):
        band = 2 * float(noise.max())
        ax.axhspan(-band, band, color="#dcdcdc", zorder=0)
        at = quantity(found.observed, instance.target)
        for column, (colour, size) in enumerate(((X, 3.38), (Y, 2.34))):  # x shows where both are alike
            ax.plot(at, found.error[:, column], "o", color=colour, markersize=size, markeredgewidth=0)
        largest = max(1.15 * float(np.abs(found.error).max()), 2.5 * band)
        ax.set_ylim(-largest, largest)
        if np.abs(found.error).max() < NONE:
            ax.text(0.5, 0.8, "no error of the CoP", color=GREY, ha="center", transform=ax.transAxes)
        ax.set_ylabel("CoP error, mm")
        ax.set_title(effect.name, loc="left", fontweight="bold")
        for place, colour, text in ((0.80, X, "x"), (0.90, Y, "y")):
            ax.text(place, 1.035, f"● {text}", color=colour, transform=ax.transAxes)
        ax.set_xlabel(f"{label}\n{_under(found)}", fontsize=8.5, linespacing=1.5)
        return save_svg(figure, folder / f"{effect.name}.svg")


def _under(found: Signature) -> str:
    """Return what the picture shows as a sentence in short lines."""
    how = "" if found.simulated else " (Predicted, not simulated.)"
    return "\n".join(textwrap.wrap(found.instance.finding + how, LETTERS))
