"""`tulip plan` as a person meets them: interrupted, gone on with, refused, drawn."""

from __future__ import annotations

import io
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tests.drawing import draws_with
from tests.test_cli import refused
from tulip_testbed import drawings, rendering
from tulip_testbed.base.errors import InputError
from tulip_testbed.cli.main import main
from tulip_testbed.drawings import contact_sheet, support_polygons
from tulip_testbed.experiments import planning_run as planning
from tulip_testbed.experiments.plan_state import state_file
from tulip_testbed.experiments.planning_run import PlanSettings, carry_out, set_up_search
from tulip_testbed.measurements import write_measurements
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SMALL = ("--placements", "5", "--postures-per-placement", "3", "--hops", "1", "--seed", "311")


@pytest.fixture(scope="module")
def data(robot, plan, tmp_path_factory):
    """Fifty postures, measured."""
    place = tmp_path_factory.mktemp("measured") / "data"
    first = plan.take(plan.placement <= 10)
    (run,) = run_statics(solve_plan(preset_rig("wii", robot), first), np.random.SeedSequence(312).spawn(1))
    write_measurements(place, run.measurements)
    return place


def test_interrupted_and_gone_on_with_by_the_same_command(tmp_path, robot, monkeypatch, capsys):
    out = tmp_path / "plan"
    write = planning.write_state

    def interrupt(path, key, state):
        write(path, key, state)
        if state.rounds == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(planning, "write_state", interrupt)
        assert main(["plan", "optimal", "--out", str(out), *SMALL]) == 130
    assert "best plan so far" in " ".join(capsys.readouterr().err.split())
    first = read_plan(out, robot)
    assert first.made["interrupted"]
    assert first.made["rounds"] == 3
    assert "left by another run" in refused(capsys, "plan", "optimal", "--out", out, *SMALL[:-1], 5)
    assert "left by another run" in refused(
        capsys, "plan", "optimal", "--out", out, *SMALL, "--solver", "ipopt"
    )
    assert main(["plan", "optimal", "--out", str(out), *SMALL]) == 0
    assert main(["plan", "optimal", "--out", str(tmp_path / "whole"), *SMALL]) == 0
    again, whole = (read_plan(tmp_path / name, robot) for name in ("plan", "whole"))
    assert again.joint_angles.tobytes() == whole.joint_angles.tobytes()
    assert again.made == whole.made
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plan", "whole"]
    capsys.readouterr()
    assert "exists already" in refused(capsys, "plan", "optimal", "--out", out, *SMALL)


@pytest.fixture(scope="module")
def interrupted(robot, tmp_path_factory):
    """A search and the file that its interruption after one round left."""
    path = state_file(tmp_path_factory.mktemp("interrupted") / "plan")
    job = set_up_search(robot, PlanSettings(311, placements=5, postures_per_placement=3, hops=1)).job()

    def interrupt(state):
        raise KeyboardInterrupt

    carry_out(job, path, interrupt)
    return job, path


@pytest.mark.parametrize(
    ("name", "edit", "message"),
    [
        ("angles", lambda rows: rows[0].pop(), "rows of several lengths"),
        ("design", lambda rows: rows[0].pop(), "key 'state.design.0'"),
        ("design", lambda rows: rows.pop(), r"design: found \(14, 9\), expected \(15, 9\) numbers"),
        (
            "best_design",
            lambda rows: rows[3].__setitem__(6, 0.5),
            "several swing foot poses on one placement",
        ),
        ("best_design", lambda rows: rows[3].__setitem__(2, 1.5), "a plan that breaks a constraint"),
        ("best_angles", lambda rows: rows[3].__setitem__(3, 1e300), r"key 'state.best_angles.3.3'"),
        ("rounds", 10**6, "rounds: found 1000000, expected at most"),
        ("rounds", -1, "key 'state.rounds': found -1"),
        ("value", 1.0, "value: found 1, expected"),
        ("initial", 1e6, "initial: found 1e\\+06, expected"),
        ("initial_condition", None, "key 'state.initial_condition': found None"),
    ],
)
def test_an_edited_state_is_refused_by_name(interrupted, tmp_path, name, edit, message):
    job, intact = interrupted
    document = json.loads(intact.read_text())
    if callable(edit):
        edit(document["state"][name])
    else:
        document["state"][name] = edit
    path = tmp_path / intact.name
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=rf"state\.json: found no state of an interrupted run \(.*{message}"):
        carry_out(job, path, lambda state: None)


def test_killed_when_its_first_plan_was_put_aside_it_leaves_nothing_hidden(tmp_path, plan):
    (tmp_path / ".out.interrupted").mkdir()
    planning.keep_plan(tmp_path / "out", plan)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_of_two_searches_for_one_name_the_slower_leaves_nothing_hidden(tmp_path, plan):
    planning.keep_plan(tmp_path / "out", plan)
    (tmp_path / ".out.state.json").touch()
    with pytest.raises(InputError, match="exists already"):
        planning.keep_plan(tmp_path / "out", plan)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_next_postures_and_their_description(data, tmp_path, capsys):
    out = tmp_path / "next"
    options = ("--after", str(data), "--placements", "1", "--hops", "2", "--seed", "311")
    assert main(["plan", "optimal", "--out", str(out), *options, "--repeats", "1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["postures"] == 6
    assert said["final_objective"] < said["measured_objective"]
    assert main(["plan", "show", str(out), "--after", str(data), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    for key in ("condition_number", "predicted_standard_error_mm", "margins", "correlations"):
        assert again[key] == said[key]
        assert again["made"]["described"][key] == said[key]
    assert "too few for 25 base parameters" in refused(capsys, "plan", "show", out)


def test_polygons_are_drawn_as_svg(robot, plan):
    root = ElementTree.fromstring(support_polygons(robot, plan.take(plan.placement <= 3)))
    assert root.tag.endswith("svg")
    texts = [element.text or "" for element in root.iter() if element.tag.endswith("text")]
    assert sum(text.startswith("placement ") for text in texts) == 3
    assert {str(number) for number in range(1, 16)} <= set(texts)


@draws_with("opengl")
def test_postures_are_rendered(robot, plan):
    sheet = contact_sheet(robot, plan.take(np.array([0, 1, 7])))
    image = np.asarray(Image.open(io.BytesIO(sheet)))
    assert image.shape == (224, 3 * 168, 3)
    for k in range(3):  # the robot is orange
        red, _, blue = image[:, k * 168 : (k + 1) * 168].astype(int).transpose(2, 0, 1)
        assert ((red > 150) & (blue < 80)).sum() > 100


def test_without_opengl_the_polygons_are_left(plan, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rendering, "PLATFORMS", ())
    assert main(["plan", "show", "--draw", str(tmp_path / "pictures")]) == 2
    assert "no postures.png: rendering: neither EGL nor OSMesa draws" in " ".join(
        capsys.readouterr().err.split()
    )
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["support-polygons.svg"]


def test_pictures_that_cannot_be_written_are_not_published_in_part(robot, plan, tmp_path, monkeypatch):
    def full(path, content):
        raise InputError(f"{path}: cannot write (No space left on device)")

    monkeypatch.setattr(drawings, "contact_sheet", lambda robot, plan: b"picture")
    monkeypatch.setattr(drawings, "write_bytes", full)
    with pytest.raises(InputError, match="No space left"):
        drawings.write_pictures(tmp_path / "pictures", robot, plan)
    assert not any(tmp_path.iterdir())
