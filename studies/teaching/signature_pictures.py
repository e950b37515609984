"""Draw signatures: three faults side by side, and a small picture of every effect of the catalogue."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.runner import shipped_plan
from studies.teaching.signature import (
    Signature,
    examples,
    noise_sd,
    noisy_error,
    scatter_about_line,
    signature,
)
from studies.teaching.style import GREY, WIDTH, X, Y, card, save_png, save_svg
from studies.teaching.variables import HEIGHT, LEVER, TORQUE, variable_of
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.sim.robot import load_robot

PRESET = "force-plate"
JOINT = "right_knee"
THREE = {  # each of one standard deviation of what is plausible in a careful laboratory
    "Knee encoder reads\n1° too high": f"encoder-offset:{JOINT}=0.0174533",
    "Knee yields\n0.05° per Nm": f"joint-compliance:{JOINT}=0.000872665",
    "Floor tilted by 1°: left\nside up, front down": "tilt=0.0174533,0.0174533",
}
COLUMNS = (
    ("lever of the knee, mm/deg", LEVER[1]),
    ("torque on the knee, Nm", TORQUE[1]),
    ("height of the CoM, m", HEIGHT[1]),
)
OWN = "#fff4d6"  # behind a fault's own quantity
SMALL = (4.2, 2.75)  # inches, of an effect's picture
NONE = 0.05  # mm: a smaller error is none
LETTERS = 48  # of a line under it


def three_faults(path: Path) -> Path:
    """Draw the error of the CoP of three faults over three quantities, each of which explains one of them."""
    robot = load_robot()
    plan = shipped_plan(robot)
    with card(3, 3, WIDTH, 7.4, sharex="col", sharey="row") as (figure, axes):
        for row, (title, text) in enumerate(THREE.items()):
            instance = EffectInstance.parse(text, robot)
            exact = signature(instance, robot, plan)
            measured, noisy = noisy_error(instance, robot, plan, PRESET)
            for column, (label, quantity) in enumerate(COLUMNS):
                ax, own = axes[row, column], row == column
                at = quantity(exact.observed, JOINT)
                _dots(ax, quantity(measured, JOINT), noisy, 3.0 if own else 2.2)
                if own:
                    ax.set_facecolor(OWN)
                    _lines(ax, at, exact.error)
                off = scatter_about_line(at, exact.error[:, 0])
                ax.set_title(f"x is off a line by {off:.2f} mm", loc="right", color="black" if own else GREY)
                if row == len(THREE) - 1:
                    ax.set_xlabel(label)
            axes[row, 0].set_ylabel(f"{title}\n\nCoP error, mm", linespacing=1.25)
        handles = [
            axes[0, 0].plot([], [], "o-", color=colour, label=label)[0]
            for colour, label in ((X, "forward (x)"), (Y, "to the left (y)"))
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=2)
        return save_png(figure, path)


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
    label, quantity = variable_of(effect.name)
    with card(1, 1, *SMALL) as (figure, axes):
        ax = axes[0, 0]
        band = 2 * float(noise.max())
        ax.axhspan(-band, band, color="#dcdcdc", zorder=0)
        _dots(ax, quantity(found.observed, instance.target), found.error, 2.6)
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


def _dots(ax: Axes, at: np.ndarray, error: np.ndarray, size: float) -> None:
    """Draw errors in x and y, (m, 2); y is smaller, so that x shows where both are the same."""
    for column, (colour, part) in enumerate(((X, 1.3), (Y, 0.9))):
        ax.plot(at, error[:, column], "o", color=colour, markersize=part * size, markeredgewidth=0)


def _lines(ax: Axes, at: np.ndarray, error: np.ndarray) -> None:
    """Draw the straight lines through errors without noise, (m, 2), over the quantity that explains them."""
    ends = np.array([at.min(), at.max()])
    for column in error.T:
        ax.plot(ends, np.polyval(np.polyfit(at, column, 1), ends), color="black", linewidth=1.5)
