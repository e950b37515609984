"""A Monte Carlo: the measured CoP of each posture, and the distribution of each parameter's errors."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tulip_testbed.base.document import first_difference
from tulip_testbed.colours import ESTIMATE, MEASURED, rgb
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.coverage_tables import coverage_check_table
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of, stream_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, montecarlo_file
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.viewer.balance_series import from_above
from tulip_testbed.viewer.canvas import CIRCLE, Canvas, flat, log_markdown, plane_view, styled
from tulip_testbed.viewer.layout import Views, above_view, laid_out, space_views
from tulip_testbed.viewer.postures_view import log_links, log_standing
from tulip_testbed.viewer.subject import Subject, planned

CLOUD_RUNS, BINS = 100, 40
MOST_Z = 5.0  # standard errors that the picture of all parameters reaches


def log_montecarlo(recording: rr.RecordingStream, run: MonteCarlo) -> None:
    """Log a Monte Carlo and the layout of its views."""
    subject = planned(run.plan, run.robot)
    canvas = log_standing(recording, subject)
    log_links(canvas, subject)
    clouds, note = cop_clouds(run)
    if clouds:
        _log_clouds(recording, subject, clouds)
    _log_errors(recording, run)
    text = [
        f"## Verdict: {run.verdict}",
        f"{run.identified} of {run.runs} runs identified, estimator {run.estimator}.",
        "",
        coverage_check_table(run.to_json()["checks"]).markdown(),
        "",
        note,
        "",
        "Errors: estimate minus truth over the standard error that the estimator states, a point a run, a "
        "column a parameter, lines at -2, 0 and 2. Histograms, in mm: choose the `parameter` time line.",
    ]
    log_markdown(recording, text)
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
    canvas = Canvas(recording, rr.TimeColumn("posture", sequence=np.array(rows) + 1))
    points = [clouds[int(subject.posture[k])] for k in rows]
    lengths, every = [len(cloud) for cloud in points], np.vstack(points)
    ground = np.column_stack([every, np.full(len(every), 0.004)])
    canvas.rows("world/cop_cloud", rr.Points3D, styled(MEASURED, 0.003), lengths, positions=ground)
    about = np.vstack([cloud - cloud.mean(axis=0) for cloud in points])
    for path, place in (("above/cop_cloud", every), ("cloud/cop", about)):
        canvas.rows(path, rr.Points2D, flat(MEASURED, 1.5), lengths, positions=from_above(place))
    ellipses = []  # two s.d.; a single point if a cloud is too small
    for cloud in points:
        if len(cloud) < 3:
            ellipses.append(np.zeros((2, 2)))
            continue
        values, vectors = np.linalg.eigh(np.cov(cloud.T))
        ellipses.append(from_above(2 * CIRCLE * np.sqrt(np.maximum(values, 0)) @ vectors.T))
    canvas.rows("cloud/two_sd", rr.LineStrips2D, flat(ESTIMATE, 1), strips=ellipses)


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
        z = np.column_stack([side.ravel(), -(errors / stated).ravel()])
        recording.log(f"errors/{model}/runs", rr.Points2D(z, **flat(ESTIMATE, 1)), static=True)
        lines = [[[0, -z], [len(numbers) + 1, -z]] for z in (-2, 0, 2)]
        scale = rr.LineStrips2D(lines, **flat(MEASURED, 1))
        recording.log(f"errors/{model}/two_standard_errors", scale, static=True)
        labels = rr.Points2D(
            np.column_stack([place, np.full(len(place), MOST_Z - 0.5)]),
            labels=[str(number) for number in numbers],
            colors=(20, 20, 20),
            show_labels=True,
        )
        recording.log(f"errors/{model}/numbers", labels, static=True)


def montecarlo_views(run: MonteCarlo, subject: Subject, clouds: bool) -> Views:
    """Arrange the views of a Monte Carlo.

    Args:
        clouds: whether there are CoP clouds.
    """
    counts = {model: errors.shape[1] for model, errors in run.errors_mm.items()}
    errors = [
        plane_view(
            f"errors/{model}",
            f"Error over s.e. (up: too large) by parameter, {model} model",
            (0, count + 1),
            (-MOST_Z, MOST_Z),
        )
        for model, count in counts.items()
    ]
    bars = [
        rrb.BarChartView(
            origin=f"histogram/{model}", name=f"Runs by error in mm, {model} model (time line: parameter)"
        )
        for model in counts
    ]
    ground: list[rrb.View] = [above_view(subject.plates, subject.board.size)]
    if clouds:
        name = "CoP around its mean, mm (x up, y left); ellipse: 2 s.d."
        ground.append(plane_view("cloud", name, (-20, 20), (-20, 20)))
    text = rrb.TextDocumentView(origin="text", name="Verdict")
    return Views([*space_views(subject)], ground, [*errors, *bars], [text])
