"""`tulip montecarlo`, its folder and its runs: interrupted, killed, resumed, refused, the same bits."""

import dataclasses
import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

import tulip_testbed as tt
from tests import dying_work
from tests.montecarlo_work import LAYOUT, Regressions, bytes_of, run_regressions
from tests.test_cli import TULIP
from tests.test_refusals import change_document, refuse, rows
from tulip_testbed.base.machine import machine
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of, stream_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings, montecarlo_file
from tulip_testbed.experiments.montecarlo.montecarlo_run import collect, raise_runs, run_folder
from tulip_testbed.experiments.montecarlo.run_columns import RunChunks, read_runs
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.statics.static_run import run_statics

RUNS = 110  # five chunks of 25 or fewer: two of them are there long before the last


def tulip(plan: Path, out: Path, *more: str) -> list[str]:
    options = ["--out", str(out), "--runs", str(RUNS), "--seed", "107", "--workers", "1", "--json"]
    quick = ["--estimator", MIXED_MODEL, "--imperfections", "0"]
    return [*TULIP, "montecarlo", str(plan), *options, *quick, *more]


def stop(command: list[str], folder: Path, chunks: int, how: signal.Signals) -> subprocess.Popen[str]:
    """Send a signal to the command and its workers once so many chunks are there."""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while process.poll() is None and len(list(folder.glob("runs/*.parquet"))) < chunks:
        time.sleep(0.005)
    os.killpg(process.pid, how)
    return process


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.slow
def test_interrupted_and_killed_it_ends_as_if_undisturbed(plan, tmp_path):
    small, broken, whole = (tmp_path / name for name in ("small", "broken", "whole"))
    write_plan(small, plan.take(plan.placement <= 3))
    process = stop(tulip(small, broken), broken, 1, signal.SIGINT)
    out, err = process.communicate()
    assert process.returncode == 130
    assert "broken holds 25 of 110 runs; the same command resumes" in " ".join(err.split())
    assert "Traceback" not in err
    assert out == ""
    assert not (broken / "report.json").exists()

    stop(tulip(small, broken, "--workers", "2"), broken, 2, signal.SIGKILL).communicate()
    assert 2 <= len(list(broken.glob("runs/*.parquet"))) < 5

    resumed = subprocess.run(tulip(small, broken), capture_output=True, text=True, check=False)
    straight = subprocess.run(
        tulip(small, whole, "--workers", "2"), capture_output=True, text=True, check=False
    )
    assert resumed.returncode in (0, 1, 3), resumed.stderr
    assert content(broken) == content(whole)

    found, expected = json.loads(resumed.stdout), json.loads(straight.stdout)
    assert found == expected
    again = subprocess.run(tulip(small, broken), capture_output=True, text=True, check=False)
    assert json.loads(again.stdout)["parameters"] == found["parameters"]
    assert content(broken) == content(whole)

    other = subprocess.run(tulip(small, broken, "--seed", "108"), capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "settings.seed is 107 there and 108 here" in " ".join(other.stderr.split())
    assert pyarrow.parquet.read_table(whole / "runs").column("run").to_pylist() == list(range(RUNS))


@pytest.mark.parametrize("engine", ["statics", pytest.param("dynamics", marks=pytest.mark.slow)])
def test_random_robots(robot, model, plan, engine):
    """Each run has its own robot; the nominal one without a spread; the same stream, the same run."""
    scenario = tt.Laboratory(robot, "wii"), plan.take(plan.placement <= 1)
    random: Any = source_of(*scenario, 0.1, engine)
    first, second = random([stream_of(107, run) for run in range(2)])
    assert np.abs(first.truth.standard - second.truth.standard).max() > 0.01
    assert first.truth.mass == pytest.approx(first.truth.standard[:, 0].sum(), rel=1e-12)
    (alone,) = random([stream_of(107, 1)])
    np.testing.assert_array_equal(alone.measurements.cell_forces, second.measurements.cell_forces)
    nominal: Any = source_of(*scenario, None, engine)([stream_of(107, 1)])[0]
    np.testing.assert_array_equal(nominal.truth.standard, standard_parameters(model))
    for run in (first, second, nominal):
        weight = run.measurements.cell_forces.sum(axis=1).mean() / 9.81
        assert weight == pytest.approx(run.truth.mass, abs=0.3)
    assert nominal.truth.mass == pytest.approx(23.0, abs=1e-9)


def test_a_run_without_a_posture_does_not_take_others_with_it(robot, plan, monkeypatch):
    scenario = tt.Laboratory(robot, "wii"), plan.take(plan.placement <= 1)
    static = source_of(*scenario, None, "statics")

    def fail(solved_plan, streams, standard):
        if any(stream.spawn_key[0] == 2 for stream in streams):
            raise tt.InputError("none of 6 postures could be measured: tipped")
        return run_statics(solved_plan, streams, standard)

    monkeypatch.setattr("tulip_testbed.experiments.montecarlo.laboratory_runs.run_statics", fail)
    outcomes = static([stream_of(107, run) for run in range(4)])
    assert [isinstance(outcome, str) for outcome in outcomes] == [False, False, True, False]


SETTINGS = Settings(runs=100, seed=5, estimator="mixed-model", robot_spread=None, imperfections=0)


@pytest.fixture
def scenario(robot, plan):
    return tt.Laboratory(robot, "wii"), plan


def document_of(scenario, settings=SETTINGS):
    return montecarlo_file(scenario[0], scenario[1], settings)


def kept(folder, scenario, settings=SETTINGS):
    return run_folder(folder, document_of(scenario, settings))


def begin(folder, scenario, settings=SETTINGS):
    with kept(folder, scenario, settings).opened():
        pass


@rows("scenarios")
def test_another_laboratory_or_plan_is_refused(scenario, tmp_path, changes, words):
    begin(tmp_path / "run", scenario)
    names = {"lab": scenario[0], "plan": scenario[1], "settings": SETTINGS, "tt": tt}
    other, plan, *settings = eval(changes[0], names | {"replace": dataclasses.replace})
    refuse(words, begin, tmp_path / "run", (other, plan), *settings)


def test_another_version_is_refused(scenario, tmp_path):
    begin(tmp_path / "run", scenario)
    change_document(tmp_path / "run" / "run.json", 'software.numpy = "1.0"')
    refuse("software.numpy is '1.0' there", begin, tmp_path / "run", scenario)


def test_the_processor_is_recorded_and_another_one_may_go_on(scenario, tmp_path):
    folder = tmp_path / "run"
    begin(folder, scenario)
    document = json.loads((folder / "run.json").read_text())
    assert document["machine"] == machine()
    assert all(len(text) > 3 for text in document["machine"].values())
    for change in ('machine = {"cpu": "abacus"}', "machine -"):
        change_document(folder / "run.json", change)
        begin(folder, scenario)


def test_more_runs_in_the_same_folder(robot, plan, tmp_path):
    """The last file, which was not full, is made anew; the folder ends as if made at once."""
    laboratory, few = tt.Laboratory(robot, "wii"), plan.take(plan.placement <= 8)

    def carried_out(name, runs):
        exact = {"estimator": "mixed-model", "imperfections": 0.0}
        return tt.monte_carlo(laboratory, few, runs=runs, out=tmp_path / name, workers=1, **exact)

    carried_out("raised", 1)
    found, straight = carried_out("raised", 2), carried_out("straight", 2)
    assert found.runs == 2
    assert found.errors_mm["full"].tolist() == straight.errors_mm["full"].tolist()
    straight.save(tmp_path / "saved")
    for file in ("run.json", "report.json", "runs/chunk-000000.parquet", "plan/plan.json"):
        expected = (tmp_path / "straight" / file).read_bytes()
        assert (tmp_path / "raised" / file).read_bytes() == expected
        assert (tmp_path / "saved" / file).read_bytes() == expected
    assert MonteCarlo.load(tmp_path / "saved", robot).to_json() == straight.to_json()
    assert MonteCarlo.from_json(straight.to_json()).tables() == straight.tables()
    assert carried_out("saved", 3).runs == 3


def test_more_runs_of_another_kind_are_refused(scenario, tmp_path):
    begin(tmp_path / "run", scenario)
    before = (tmp_path / "run" / "run.json").read_bytes()
    raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200, seed=6)))
    assert (tmp_path / "run" / "run.json").read_bytes() == before
    with (
        kept(tmp_path / "run", scenario).opened(),
        pytest.raises(tt.InputError, match="another process is at work"),
    ):
        raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200)))
    assert (tmp_path / "run" / "run.json").read_bytes() == before
    raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200)))
    assert json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["runs"] == 200


