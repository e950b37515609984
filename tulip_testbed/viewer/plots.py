"""Curves over the postures and the panel with a posture's numbers."""

import numpy as np
import rerun as rr

from tulip_testbed.colours import PALETTE, rgb
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.viewer.balance_series import magnification
from tulip_testbed.viewer.canvas import Canvas
from tulip_testbed.viewer.robot_view import METRES_PER_WEIGHT
from tulip_testbed.viewer.subject import Subject

LEGEND = {
    "measured": "CoP vermilion; CoM by estimate blue, by truth green, by nominal model grey",
    "planned": "CoM by nominal model grey",
}


def log_curves(canvas: Canvas, plot: str, curves: dict[str, np.ndarray]) -> None:
    """Log the named curves of one plot, (m,) each."""
    for k, (name, values) in enumerate(curves.items()):
        style = rr.SeriesLines(colors=rgb(PALETTE[k % len(PALETTE)]), names=name, widths=1.5)
        canvas.series(f"plots/{plot}/{name}", style, values)


def curves(subject: Subject) -> dict[str, dict[str, np.ndarray]]:
    """Return the curves over the postures, by plot; `title_of` gives a plot's title.

    The joints of a robot with many are spread over several plots, so that every line has its own colour.
    """
    plots: dict[str, dict[str, np.ndarray]] = {}
    if subject.cell_forces is not None:
        plots["cells"] = dict(zip(CELLS, subject.cell_forces.T, strict=True))
    elif subject.foot_loads is not None:
        plots["feet"] = dict(zip(PLATES, subject.foot_loads.T, strict=True))
    joints = subject.nominal.parameters.tree.joints
    if subject.command is not None:
        errors = 1e3 * (subject.rows.joint_angles - subject.command)
        plots |= _spread("tracking", joints, errors)
    plots |= _spread("joints", joints, np.rad2deg(subject.rows.joint_angles))
    if subject.cop is not None:
        plots["cop"] = {"x": 1e3 * subject.cop[:, 0], "y": 1e3 * subject.cop[:, 1]}
    if subject.residual is not None:
        x, y = 1e3 * subject.residual.T
        plots["residual"] = {"x": x, "y": y, "norm": np.hypot(x, y)}
    plots["margin"] = {"d_e": 1e3 * subject.margin}
    return plots


def _spread(name: str, joints: tuple[str, ...], values: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    """Return plots of (m, n_joints) with as many lines as there are colours at most, equally many in each."""
    count = -(-len(joints) // len(PALETTE))
    plots = {}
    for columns in np.array_split(np.arange(len(joints)), count):
        first, last = columns[0] + 1, columns[-1] + 1
        plot = name if count == 1 else f"{name}/{first}-{last}"
        plots[plot] = {joints[k]: values[:, k] for k in columns}
    return plots


def title_of(plot: str) -> str:
    """Return the title of a plot, with the numbers of its joints where these are spread over several."""
    name, _, numbers = plot.partition("/")
    title, comma, unit = TITLES[name].rpartition(", ")
    return f"{title} {numbers}{comma}{unit}" if numbers else TITLES[name]


TITLES = {
    "cells": "Cells, N",
    "feet": "Vertical force on each foot, N",
    "tracking": "Tracking error, mrad",
    "joints": "Joints, deg",
    "cop": "CoP, mm",
    "residual": "Residual, mm",
    "margin": "Margin d_e, mm",
}


def posture_text(subject: Subject, row: int) -> str:
    lines = [
        f"## Posture {subject.rows.posture[row]}, placement {subject.rows.placement[row]}",
        f"Row {row + 1} of {len(subject)}, support {subject.rows.support[row]}. {subject.verdict}",
        "",
        "| mm | x | y |",
        "|---|---:|---:|",
    ]
    points = {} if subject.cop is None else {"CoP": subject.cop}
    points |= {f"CoM, {name}": value for name, value in subject.com.items()}
    if subject.residual is not None:
        points["residual"] = subject.residual
    lines += [f"| {name} | {1e3 * p[row, 0]:.2f} | {1e3 * p[row, 1]:.2f} |" for name, p in points.items()]
    least = f"; planned with d_s = {1e3 * subject.least_margin:.0f} mm" if subject.least_margin else ""
    of = "the nominal CoM" if subject.cop is None else "the CoP"
    lines += ["", f"Margin of stability d_e: {1e3 * subject.margin[row]:.1f} mm (of {of}{least})."]
    if subject.foot_loads is not None:
        right, left = subject.foot_loads[row]
        lines += [
            "",
            f"Right foot {right:.1f} N, left {left:.1f} N, together "
            f"{right + left:.1f} N; the nominal robot weighs {subject.weight:.1f} N.",
        ]
    if subject.command is not None:
        error = 1e3 * (subject.rows.joint_angles[row] - subject.command[row])
        worst = int(np.argmax(np.abs(error)))
        name = subject.nominal.parameters.tree.joints[worst]
        lines += ["", f"Largest tracking error: {error[worst]:+.1f} mrad in {name}."]
    return "\n".join([*lines, "", *_legend(subject)])


def _legend(subject: Subject) -> list[str]:
    lines = ["**Legend.** " + LEGEND["planned" if subject.cop is None else "measured"] + "."]
    lines += ["Support polygon orange, with the distance to its nearest edge; d_s inside of it light blue."]
    if subject.residual is not None:
        lines.append(f"Residual (CoP minus estimated CoM) pink, magnified {magnification(subject)} times.")
    if subject.cell_forces is not None:
        scale = 1e3 * METRES_PER_WEIGHT / subject.weight
        lines.append(
            f"Arrows: load on each cell, {scale:.1f} mm per N; front left dark blue, front right light "
            "blue, rear right green, rear left orange. A cell that reads less than under the empty board "
            "points up."
        )
    elif subject.foot_loads is not None:
        scale = 1e3 * METRES_PER_WEIGHT / subject.weight
        lines.append(f"Arrows: vertical force on each foot by its sensor, {scale:.1f} mm per N.")
    return ["\n\n".join([*lines, *subject.notes])]
