"""`tulip watch` on folders that grow: bad input, the state, and the command itself."""

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import tulip_testbed as tt
from tests.test_cli import TULIP
from tests.test_refusals import change_document, check_words, refuse, rows
from tests.test_watch import measured_day
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.watching.alarm import OK
from tulip_testbed.experiments.watching.arriving_rows import MOST_AT_ONCE, ArrivingRows
from tulip_testbed.experiments.watching.watch_day import read_targets
from tulip_testbed.measurements import Measurements, write_measurements

ROWS = 12


@pytest.fixture(scope="module")
def day(robot, plan) -> Measurements:
    """The first rows of a day, every posture once."""
    whole = measured_day(robot, plan)
    first = np.sort(np.unique(whole.posture, return_index=True)[1])
    return whole.take(first[:ROWS])


@pytest.fixture
def folder(tmp_path, day) -> tuple[Path, list[str]]:
    """Return a measurement folder whose table has its header alone, and the lines of its rows."""
    folder = tmp_path / "lab"
    write_measurements(folder, day)
    (folder / "postures.parquet").unlink()
    change_document(folder / "manifest.json", "tables -")
    header, *lines = (folder / "postures.csv").read_text().splitlines(keepends=True)
    (folder / "postures.csv").write_text(header)
    return folder, lines


def grow(folder: Path, text: str) -> None:
    with (folder / "postures.csv").open("a") as file:
        file.write(text)


def judged(folder: Path, plan, robot, **more) -> list:
    return list(tt.watch(folder, robot, plan=plan, once=True, **more))


def test_half_a_line_waits_for_its_end(folder, plan, robot, tmp_path):
    path, lines = folder
    grow(path, lines[0] + lines[1][:50])
    assert [one.verdict.posture for one in judged(path, plan, robot)] == [1]
    grow(path, lines[1][50:] + lines[2].rstrip("\n"))
    state = tmp_path / "state"
    assert [one.verdict.verdict for one in judged(path, plan, robot, out=state)] == [OK] * 3  # no end of line
    grow(path, "\n" + lines[3])
    assert [one.line for one in judged(path, plan, robot, out=state)] == [5]


def test_prepared_rows_wait_for_their_readings(folder, plan, robot, tmp_path):
    path, lines = folder
    header = (path / "postures.csv").read_text()
    empty = [",".join([*line.split(",")[:3], *[""] * (line.count(",") - 2)]) + "\n" for line in lines]
    state = tmp_path / "state"
    for count in (0, 2, 3):
        (path / "postures.csv").write_text(header + "".join(lines[:count] + empty[count:]))
        found = judged(path, plan, robot, out=state)
        assert [one.line for one in found] == {0: [], 2: [2, 3], 3: [4]}[count]
        assert all(one.verdict for one in found)


def test_it_goes_on_where_it_was_and_writes_nothing_into_the_folder(folder, plan, robot, day, tmp_path):
    path, lines = folder
    state = tmp_path / "out" / "state"
    grow(path, "".join(lines[:5]))
    before = {one.name: one.read_bytes() for one in path.iterdir()}
    first = judged(path, plan, robot, out=state)
    assert {one.name: one.read_bytes() for one in path.iterdir()} == before
    grow(path, "".join(lines[5:]))
    then = judged(path, plan, robot, out=state)
    assert [one.verdict.posture for one in first + then] == day.posture.tolist()
    whole = judged(path, plan, robot)
    assert [one.verdict.to_json() for one in first + then] == [one.verdict.to_json() for one in whole]
    assert [one.name for one in state.parent.iterdir()] == ["state"]


def test_a_state_belongs_to_a_plan_and_a_manifest(folder, plan, robot, tmp_path):
    path, lines = folder
    grow(path, "".join(lines[:2]))
    judged(path, plan, robot, out=tmp_path / "state")
    other = plan.take(plan.placement <= 9)
    refuse("state of another plan", judged, path, other, robot, out=tmp_path / "state")
    (tmp_path / "state").write_bytes(b"PK\x03\x04 broken")
    refuse("no state of a watch", judged, path, plan, robot, out=tmp_path / "state")


@rows("watched lines")
def test_a_line_that_cannot_be_read_is_told_and_passed_over(folder, plan, robot, changes, words):
    path, lines = folder
    broken = lines[1].split(",")
    broken[(path / "postures.csv").read_text().split(",").index('"q.right_knee"')] = "broken"
    grow(path, lines[0] + eval(changes[0], {"lines": lines, "broken": ",".join(broken)}) + lines[2])
    first, second, third = judged(path, plan, robot)
    assert (first.verdict.verdict, second.verdict, third.verdict.verdict) == (OK, None, OK)
    check_words(words, f"{second.problem}; then line {third.line}")