FEW, SIZE = 23, 5


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> RunChunks:
    return run_regressions(tmp_path_factory.mktemp("undisturbed"), FEW, SIZE, Regressions())


def test_two_workers_write_the_same_bytes(undisturbed, tmp_path):
    assert bytes_of(run_regressions(tmp_path, FEW, SIZE, Regressions(), 2)) == bytes_of(undisturbed)
    assert sorted(p.name for p in tmp_path.iterdir())[-1] == "chunk-000004.parquet"


@pytest.mark.parametrize("size", [1, 7, FEW])
def test_rows_do_not_depend_on_the_chunks(undisturbed, tmp_path, size):
    run_regressions(tmp_path, FEW, size, Regressions())
    assert pyarrow.parquet.read_table(tmp_path).equals(pyarrow.parquet.read_table(undisturbed.folder))


def test_a_full_disk_leaves_what_was_written(undisturbed, tmp_path, monkeypatch):
    written = Path.write_bytes

    def until_full(path, content):
        if "chunk-000002" in path.name:
            written(path, content[:100])
            raise OSError(28, "No space left on device")
        return written(path, content)

    monkeypatch.setattr(Path, "write_bytes", until_full)
    chunks = RunChunks(tmp_path, FEW, SIZE)
    refuse("No space left on device", run_regressions, tmp_path, FEW, SIZE, Regressions())
    monkeypatch.undo()
    assert chunks.missing() == [2, 3, 4]
    assert len(list(tmp_path.iterdir())) == 2
    assert bytes_of(run_regressions(tmp_path, FEW, SIZE, Regressions())) == bytes_of(undisturbed)


