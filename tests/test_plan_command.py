"""`tulip plan` as a person meets them: interrupted, gone on with, refused, drawn."""

import io
import re
import shutil
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import tulip_testbed as tt
from tests.drawing import draws_with
from tests.effect_changes import measured
from tests.published_robot import write_published
from tests.test_cli import refused, told
from tests.test_refusals import change_document, refuse, rows
from tulip_testbed import rendering
from tulip_testbed.base.resumable import alone_on
from tulip_testbed.cli.main import main
from tulip_testbed.experiments import planning_run as planning
from tulip_testbed.experiments.planning_run import PlanSettings, set_up_search, state_folder
from tulip_testbed.rendering import ABOVE, EDGE, SIDE, least_distance
from tulip_testbed.sim.plan_folder import read_plan

SMALL = ("--placements", "5", "--postures-per-placement", "3", "--hops", "1", "--seed", "311")


@pytest.mark.slow
def test_interrupted_and_gone_on_with_by_the_same_command(tmp_path, robot, monkeypatch, capsys):
    out = tmp_path / "plan"
    write = planning.SearchState.write

    def interrupt(state, path):
        write(state, path)
        if state.rounds == 3:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(planning.SearchState, "write", interrupt)
        assert main(["plan", "optimal", "--out", str(out), *SMALL]) == 130
    assert "best plan so far" in " ".join(capsys.readouterr().err.split())
    first = read_plan(out, robot)
    assert first.made["interrupted"]
    assert first.made["rounds"] == 3
    other = "holds states of another configuration: settings"
    assert f"{other}.seed is 311 there" in refused(capsys, "plan", "optimal", "--out", out, *SMALL[:-1], 5)
    with alone_on(state_folder(out)):
        assert "another process is at work" in refused(capsys, "plan", "optimal", "--out", out, *SMALL)
    assert main(["plan", "optimal", "--out", str(out), *SMALL]) == 0
    assert main(["plan", "optimal", "--out", str(tmp_path / "whole"), *SMALL]) == 0
    again, whole = (read_plan(tmp_path / name, robot) for name in ("plan", "whole"))
    assert again.joint_angles.tobytes() == whole.joint_angles.tobytes()
    assert again.made == whole.made
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plan", "whole"]
    capsys.readouterr()
    assert "exists already" in refused(capsys, "plan", "optimal", "--out", out, *SMALL)


SETTINGS = PlanSettings(311, placements=5, postures_per_placement=3, hops=1)


class Stopped(Exception):  # noqa: N818
    """In the place of a kill."""


@pytest.fixture(scope="module")
def interrupted(robot, tmp_path_factory):
    """A search and the states that its end after one round left."""
    out, search = tmp_path_factory.mktemp("interrupted") / "plan", set_up_search(robot, SETTINGS)

    @contextmanager
    def stopping(what, total, done):
        def stop(count, value=None):
            raise Stopped

        yield stop

    with pytest.raises(Stopped):
        planning.search_plan(search, SETTINGS, out, "wii", progress=stopping)
    assert [path.name for path in out.parent.iterdir()] == [".plan.search"]
    return search, state_folder(out)


@rows("state")
def test_an_edited_state_is_refused_by_name(interrupted, tmp_path, changes, words):
    search, states = interrupted
    shutil.copytree(states, state_folder(tmp_path / "plan"))
    change_document(state_folder(tmp_path / "plan") / "seed-311.json", changes[0])
    refused_state = f"seed-311.json: ... {words} ... ; remove it"
    refuse(refused_state, planning.search_plan, search, SETTINGS, tmp_path / "plan", "wii")


def test_the_next_postures_and_their_description(robot, plan, tmp_path, capsys):
    """After fifty that were measured."""
    data, out, first = tmp_path / "data", tmp_path / "next", plan.take(plan.placement <= 10)
    tt.write_measurements(data, measured(robot, first, "wii", seed=312))
    options = ("--after", str(data), "--placements", "1", "--hops", "1", "--seed", "311")
    said = told(capsys, "plan", "optimal", "--out", out, *options, "--repeats", "1")
    assert said["postures"] == 6
    assert said["final_objective"] < said["measured_objective"]
    again = told(capsys, "plan", "show", out, "--after", data)
    for key in ("condition_number", "predicted_standard_error_mm", "margins", "correlations"):
        assert again[key] == said[key]
        assert again["made"]["described"][key] == said[key]
    assert "too few for 25 base parameters" in refused(capsys, "plan", "show", out)


@draws_with("opengl")
def test_the_standing_robot_is_rendered(robot):
    image = np.asarray(Image.open(io.BytesIO(rendering.standing_picture(robot)))).astype(int)
    assert image.shape == (640, 480, 3)
    assert ((image[..., 0] > 150) & (image[..., 2] < 80)).sum() > 1_000  # the robot is orange


@draws_with("opengl")
def test_a_robot_whose_file_has_no_geometry_is_rendered_by_its_inertia(tmp_path):
    path = write_published(tmp_path / "bare")
    shape = r"<(visual|collision)>.*?</(visual|collision)>"
    path.write_text(re.sub(shape, "", path.read_text()))
    sole = (0.15, 0.07, 0.08, 0.06)
    feet = ("right_ankle_roll_link", "left_ankle_roll_link")
    tt.describe_robot(path, feet=feet, sole=sole, out=tmp_path / "robot")
    image = np.asarray(Image.open(tmp_path / "robot" / "robot.png")).astype(int)
    grey = (image.max(axis=2) < 190) & (np.ptp(image, axis=2) < 40)
    assert grey.sum() > 20_000


@pytest.mark.parametrize("ratio", [0.75, 1.6])
def test_every_point_is_in_the_picture(ratio):
    """By angles seen from the camera, not by the formula of the distance."""
    points, target = np.random.default_rng(3).uniform(-0.9, 0.9, (40, 3)), np.array([0.0, 0.1, 0.6])
    camera = Rotation.from_euler("ZY", [SIDE, -ABOVE], degrees=True)
    seen = camera.apply(points - target, inverse=True)
    seen[:, 0] += least_distance(points, target, 45.0, ratio)
    half = np.tan(np.radians(22.5))
    across, above = np.abs(seen[:, 1:] / seen[:, :1]).max(axis=0)
    assert max(across / (ratio * half), above / half) == pytest.approx(1 / EDGE, abs=0.1)
    assert max(across / (ratio * half), above / half) < 1
