"""Files: reading what may be anything, writing whole or not at all, and where results may go."""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

import tulip_testbed as tt
from tests.test_cli import TULIP as COMMAND
from tests.test_cli import in_a_process
from tests.test_refusals import refuse, rows
from tulip_testbed.base.files import (
    check_new,
    is_folder,
    new_folder,
    present,
    read_text,
    scratch_folder,
    write_bytes,
    write_text,
)
from tulip_testbed.base.resumable import alone_on
from tulip_testbed.experiments import simulate
from tulip_testbed.experiments.run_file import robot_of
from tulip_testbed.experiments.simulate import write_experiment
from tulip_testbed.sim.shipped import TULIP

# Forks once per file operation; the child kills itself right before its n-th one.
KILLED_AT_EVERY_STEP = """
import json, os, pathlib, signal, sys
from tulip_testbed.base.files import new_folder, write_text

def fill():
    with new_folder("folder") as working:
        (working / "inner").mkdir()
        (working / "inner" / "a.txt").write_text("whole")
        (working / "b.txt").write_text("whole")
    write_text(pathlib.Path("file.txt"), "new")

def watch(fatal):
    count = 0
    def hook(event, arguments):
        nonlocal count
        if event == "open" or event.startswith(("os.", "shutil.", "fcntl.")):
            count += 1
            if count == fatal:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(hook)

states, step, status = [], 0, 1
while status:
    step += 1
    os.mkdir(f"step{step}")
    os.chdir(f"step{step}")
    pathlib.Path("file.txt").write_text("old")
    child = os.fork()
    if not child:
        watch(step)
        fill()
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    folder = pathlib.Path("folder")
    whole = sorted(str(p) for p in folder.rglob("*") if p.is_file() and p.read_text() == "whole")
    left = [p.name for p in pathlib.Path(".").iterdir() if p.name.startswith(".")]
    states.append([folder.exists(), whole, pathlib.Path("file.txt").read_text(), len(left)])
    if folder.exists():
        os.rename("folder", "moved")
    fill()
    states[-1].append([p.name for p in pathlib.Path(".").iterdir() if p.name.startswith(".")])
    os.chdir("..")
print(json.dumps(states))
"""


def test_a_kill_at_any_file_operation_leaves_the_old_or_the_new(tmp_path):
    done = in_a_process(KILLED_AT_EVERY_STEP, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    states = json.loads(done.stdout)
    assert len(states) > 30
    for there, whole, file, _, swept in states:
        assert whole == (["folder/b.txt", "folder/inner/a.txt"] if there else [])
        assert file in ("old", "new")
        assert swept == []  # the next writer to the same names cleans up
    assert not states[0][0]
    assert states[-1][:4] == [True, ["folder/b.txt", "folder/inner/a.txt"], "new", 0]
    assert sum(left > 0 for *_, left, _ in states) > 10  # most kills do leave something
    assert all(left == 0 for _, _, file, left, _ in states if file == "new")  # nobody would write it again
    assert {(there, file) for there, _, file, *_ in states} == {(False, "old"), (True, "old"), (True, "new")}


def enter(context):
    with context:
        pass


def write_while_another_does(path):
    with new_folder(path) as mine:
        (mine / "a").touch()
        with new_folder(path) as other:
            (other / "b").touch()
        assert mine.exists()  # in use, so nobody took it for a left-over


def test_of_two_writers_to_one_name_the_first_wins(tmp_path):
    refuse("data: exists already", write_while_another_does, tmp_path / "data")
    assert os.listdir(tmp_path) == ["data"]
    assert os.listdir(tmp_path / "data") == ["b"]


def test_a_scratch_folder_is_one_s_own_and_takes_a_killed_one_away(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / ".view.12345678.partial").mkdir()
    with scratch_folder("view") as mine, scratch_folder("view") as other:
        (mine / "a").touch()
        assert mine.stat().st_mode & 0o777 == 0o700
        assert {path.name for path in tmp_path.iterdir()} == {mine.name, other.name}
    assert os.listdir(tmp_path) == []


@contextmanager
def full_disk(most: int) -> Iterator[None]:
    """No file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def write_too_much(folder):
    with new_folder(folder) as working:
        (working / "a").write_bytes(b"x" * 2_000)


def test_a_full_disk_is_one_message_and_leaves_nothing(tmp_path):
    with full_disk(1_000):
        refuse("data: cannot write (File too large)", write_too_much, tmp_path / "data")
        refuse("a.txt: cannot write (File too large)", write_text, tmp_path / "a.txt", "x" * 2_000)
    assert os.listdir(tmp_path) == []


def test_an_exception_or_a_taken_name_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "data"):
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == []
    (tmp_path / "data").symlink_to("nowhere")
    refuse("data: exists already", enter, new_folder(tmp_path / "data"))
    refuse("found a name of 256 bytes, expected at most 255", enter, new_folder(tmp_path / ("x" * 256)))
    assert os.listdir(tmp_path) == ["data"]


@rows("files")
def test_only_regular_files_of_text_are_read(tmp_path, changes, words):
    eval(changes[0], {"path": tmp_path / "name", "os": os})
    refuse(f"name: {words}", read_text, tmp_path / "name", 10)


WORKING = """
import pathlib, time
from tulip_testbed.base.resumable import alone_on

with alone_on(pathlib.Path("run")):
    print("at work", flush=True)
    time.sleep(60)
"""


def test_another_process_at_work_is_refused_until_it_is_killed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    with subprocess.Popen([sys.executable, "-c", WORKING], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "at work\n"
        with pytest.raises(tt.InputError, match=r"^run: another process is at work in it$"):
            enter(alone_on(Path("run")))
        other.kill()
    assert (tmp_path / ".run.lock").exists()
    enter(alone_on(Path("run")))
    assert os.listdir(tmp_path) == ["run"]


def test_names_that_no_file_can_have(tmp_path):
    assert not present(tmp_path / "a\0b")
    for call in (present, is_folder):
        refuse("File name too long", call, tmp_path / ("x" * 300))
    for call in (check_new, partial(write_bytes, content=b"")):
        refuse("found a NUL in the path", call, tmp_path / "a\0b")


def test_a_file_system_that_takes_no_files_is_refused():
    """Linux says of every new file in /proc that it does not exist, as if another process had removed it."""
    refuse("/proc/x: cannot write", write_text, Path("/proc/x"), "x")
    refuse("/proc/none/run: cannot write", enter, alone_on(Path("/proc/none/run")))  # nor a lock


def test_the_truth_of_another_is_never_removed(run, tmp_path):
    (tmp_path / "truth.json").write_text("another's")
    refuse("truth.json: exists already", write_experiment, tmp_path / "data", tmp_path / "truth.json", run)
    with pytest.raises(tt.InputError, match=r"truth\.json: exists already; give a new name"):
        write_bytes(tmp_path / "truth.json", b"mine", new=True)
    assert [path.name for path in tmp_path.iterdir()] == ["truth.json"]
    assert (tmp_path / "truth.json").read_text() == "another's"


@pytest.mark.parametrize("written", [False, True])
def test_interrupted_it_leaves_both_or_nothing(written, run, tmp_path, monkeypatch):
    write = simulate.write_measurements

    def interrupted(folder, measurements):
        if written:
            write(folder, measurements)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "write_measurements", interrupted)
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


def test_a_folder_with_files_of_another_program_is_no_measurement_folder(tmp_path):
    (tmp_path / "manifest.json").write_text('{"name": "another program\'s"}')
    os.mkfifo(tmp_path / "plan.json")
    check_new(tmp_path / "fine")


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
