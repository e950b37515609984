"""A Monte Carlo: the measured CoP of each posture, and the distribution of each parameter's errors."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.base.document import first_difference
from tulip_testbed.colours import ESTIMATE, MEASURED, SKELETON, rgb
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.coverage_tables import coverage_check_table
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of, stream_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, montecarlo_file
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.contact_pressure import contact_pressure
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.viewer.balance_series import from_above, log_balance
from tulip_testbed.viewer.layout import Views, above_view, laid_out, space_views
from tulip_testbed.viewer.plates_view import log_plates
from tulip_testbed.viewer.robot_view import log_geometry, log_masses, log_motion, log_skeleton
from tulip_testbed.viewer.subject import Subject, planned

CLOUD_RUNS, BINS = 100, 40
MOST_Z = 5.0  # standard errors that the picture of all parameters reaches


def log_montecarlo(recording: rr.RecordingStream, run: MonteCarlo) -> None:
    """Log a Monte Carlo and the layout of its views."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    subject = planned(run.plan, run.robot)
    index = rr.TimeColumn("posture", sequence=np.arange(1, len(subject) + 1))
    model = run.robot.visual_model
    log_geometry(recording, "world/robot", model)
    log_motion(recording, "world/robot", index, subject)
    masses = {"nominal model": standard_parameters(model)}
    log_masses(recording, "world/masses", index, subject, masses)
    log_skeleton(recording, "world/masses/skeleton", index, subject, subject.joint_angles, SKELETON)
    log_plates(recording, "world/plates", index, subject)
    log_balance(recording, index, subject)
    clouds, note = cop_clouds(run)
    if clouds:
        _log_clouds(recording, subject, clouds)
    _log_errors(recording, run)
    recording.log("text", rr.TextDocument(_text(run, note), media_type=rr.MediaType.MARKDOWN), static=True)
    recording.send_blueprint(laid_out(montecarlo_views(run, subject, bool(clouds))))


def cop_clouds(run: MonteCarlo) -> tuple[dict[int, np.ndarray], str]:
    """Simulate the first runs again from their seeds; return every posture's CoP and a sentence about them.

    The folder holds estimates, not measurements; the same seed gives the same measurements again.

    Returns:
        by posture number, (k, 2) [m]; empty where a run takes minutes.
    """
    settings = run.document.settings
    if settings.engine == "dynamics":
        return {}, "No CoP clouds: every run in the full dynamics would take a minute again."
    made = Laboratory(run.robot, run.document.configuration.preset)
    here = montecarlo_file(made, run.plan, settings)
    other = first_difference(run.document.plain(), here.plain())
    if other is not None and not other[0].startswith("software"):
        return {}, f"No CoP clouds: {other[0]} is {other[1]!r} in the run and {other[2]!r} here."
    count = min(CLOUD_RUNS, settings.runs)
    simulate = source_of(made, run.plan, settings.robot_spread, settings.engine, settings.imperfections)
    points: dict[int, list[np.ndarray]] = {}
    nominal = nominal_robot(run.robot, common_support(run.plan.support))
    for outcome in simulate([stream_of(settings.seed, k) for k in range(count)]):
        if not isinstance(outcome, str):
            cop = contact_pressure(outcome.measurements, nominal).center
            for posture, point in zip(outcome.measurements.posture, cop, strict=True):
                points.setdefault(int(posture), []).append(point)
    versions = f" {other[0]} is {other[1]} in the run and {other[2]} here." if other else ""
    return (
        {posture: np.array(cloud) for posture, cloud in points.items()},
        f"CoP clouds: measured CoP of each posture in the first {count} runs.{versions}",
    )


def _log_clouds(recording: rr.RecordingStream, subject: Subject, clouds: dict[int, np.ndarray]) -> None:
    rows = [k for k, posture in enumerate(subject.posture) if int(posture) in clouds]
    index = rr.TimeColumn("posture", sequence=np.array(rows) + 1)
    points = [clouds[int(subject.posture[k])] for k in rows]
    lengths, flat = [len(cloud) for cloud in points], np.vstack(points)
    colour = rgb(MEASURED)
    ground = np.column_stack([flat, np.full(len(flat), 0.004)])
    recording.log("world/cop_cloud", rr.Points3D.from_fields(colors=colour, radii=0.003), static=True)
    recording.send_columns(
        "world/cop_cloud", [index], rr.Points3D.columns(positions=ground).partition(lengths)
    )
    style = rr.Points2D.from_fields(colors=colour, radii=rr.Radius.ui_points(1.5))
    for path, place in (
        ("above/cop_cloud", flat),
        ("cloud/cop", np.vstack([cloud - cloud.mean(axis=0) for cloud in points])),
    ):
        recording.log(path, style, static=True)
        columns = rr.Points2D.columns(positions=from_above(place)).partition(lengths)
        recording.send_columns(path, [index], columns)
    ellipses = [from_above(_ellipse(cloud)) for cloud in points]
    blue = rr.LineStrips2D.from_fields(colors=rgb(ESTIMATE), radii=rr.Radius.ui_points(1))
    recording.log("cloud/two_sd", blue, static=True)
    recording.send_columns("cloud/two_sd", [index], rr.LineStrips2D.columns(strips=ellipses))


