"""Log postures, a plan's, a measurement folder's or a validation's, and arrange their views."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.colours import COMMAND, PALETTE, SKELETON, rgb
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.viewer import balance_series as balance
from tulip_testbed.viewer import robot_view
from tulip_testbed.viewer.canvas import Canvas, blueprint, plane_view
from tulip_testbed.viewer.subject import Subject

SOLE = np.array([0.3, 0.15])  # m, of the picture around a foot that stands on no board
LEGEND = {
    "measured": "CoP vermilion; CoM by estimate blue, by truth green, by nominal model grey",
    "planned": "CoM by nominal model grey",
}


def log_postures(recording: rr.RecordingStream, subject: Subject) -> None:
    canvas = log_standing(recording, subject)
    nominal = standard_parameters(subject.nominal.robot.visual_model)
    others = {name: true for name, true in subject.true_masses.items() if not np.allclose(true, nominal)}
    robot_view.log_masses(canvas, subject, {"nominal model": nominal} | others)
    robot_view.log_skeleton(canvas, "world/masses/skeleton", subject, subject.rows.joint_angles, SKELETON)
    if subject.command is not None:
        robot_view.log_skeleton(canvas, "world/commanded", subject, subject.command, COMMAND)
    balance.log_close_up(canvas, subject)
    for plot, lines in curves(subject).items():
        for k, (name, values) in enumerate(lines.items()):
            style = rr.SeriesLines(colors=rgb(PALETTE[k % len(PALETTE)]), names=name, widths=1.5)
            canvas.series(f"plots/{plot}/{name}", style, values)
    texts = [posture_text(subject, row) for row in range(len(subject))]
    canvas.rows("text", rr.TextDocument, {"media_type": rr.MediaType.MARKDOWN}, text=texts)
    recording.send_blueprint(laid_out(posture_views(subject), canvas.index.timeline_name()))


def log_standing(
    recording: rr.RecordingStream, subject: Subject, sequence: np.ndarray | None = None
) -> Canvas:
    """Log the robot on its plates with everything on the ground.

    Without a sequence rows are 1, 2, ..., or come at the times of a robot that moves.
    """
    m, numbers = subject.measurements, np.arange(1, len(subject) + 1)
    index = rr.TimeColumn("posture", sequence=numbers if sequence is None else sequence)
    if sequence is None and m is not None and m.joint_rates is not None and np.isfinite(m.time).all():
        index = rr.TimeColumn("time", duration=m.time + m.window / 2)
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    robot_view.log_geometry(recording, "world/robot", subject.nominal.robot.visual_model)
    canvas = Canvas(recording, index)
    robot_view.log_motion(canvas, subject)
    robot_view.log_plates(canvas, subject)
    robot_view.log_loads(canvas, subject)
    balance.log_balance(canvas, subject)
    return canvas


def posture_views(subject: Subject) -> dict[str, list[rrb.View]]:
    """Return the views of postures; those of the ground are seen from above, x up and y to the left."""
    far = np.linalg.norm(SOLE if subject.sensors_in_feet else subject.board.size) / 2
    places = subject.plates[..., :2].reshape(-1, 2)
    seen = balance.from_above(np.vstack([places - far, places + far]))
    low, high = seen.min(axis=0), seen.max(axis=0)
    ground = [plane_view("above", "From above, mm (x up, y left)", (low[0], high[0]), (low[1], high[1]))]
    if subject.cop is not None:
        _, _, reach = balance.close_up(subject)
        middle = "estimated" if "estimate" in subject.com else "nominal"
        scale = " and ".join(f"{radius:g}" for radius in balance.circles(reach))
        name = f"Close-up around the {middle} CoM: circles of {scale} mm (x up, y left)"
        ground.append(plane_view("close_up", name, (-reach, reach), (-reach, reach)))
    return {
        "robot": [
            robot_view.space_view(
                subject,
                "Robot" if subject.sensors_in_feet else "Robot on its plates",
                ["$origin/**", "- $origin/masses/**"],
            ),
            robot_view.space_view(
                subject,
                "Masses of the links",
                ["$origin/masses/**", "$origin/plates/**", "$origin/balance/**"],
            ),
        ],
        "ground": [*ground],
        "curves": [
            rrb.TimeSeriesView(origin=f"plots/{name}", name=title_of(name), plot_legend=rrb.Corner2D.RightTop)
            for name in curves(subject)
        ],
        "numbers": [rrb.TextDocumentView(origin="text", name="Posture")],
    }


def laid_out(views: dict[str, list[rrb.View]], timeline: str) -> rrb.Blueprint:
    """Arrange the robot large, the curves below it, the ground and the numbers on the right."""
    shares = [1.1, *[0.8] * (len(views["ground"]) - 1), 1.6]
    return blueprint(
        rrb.Horizontal(
            rrb.Vertical(rrb.Tabs(*views["robot"]), rrb.Tabs(*views["curves"]), row_shares=[2.2, 1]),
            rrb.Vertical(*views["ground"], *views["numbers"], row_shares=shares),
            column_shares=[1.7, 1],
        ),
        timeline,
    )


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
        lines.append(
            f"Residual (CoP minus estimated CoM) pink, magnified {balance.magnification(subject)} times."
        )
    if subject.cell_forces is not None:
        scale = 1e3 * robot_view.METRES_PER_WEIGHT / subject.weight
        lines.append(
            f"Arrows: load on each cell, {scale:.1f} mm per N; front left dark blue, front right light "
            "blue, rear right green, rear left orange. A cell that reads less than under the empty board "
            "points up."
        )
    elif subject.foot_loads is not None:
        scale = 1e3 * robot_view.METRES_PER_WEIGHT / subject.weight
        lines.append(f"Arrows: vertical force on each foot by its sensor, {scale:.1f} mm per N.")
    return ["\n\n".join([*lines, *subject.notes])]
