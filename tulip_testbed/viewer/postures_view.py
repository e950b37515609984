"""Log postures, a plan's, a measurement folder's or a validation's, and arrange their views."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.colours import COMMAND, SKELETON
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.viewer import robot_view
from tulip_testbed.viewer.balance_series import circles, close_up, from_above, log_balance, log_close_up
from tulip_testbed.viewer.canvas import Canvas, blueprint, plane_view
from tulip_testbed.viewer.plots import curves, log_curves, posture_text, title_of
from tulip_testbed.viewer.subject import Subject

SOLE = np.array([0.3, 0.15])  # m, of the picture around a foot that stands on no board


def log_postures(recording: rr.RecordingStream, subject: Subject) -> None:
    canvas = log_standing(recording, subject)
    log_links(canvas, subject)
    if subject.command is not None:
        robot_view.log_skeleton(canvas, "world/commanded", subject, subject.command, COMMAND)
    log_close_up(canvas, subject)
    for name, lines in curves(subject).items():
        log_curves(canvas, name, lines)
    texts = [posture_text(subject, row) for row in range(len(subject))]
    canvas.rows("text", rr.TextDocument, {"media_type": rr.MediaType.MARKDOWN}, text=texts)
    recording.send_blueprint(laid_out(posture_views(subject), canvas.index.timeline_name()))


def log_standing(
    recording: rr.RecordingStream, subject: Subject, sequence: np.ndarray | None = None
) -> Canvas:
    """Log the robot on its plates with everything on the ground; without a sequence rows are 1, 2, ..."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    robot_view.log_geometry(recording, "world/robot", subject.nominal.robot.visual_model)
    canvas = Canvas(recording, _time_line(subject, sequence))
    robot_view.log_motion(canvas, subject)
    robot_view.log_plates(canvas, subject)
    robot_view.log_subject_loads(canvas, subject)
    log_balance(canvas, subject)
    return canvas


def _time_line(subject: Subject, sequence: np.ndarray | None) -> rr.TimeColumn:
    """Return the time of a robot that moves, otherwise the numbers of the rows."""
    m = subject.measurements
    if sequence is None and m is not None and m.joint_rates is not None and np.isfinite(m.time).all():
        return rr.TimeColumn("time", duration=m.time + m.window / 2)
    return rr.TimeColumn("posture", sequence=np.arange(1, len(subject) + 1) if sequence is None else sequence)


def log_links(canvas: Canvas, subject: Subject) -> None:
    """Log the masses of the links, the true ones too where they differ, and the skeleton."""
    nominal = standard_parameters(subject.nominal.robot.visual_model)
    others = {name: true for name, true in subject.true_masses.items() if not np.allclose(true, nominal)}
    robot_view.log_masses(canvas, subject, {"nominal model": nominal} | others)
    robot_view.log_skeleton(canvas, "world/masses/skeleton", subject, subject.rows.joint_angles, SKELETON)


def posture_views(subject: Subject) -> dict[str, list[rrb.View]]:
    size = SOLE if subject.sensors_in_feet else subject.board.size
    ground = [above_view(subject.plates, size)]
    if subject.cop is not None:
        ground.append(close_up_view(subject))
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


def above_view(plates: np.ndarray, size: np.ndarray) -> rrb.Spatial2DView:
    """Return the view of the ground from above, x up and y to the left, with all placements."""
    reach = np.linalg.norm(size) / 2
    corners = np.vstack([plates[..., :2].reshape(-1, 2) - reach, plates[..., :2].reshape(-1, 2) + reach])
    low, high = from_above(corners).min(axis=0), from_above(corners).max(axis=0)
    name = "From above, mm (x up, y left)"
    return plane_view("above", name, (low[0], high[0]), (low[1], high[1]))


def close_up_view(subject: Subject) -> rrb.Spatial2DView:
    """Return the view of CoP and CoM around the reference."""
    _, _, reach = close_up(subject)
    name = "estimated" if "estimate" in subject.com else "nominal"
    scale = " and ".join(f"{radius:g}" for radius in circles(reach))
    name = f"Close-up around the {name} CoM: circles of {scale} mm (x up, y left)"
    return plane_view("close_up", name, (-reach, reach), (-reach, reach))