def test_a_worker_that_dies_is_told(tmp_path):
    message = "a worker process ended by SIGKILL.*, as the system does when memory runs out"
    with pytest.raises(tt.InputError, match=message):
        collect(RunChunks(tmp_path, 4, 1), dying_work.die, lambda count: None, 2)


def test_without_a_folder_nothing_is_said_to_stay(monkeypatch, robot, plan):
    def fail(*given):
        raise tt.InputError("no space")

    monkeypatch.setattr("tulip_testbed.experiments.montecarlo.montecarlo_run.collect", fail)
    with pytest.raises(tt.InputError, match=r"^no space; nothing was kept$"):
        tt.monte_carlo(tt.Laboratory(robot), plan, runs=2, workers=1)


@rows("runs")
def test_what_no_run_gives_is_refused_by_column(tmp_path, changes, words):
    chunks = run_regressions(tmp_path, FEW, SIZE, Regressions())
    table, (name, _, values) = pyarrow.parquet.read_table(chunks.path(1)), changes[0].partition(" = ")
    table = table.set_column(table.column_names.index(name), name, pa.array(eval(values, {"np": np})))
    pyarrow.parquet.write_table(table, chunks.path(1))
    refuse(f"chunk-000001.parquet: ... {words}", read_runs, chunks, LAYOUT)


def test_a_column_that_comes_twice_and_rows_without_end_are_refused(tmp_path):
    chunks = run_regressions(tmp_path, FEW, SIZE, Regressions())
    intact = pyarrow.parquet.read_table(chunks.path(1))
    twice, many = intact.select([*intact.column_names, "mass"]), pa.concat_tables([intact] * 1_000)
    for table, message in ((twice, "cannot read"), (many, "not the chunk of runs 5 to 9")):
        pyarrow.parquet.write_table(table, chunks.path(1))
        refuse(f"chunk-000001.parquet: {message}", read_runs, chunks, LAYOUT)
    chunks.path(1).write_bytes(b"PAR1 broken PAR1")
    refuse("chunk-000001.parquet: cannot read", read_runs, chunks, LAYOUT)
