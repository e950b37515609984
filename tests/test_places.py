"""Where results may go and what a path may be: one message each, and nobody's files are lost."""

import os
import subprocess
from pathlib import Path

import pytest

import tulip_testbed as tt
from tests.test_cli import TULIP as COMMAND
from tests.test_cli import refused
from tests.test_files import full_disk
from tests.test_refusals import refuse
from tulip_testbed.base.files import check_new, write_bytes
from tulip_testbed.experiments import truth_record
from tulip_testbed.experiments.run_file import robot_of
from tulip_testbed.experiments.truth_record import write_experiment
from tulip_testbed.sim.shipped import TULIP


def test_the_truth_of_another_is_never_removed(run, tmp_path):
    (tmp_path / "truth.json").write_text("another's")
    refuse("truth.json: exists already", write_experiment, tmp_path / "data", tmp_path / "truth.json", run)
    with pytest.raises(tt.InputError, match=r"truth\.json: exists already; give a new name"):
        write_bytes(tmp_path / "truth.json", b"mine", new=True)
    assert [path.name for path in tmp_path.iterdir()] == ["truth.json"]
    assert (tmp_path / "truth.json").read_text() == "another's"


@pytest.mark.parametrize("written", [False, True])
def test_interrupted_it_leaves_both_or_nothing(written, run, tmp_path, monkeypatch):
    write = truth_record.write_measurements

    def interrupted(folder, measurements):
        if written:
            write(folder, measurements)
        raise KeyboardInterrupt

    monkeypatch.setattr(truth_record, "write_measurements", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_experiment(tmp_path / "data", tmp_path / "truth.json", run)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "truth.json"] * written


def test_a_file_system_without_links_has_new_files_too(tmp_path, monkeypatch):
    def forbid(*names):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", forbid)
    write_bytes(tmp_path / "a", b"first", new=True)
    refuse("exists already", write_bytes, tmp_path / "a", b"second", new=True)
    assert (tmp_path / "a").read_bytes() == b"first"


def test_nothing_is_written_into_a_measurement_folder(run, tmp_path, capsys):
    data = tmp_path / "data"
    tt.write_measurements(data, run.measurements)
    before = sorted(data.iterdir())
    inside = "lies inside the measurement folder"
    for place in (data / "more", data / "deep" / "more"):
        with pytest.raises(tt.InputError, match=inside):
            tt.write_measurements(place, run.measurements)
    with pytest.raises(tt.InputError, match=r"truth\.json: lies inside the measurement folder"):
        write_experiment(tmp_path / "c", data / "truth.json", run)
    link = tmp_path / "link"
    link.symlink_to(data)
    assert inside in refused(capsys, "simulate", "--engine", "statics", "--out", link / "more")
    assert sorted(data.iterdir()) == before
    (tmp_path / "manifest.json").write_text('{"name": "another program\'s"}')
    os.mkfifo(tmp_path / "plan.json")
    check_new(tmp_path / "fine")


WRONG_PATHS = {
    "a\0b": "found a NUL in the path",
    "caf\udce9": "found a path that is not UTF-8",
    "x" * 256: "found a name of 2",
    "ä" * 128 + "/y": "found a name of 2",
}


def calls(run, name):
    """Yield a call of every function of the library that takes a path."""
    yield from (lambda: tt.load_robot(name), lambda: tt.read_measurements(name), lambda: tt.identify(name))
    yield from (lambda: tt.discover(Path(name)), lambda: tt.check(name), lambda: tt.plans.read(name))
    yield lambda: tt.report(name, "/tmp/a.html")
    yield lambda: tt.write_measurements(name, run.measurements)
    yield lambda: tt.plans.write(name, run.plan)
    yield lambda: tt.view(run, save=f"{name}.rrd")
    yield lambda: tt.report(run, f"{name}.html")
    yield lambda: tt.monte_carlo(run.laboratory, run.plan, runs=2, out=name)
    yield lambda: check_new(Path(name))
    yield lambda: write_bytes(Path(name), b"")


@pytest.mark.parametrize("name", WRONG_PATHS)
def test_a_path_that_no_file_can_have_is_one_message(run, tmp_path, monkeypatch, capsys, name):
    """A command is a thin client: one of them."""
    monkeypatch.chdir(tmp_path)
    assert WRONG_PATHS[name] in refused(capsys, "simulate", "--out", name)
    for call in calls(run, name):
        with pytest.raises(tt.InputError, match=WRONG_PATHS[name]):
            call()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_gives_no_stump_of_a_view(run, tmp_path):
    with full_disk(50_000):
        refuse("found no end of the recording in", tt.view, run, save=tmp_path / "view.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_seen_enough_is_no_fault():
    """The pipe's other end is closed before anything is written."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [*COMMAND, "robot", "--json"]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


def test_below_a_folder_that_may_not_be_searched_a_run_has_the_robot_of_the_repository(tmp_path, monkeypatch):
    def shut(path, pattern):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "glob", shut)
    assert robot_of(tmp_path / "run") == TULIP
