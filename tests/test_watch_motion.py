"""`tulip watch` on a robot that moves: noise that lasts, samples that arrive, and changes."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import tulip_testbed as tt
from studies.study_motion import laboratory
from tests.test_refusals import change_document
from tests.test_watch import play
from tulip_testbed.base.table_files import write_table
from tulip_testbed.experiments.watching import watch_day
from tulip_testbed.experiments.watching.alarm import CHANGED, ODD, OK
from tulip_testbed.experiments.watching.arriving_rows import ArrivingSamples
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.row_columns import row_columns
from tulip_testbed.experiments.watching.watch_day import FIRST, TRIED, likelihood, with_noise_in_time
from tulip_testbed.experiments.watching.watch_row import _columns
from tulip_testbed.experiments.watching.watch_state import Belief, DesignInformation, first_state
from tulip_testbed.identification.noise_in_time import NoiseInTime
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements.logs.series_reduction import reduced
from tulip_testbed.measurements.measurement_folder import read_manifest, write_motion
from tulip_testbed.measurements.motion_table import motion_columns
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig

WINDOW, SEED, ONSET = 0.5, 900, 100
LASTS = NoiseInTime(0.9, 2.0)


@pytest.fixture(scope="module")
def plan():
    few = tt.plans.random
    return tt.plan_motion(few.take(np.isin(few.placement, [1, 3])), speed=0.5).plan


@pytest.fixture(scope="module")
def samples(robot, plan) -> tt.Measurements:
    """The planned motion with readings that carry the weight somehow, and noise."""
    motion, rng = plan.motion, np.random.default_rng(SEED)
    n, header = len(motion), header_of(preset_rig("wii", robot))
    weight = nominal_robot(robot).mass * header.gravity
    return tt.Measurements.from_arrays(
        header,
        posture=motion.segment,
        placement=motion.placement,
        support=motion.support,
        time=motion.time,
        joint_angles=motion.joint_angles + 1e-4 * rng.standard_normal(motion.joint_angles.shape),
        cell_forces=weight / 8 + rng.standard_normal((n, 8)),
        plate_poses=np.tile([[0.0, 0.0, 0.0], [0.0, 0.2, 0.0]], (n, 1, 1)),
    )


@pytest.fixture(scope="module")
def model(robot, plan, samples) -> DayModel:
    return day_model(plan, robot, samples, WINDOW).with_noise(LASTS)


@pytest.fixture
def folder(tmp_path, samples) -> tuple[Path, list[bytes]]:
    """A measurement folder whose table has no row yet, and its lines."""
    write_motion(tmp_path / "lab", samples)
    (tmp_path / "lab" / "motion.parquet").unlink()
    lines = write_table(tmp_path, "motion", motion_columns(samples))["csv"].read_bytes().splitlines(True)
    (tmp_path / "lab" / "motion.csv").write_bytes(lines[0])
    change_document(tmp_path / "lab" / "manifest.json", "tables -")
    return tmp_path / "lab", lines[1:]


def grow(folder: Path, lines: list[bytes]) -> None:
    with (folder / "motion.csv").open("ab") as file:
        file.write(b"".join(lines))


def arriving(folder: Path, weight: float) -> ArrivingSamples:
    where, manifest = folder / "manifest.json", read_manifest(folder)
    path, size = folder / "motion.csv", {"weight": weight, "window": WINDOW}
    return ArrivingSamples(path=path, manifest=manifest, where=where, **size)


def found(arriving: ArrivingSamples, folder: Path, lines: list[bytes], cuts: list[int]) -> list:
    """What comes of lines that arrive in pieces."""
    out = []
    for a, b in zip([0, *cuts], [*cuts, len(lines)], strict=True):
        grow(folder, lines[a:b])
        out += list(arriving.new())
    return out


def test_rows_are_those_of_the_whole_record_however_the_samples_arrive(folder, samples):
    path, lines = folder
    weight = 50.0
    table = (path / "motion.csv").read_bytes()
    whole = reduced(samples, weight, WINDOW, WINDOW).measurements
    pieces = [one.row for one in found(arriving(path, weight), path, lines, [7, 8, 120, 1700])]
    for name in ("time", "joint_angles", "joint_rates", "joint_accelerations", "cell_forces", "placement"):
        got = np.concatenate([getattr(one, name) for one in pieces])
        np.testing.assert_allclose(got, getattr(whole, name), rtol=1e-9, atol=1e-9)
    assert [int(one.posture[0]) for one in pieces] == list(range(1, len(whole) + 1))
    (path / "motion.csv").write_bytes(table)
    once = [one.row for one in found(arriving(path, weight), path, lines, [])]
    for one, other in zip(pieces, once, strict=True):
        for name in ("time", "joint_angles", "joint_accelerations", "cell_forces"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_lines_that_cannot_be_used_are_told_and_passed_over(folder):
    path, lines = folder
    lines = lines[:200]
    lines[20] = b"broken" + lines[20]
    lines[30] = lines[29]  # the clock stands still
    told = found(arriving(path, 50.0), path, lines, [25])
    assert [one.line.number for one in told if one.problem] == [22, 32]
    assert "motion.csv: line 22: " in told[0].problem
    assert "expected a time that increases" in told[1].problem
    assert len([one for one in told if one.row is not None]) == 3


def test_the_filter_is_the_regression_with_noise_that_lasts(model, samples):
    """By brute force: all rows at once, their noise correlated between the rows of a segment."""
    rows = reduced(samples, 50.0, WINDOW, WINDOW).measurements.take(np.arange(8))
    columns = row_columns(model, rows)
    columns = replace(columns, slope=np.zeros_like(columns.slope))
    at, (share, white) = model.lasting, model.shares
    others = np.delete(np.arange(len(model.covariance)), np.arange(at.start, at.stop))
    belief = Belief(np.zeros(len(model.covariance)), model.covariance)
    for k in range(len(rows)):
        belief = belief.later(model, model.lasting, np.exp(-WINDOW / 2.0) if k else 0.0)
        belief = belief.updated(belief.predict(model, columns.row(k)))
    reach, slow = columns.state[..., others].reshape(88, -1), columns.state[..., at]
    apart = np.abs(rows.time[:, None] - rows.time)
    noise = np.einsum("ars,bns,ab->arbn", slow, slow, share * np.exp(-apart / 2.0))
    each = np.arange(len(rows))
    noise[each, :, each] += columns.noise(model.noise.encoder, white)
    noise = noise.reshape(88, 88)
    prior = model.covariance[np.ix_(others, others)]
    gain = prior @ reach.T @ np.linalg.inv(reach @ prior @ reach.T + noise)
    mean = gain @ columns.residual.ravel()
    sd = np.sqrt(np.maximum(np.diag(prior - gain @ reach @ prior), 1e-30))
    np.testing.assert_allclose(belief.mean[others] / sd, mean / sd, atol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance))[others], sd, rtol=1e-3)


def test_columns_do_not_hold_the_noise_that_a_row_shows(model, samples):
    """Otherwise those of gains draw evidence from it, in every row a little."""
    one, state = reduced(samples, 50.0, WINDOW, WINDOW).measurements.take(np.arange(1)), first_state(model)
    one = replace(one, cell_accelerations=None)  # what yields to loads that change follows from the readings
    before = row_columns(model, one).row(0)
    belief = state.belief.updated(state.belief.predict(model, before))
    errors = model.noise.cell * belief.mean[model.lasting][None, -8:]
    after = _columns(model, state, one)
    clean = row_columns(model, replace(one, cell_forces=one.cell_forces - errors)).row(0)
    assert np.abs(after.faults - before.faults).max() > 1e-6
    np.testing.assert_allclose(after.faults, clean.faults, atol=1e-12)
    np.testing.assert_array_equal(after.residual, before.residual)


def test_rows_of_noise_that_lasts_count_less(model, samples):
    rows = reduced(samples, 50.0, WINDOW, WINDOW).measurements.take(np.zeros(40, int))
    one = row_columns(model, rows).row(0)
    kept, alone, together = 0.8, *2 * [DesignInformation.begun(np.zeros((model.parameters,) * 2))]
    for _ in rows.time:
        alone, together = alone.with_posture(model, one), together.with_posture(model, one, kept)
    share = (1 + 39 * (1 - kept) / (1 + kept)) / 40  # of an autoregressive process, for a constant
    begun = DesignInformation.begun(np.zeros((model.parameters,) * 2)).joint
    np.testing.assert_allclose(together.joint - begun, share * (alone.joint - begun), rtol=1e-6, atol=1e-6)


def test_noise_in_time_is_that_of_the_first_rows(model, samples):
    """Residuals are drawn with noise that lasts 2 s; the likelihood of the filter is largest near it."""
    rows = reduced(samples, 50.0, WINDOW, WINDOW).measurements
    columns, rng = row_columns(model, rows), np.random.default_rng(SEED)
    at, (share, white) = model.lasting, model.shares
    slow = np.zeros(at.stop - at.start)
    residual = np.zeros_like(columns.residual)
    for k in range(len(rows)):
        kept = model.kept(float(rows.time[k] - rows.time[k - 1])) if k else 0.0
        slow = kept * slow + np.sqrt(share * (1 - kept**2)) * rng.standard_normal(len(slow))
        own = np.linalg.cholesky(columns.row(k).noise(model.noise.encoder, white) + 1e-18 * np.eye(11))
        residual[k] = columns.state[k][:, at] @ slow + own @ rng.standard_normal(11)
    columns = replace(columns, residual=np.where(columns.used, residual, 0.0))
    found = max(TRIED, key=lambda one: likelihood(model.with_noise(one), rows, columns))
    assert found.share >= 0.8
    assert 1.0 <= found.seconds <= 4.0


def test_a_killed_watch_goes_on_and_pieces_change_nothing(folder, plan, robot, tmp_path, monkeypatch):
    path, lines = folder
    lines, header = lines[:700], (path / "motion.csv").read_bytes()
    monkeypatch.setattr(watch_day, "FIRST", 6)
    monkeypatch.setattr(watch_day, "with_noise_in_time", lambda model, rows: model.with_noise(LASTS))
    watch = partial(tt.watch, path, robot, plan=plan, once=True)
    parts = []
    for a, b in ((0, 250), (250, 520), (520, 700)):  # before the first rows are complete, and later
        grow(path, lines[a:b])
        parts.append(list(watch(out=tmp_path / "state")))
    assert [len(part) for part in parts[:2]] == [0, 10]
    assert tt.watch(path, robot, plan=plan).tables() == ["Fewer than 6 rows have arrived."]
    (path / "motion.csv").write_bytes(header)
    grow(path, lines)
    whole = list(watch())
    told, expected = (
        [(one.line, str(one.verdict), one.verdict and one.verdict.standard_errors) for one in several]
        for several in ([one for part in parts for one in part], whole)
    )
    assert told == expected
    assert whole[0].verdict is not None
    first = whole[0].verdict.to_json()
    assert (first["row"], first["time"]) == (1, 0.0)
    assert "next" not in first
    assert str(whole[0].verdict).startswith("row 1, 0.0 s: ")


@pytest.mark.slow
def test_a_motion_in_order_and_changes_within_it(robot):
    """In the full dynamics, in an ordinary laboratory with a random robot."""
    few = tt.plans.random
    plan = tt.plan_motion(few.take(few.placement <= 6), speed=0.3).plan
    run = laboratory("wii", SEED).run(plan, seed=SEED, engine="dynamics", workers=1)
    samples = run.samples
    assert samples is not None
    rows = partial(reduced, weight=50.0, window=WINDOW, step=WINDOW)
    clean = rows(samples).measurements
    model = with_noise_in_time(day_model(plan, robot, clean, WINDOW), clean.take(np.arange(FIRST)))
    assert 1.0 <= model.noise_in_time.seconds <= 4.0
    before, verdicts = play(model, clean.take(np.arange(ONSET)), first_state(model))
    _, more = play(model, clean.take(np.arange(ONSET, ONSET + 20)), before)
    assert {one.verdict for one in verdicts + more} == {OK}
    later = samples.time >= clean.time[ONSET]
    for field, column, factor, zero, name in (
        ("joint_angles", samples.joints.index("right_knee"), 1.0, np.radians(1.0), "right_knee"),
        ("cell_forces", 0, 1.4, 0.0, "right.front_left"),
    ):
        readings = getattr(samples, field).copy()
        readings[later, column] = factor * readings[later, column] + zero
        changed = rows(replace(samples, **{field: readings})).measurements
        _, verdicts = play(model, changed.take(np.arange(ONSET, ONSET + 4)), before)
        first = next(k for k, one in enumerate(verdicts) if one.verdict == CHANGED)
        assert {one.verdict for one in verdicts[:first]} <= {OK, ODD}
        assert f":{name}:" in verdicts[first].findings[0].seen
