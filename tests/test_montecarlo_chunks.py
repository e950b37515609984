"""The runs of a Monte Carlo: the same bits wherever and however often they are computed, or one message."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

import tulip_testbed as tt
from tests import dying_work
from tests.montecarlo_work import LAYOUT, Regressions, bytes_of, run_regressions
from tests.test_refusals import refuse, rows
from tulip_testbed.experiments.montecarlo.montecarlo_run import collect
from tulip_testbed.experiments.montecarlo.run_columns import RunChunks, read_runs

RUNS, SIZE = 23, 5


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> RunChunks:
    return run_regressions(tmp_path_factory.mktemp("undisturbed"), RUNS, SIZE, Regressions())


def test_two_workers_write_the_same_bytes(undisturbed, tmp_path):
    assert bytes_of(run_regressions(tmp_path, RUNS, SIZE, Regressions(), 2)) == bytes_of(undisturbed)
    assert sorted(p.name for p in tmp_path.iterdir())[-1] == "chunk-000004.parquet"


@pytest.mark.parametrize("size", [1, 7, RUNS])
def test_rows_do_not_depend_on_the_chunks(undisturbed, tmp_path, size):
    run_regressions(tmp_path, RUNS, size, Regressions())
    assert pa.parquet.read_table(tmp_path).equals(pa.parquet.read_table(undisturbed.folder))


def test_a_full_disk_leaves_what_was_written(undisturbed, tmp_path, monkeypatch):
    written = Path.write_bytes

    def until_full(path, content):
        if "chunk-000002" in path.name:
            written(path, content[:100])
            raise OSError(28, "No space left on device")
        return written(path, content)

    monkeypatch.setattr(Path, "write_bytes", until_full)
    chunks = RunChunks(tmp_path, RUNS, SIZE)
    refuse("No space left on device", run_regressions, tmp_path, RUNS, SIZE, Regressions())
    monkeypatch.undo()
    assert chunks.missing() == [2, 3, 4]
    assert len(list(tmp_path.iterdir())) == 2
    assert bytes_of(run_regressions(tmp_path, RUNS, SIZE, Regressions())) == bytes_of(undisturbed)


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
    chunks = run_regressions(tmp_path, RUNS, SIZE, Regressions())
    table, (name, _, values) = pa.parquet.read_table(chunks.path(1)), changes[0].partition(" = ")
    table = table.set_column(table.column_names.index(name), name, pa.array(eval(values, {"np": np})))
    pa.parquet.write_table(table, chunks.path(1))
    refuse(f"chunk-000001.parquet: ... {words}", read_runs, chunks, LAYOUT)


def test_a_column_that_comes_twice_and_rows_without_end_are_refused(tmp_path):
    chunks = run_regressions(tmp_path, RUNS, SIZE, Regressions())
    intact = pa.parquet.read_table(chunks.path(1))
    twice, many = intact.select([*intact.column_names, "mass"]), pa.concat_tables([intact] * 1_000)
    for table, message in ((twice, "cannot read"), (many, "not the chunk of runs 5 to 9")):
        pa.parquet.write_table(table, chunks.path(1))
        refuse(f"chunk-000001.parquet: {message}", read_runs, chunks, LAYOUT)
    chunks.path(1).write_bytes(b"PAR1 broken PAR1")
    refuse("chunk-000001.parquet: cannot read", read_runs, chunks, LAYOUT)