def test_a_watch_that_read_no_row_fails(folder, plan, robot):
    path, _ = folder
    grow(path, "1,2\n3,4\n")
    watch = tt.watch(path, robot, plan=plan, once=True)
    assert watch.exit_code == 0  # before the first row
    assert [one.verdict for one in watch] == [None, None]
    assert watch.exit_code == 1


def exchanged(text: str) -> str:
    """The header with the knees exchanged: read by the old one, so would be their angles."""
    header = text.partition("\n")[0] + "\n"
    return header.replace("right_knee", "?").replace("left_knee", "right_knee").replace("?", "left_knee")


@rows("watched")
def test_a_table_that_was_read_may_only_grow(folder, plan, robot, tmp_path, changes, words):
    path, lines = folder
    table, state = path / "postures.csv", tmp_path / "state"
    grow(path, "".join(lines[:3]))
    judged(path, plan, robot, out=state)
    names = {"text": table.read_text(), "lines": lines, "exchanged": exchanged}
    table.write_text(eval(changes[0], names))
    refuse(words, judged, path, plan, robot, out=state)


def test_what_was_read_at_the_end_of_the_file_or_before_it_may_not_change(folder, plan, robot, tmp_path):
    path, lines = folder
    grow(path, "".join(lines[:3]).rstrip("\n"))
    assert len(judged(path, plan, robot, out=tmp_path / "state")) == 3
    grow(path, "5\n")  # the last value had not come to its end
    with pytest.raises(tt.InputError, match="found other values in the first 4 lines than were read before"):
        judged(path, plan, robot, out=tmp_path / "state")
    days = tt.watch(path, robot, plan=plan, once=True)
    next(days)
    manifest = (path / "manifest.json").read_text()
    (path / "manifest.json").write_text(manifest.replace("9.81", "9.80"))
    grow(path, lines[3])
    refuse("manifest.json: found another manifest than before the first row", list, days)


def test_targets_are_in_millimetres():
    assert read_targets(["all=2", "torso.x=0.5"]) == {"all": 2e-3, "torso.x": 5e-4}


def test_the_lines_that_a_program_and_a_person_see(folder, day, capsys):
    path, lines = folder
    watch = ["watch", str(path), "--plan", "random", "--once"]
    assert main([*watch, "--json"]) == 0
    assert capsys.readouterr() == ("", "No row has arrived.\n")
    grow(path, "".join(lines[:3]))
    assert main([*watch, "--json"]) == 0
    out, err = capsys.readouterr()
    told = [json.loads(line) for line in out.splitlines()]
    assert (err, [one["posture"] for one in told]) == ("", day.posture[:3].tolist())
    assert len(told[0].pop("standard_errors")) == 25
    assert told[0] == {"posture": 1, "verdict": OK, "findings": [], "next": 2, "stop": None}
    assert main([*watch, "--targets", "all=3"]) == 0
    out = capsys.readouterr().out
    assert "posture 3: ok; next 4" in out
    assert "Next: posture 4; 147 left." in out
    assert "torso.x" in out


@pytest.mark.slow
def test_killed_and_started_again_it_goes_on(folder, day, tmp_path):
    """The real command on a real file that grows, killed with no warning in the middle."""
    path, lines = folder
    command = [*TULIP, "watch", str(path), "--plan", "random", "--json"]
    told, state = [], tmp_path / "state"
    for part in (lines[:5], lines[5:]):
        grow(path, "".join(part))
        watch = subprocess.Popen([*command, "--out", str(state)], stdout=subprocess.PIPE, text=True)
        assert watch.stdout is not None
        wanted = int(part[-1].partition(",")[0])
        while told[-1:] != [wanted]:
            told.append(json.loads(watch.stdout.readline())["posture"])
        os.kill(watch.pid, signal.SIGKILL)
        watch.wait()
        watch.stdout.close()
    # The row before the kill may be judged again, since its state was not written yet; none is left out.
    assert list(dict.fromkeys(told)) == day.posture.tolist()
    assert len(told) <= ROWS + 1


@pytest.mark.parametrize("content", [b"x" * (MOST_AT_ONCE + 1), b"posture,time\r1,2\r"])
def test_a_line_without_end_is_refused(tmp_path, content):
    path = tmp_path / "postures.csv"
    path.write_bytes(content)
    rows = ArrivingRows(path=path, manifest=cast(Any, None), where=path)
    refuse("found a line of more than ... or with a carriage return (CR)", list, rows.new())


def test_a_second_watch_of_one_state_is_refused(folder, plan, robot, tmp_path):
    path, lines = folder
    grow(path, "".join(lines[:2]))
    state = tmp_path / "state"
    first = tt.watch(path, robot, plan=plan, out=state, once=True)
    assert next(first).line == 2
    refuse("state: another process is at work in it", judged, path, plan, robot, out=state)
    assert len(list(first)) == 1
    assert judged(path, plan, robot, out=state) == []
    assert sorted(one.name for one in tmp_path.iterdir()) == ["lab", "state"]