def _ellipse(cloud: np.ndarray) -> np.ndarray:
    """Return two s.d. of a cloud about its mean, (73, 2) [m]; a single point if the cloud is too small."""
    if len(cloud) < 3:
        return np.zeros((2, 2))
    values, vectors = np.linalg.eigh(np.cov(cloud.T))
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return 2 * circle * np.sqrt(np.maximum(values, 0)) @ vectors.T


def _log_errors(recording: rr.RecordingStream, run: MonteCarlo) -> None:
    """Log all runs' errors as columns of points, and a histogram on the `parameter` line."""
    for model, errors in run.errors_mm.items():
        rows = run.models[model].parameters
        numbers = [row.number for row in rows]
        rng = np.random.default_rng(0)  # sideways only, so that points do not hide each other
        for k, number in enumerate(numbers):
            recording.set_time("parameter", sequence=number)
            counts, edges = np.histogram(errors[:, k], bins=BINS)
            bars = rr.BarChart(
                counts, abscissa=(edges[1:] + edges[:-1]) / 2, widths=np.diff(edges), color=rgb(ESTIMATE)
            )
            recording.log(f"histogram/{model}", bars)
        recording.reset_time()
        stated = 1e3 * np.array([row.standard_error for row in rows], float)
        place = np.arange(1, len(numbers) + 1)
        side = place + rng.uniform(-0.3, 0.3, errors.shape)
        flat = np.column_stack([side.ravel(), -(errors / stated).ravel()])
        points = rr.Points2D(flat, colors=rgb(ESTIMATE), radii=rr.Radius.ui_points(1))
        recording.log(f"errors/{model}/runs", points, static=True)
        lines = [[[0, -z], [len(numbers) + 1, -z]] for z in (-2, 0, 2)]
        scale = rr.LineStrips2D(lines, colors=rgb(MEASURED), radii=rr.Radius.ui_points(1))
        recording.log(f"errors/{model}/two_standard_errors", scale, static=True)
        labels = rr.Points2D(
            np.column_stack([place, np.full(len(place), MOST_Z - 0.5)]),
            labels=[str(number) for number in numbers],
            colors=(20, 20, 20),
            show_labels=True,
        )
        recording.log(f"errors/{model}/numbers", labels, static=True)


def _text(run: MonteCarlo, note: str) -> str:
    lines = [
        f"## Verdict: {run.verdict}{'' if run.conclusive else ', inconclusive'}",
        f"{run.identified} of {run.runs} runs identified, estimator {run.estimator}.",
        "",
        coverage_check_table(run.to_json()["checks"]).markdown(),
        "",
        note,
        "",
        "Errors: estimate minus truth over the standard error that the estimator states, a point a run, a "
        "column a parameter, lines at -2, 0 and 2. Histograms, in mm: choose the `parameter` time line.",
    ]
    return "\n".join(lines)


def montecarlo_views(run: MonteCarlo, subject: Subject, clouds: bool) -> Views:
    """Arrange the views of a Monte Carlo.

    Args:
        clouds: whether there are CoP clouds.
    """
    pale = {"background": (250, 250, 250)}
    counts = {model: errors.shape[1] for model, errors in run.errors_mm.items()}
    errors = [
        rrb.Spatial2DView(
            origin=f"errors/{model}",
            name=f"Errors over s.e., {model} model (up: too large)",
            visual_bounds=rrb.VisualBounds2D(x_range=[0, count + 1], y_range=[-MOST_Z, MOST_Z]),
            **pale,
        )
        for model, count in counts.items()
    ]
    bars = [
        rrb.BarChartView(
            origin=f"histogram/{model}", name=f"{model.capitalize()} model, mm (time line: parameter)"
        )
        for model in counts
    ]
    ground: list[rrb.View] = [above_view(subject.plates, subject.board.size)]
    if clouds:
        name = "CoP around its mean, mm (x up, y left); ellipse: 2 s.d."
        bounds = rrb.VisualBounds2D(x_range=[-20, 20], y_range=[-20, 20])
        ground.append(rrb.Spatial2DView(origin="cloud", name=name, visual_bounds=bounds, **pale))
    text = rrb.TextDocumentView(origin="text", name="Verdict")
    return Views([*space_views(subject)], ground, [*errors, *bars], [text])
