"""Views: written, opened in rerun itself, looked at."""

import itertools
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import rerun.blueprint as rrb
from PIL import Image

import tulip_testbed as tt
from tests.drawing import draws_with
from tests.durations import cpu_seconds
from tests.first_look import cases
from tests.looking import free_port, headless_viewer
from tests.test_refusals import check_words, refuse, rows
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.measurements import write_measurements
from tulip_testbed.viewer import balance_series as balance
from tulip_testbed.viewer import postures_view as postures
from tulip_testbed.viewer import robot_view, window
from tulip_testbed.viewer.balance_series import inset
from tulip_testbed.viewer.robot_view import undrawn
from tulip_testbed.viewer.subject import measured, planned, validated

MOST_SECONDS, MOST_BYTES = 20, 60e6  # of a view of 150 postures


def side_by_side(views: dict[str, list[rrb.View]], timeline: str) -> rrb.Blueprint:
    """All views at once: rerun reports nothing of a view that it does not draw."""
    grid = rrb.Grid(*itertools.chain.from_iterable(views.values()))
    return rrb.Blueprint(grid, rrb.TimePanel(timeline="posture", state="collapsed"))


def look(recording: Path, steps: dict[str, int], picture: Path) -> dict[str, list]:
    """What every view reports at some steps of the time lines; the last is in the picture."""
    found: dict[str, list] = {}
    with headless_viewer(recording, (1200, 800)) as viewer:
        for line, step in steps.items():
            viewer.set_time(line, sequence=step, play_state="paused")
            time.sleep(1.5)
            for view in viewer.get_state().views:
                found.setdefault(view.name, []).extend(view.reports)
        viewer.save_screenshot(str(picture))
    return found


def not_blank(picture: Path) -> None:
    """Each ninth of the picture holds several colours."""
    pixels = np.asarray(Image.open(picture).convert("RGB")) @ np.array([65536, 256, 1])
    for band in np.array_split(pixels, 3, axis=0):
        for part in np.array_split(band, 3, axis=1):
            assert len(np.unique(part)) > 3


@draws_with("vulkan")
def test_rerun_draws_every_view_of_a_run(run_folder, robot, tmp_path, monkeypatch):
    subject = validated(tt.Validation.load(run_folder, robot))
    monkeypatch.setattr(postures, "laid_out", side_by_side)
    window.save(tmp_path / "run.rrd", "run", lambda recording: postures.log_postures(recording, subject))
    found = look(tmp_path / "run.rrd", {"posture": 40}, tmp_path / "run.png")
    assert {"Robot on its plates", "Masses of the links", "Posture", "Cells, N", "Residual, mm"} <= set(found)
    assert len(found) == 13
    assert not any(found.values()), found
    not_blank(tmp_path / "run.png")


def test_a_view_of_150_postures_is_small_and_soon_there(wii, tmp_path, capsys):
    run = tmp_path / "run"
    wii.save(run)
    for name, folder in {"run": run, "data": run / "measurements", "plan": DEFAULT_PLAN}.items():
        began = cpu_seconds()
        assert main(["view", str(folder), "--save", str(tmp_path / f"{name}.rrd")]) == 0
        assert cpu_seconds() - began < MOST_SECONDS
        assert 1e5 < (tmp_path / f"{name}.rrd").stat().st_size < MOST_BYTES
        assert "View: " in capsys.readouterr().out
    for k, shown in enumerate((wii.plan, wii.measurements.take(np.arange(20)))):
        assert tt.view(shown, save=tmp_path / f"{k}.rrd").view == str(tmp_path / f"{k}.rrd")


def test_a_monte_carlo_has_a_page_and_no_view(coverage, tmp_path):
    refuse("found a Monte Carlo, which `report` shows", tt.view, coverage, save=tmp_path / "m.rrd")


def test_residual_and_truth_are_the_runs_own(run_folder, moved_wii, robot):
    subject = validated(tt.Validation.load(run_folder, robot))
    residual = moved_wii.identification.full.residual.reshape(-1, 2)
    assert subject.residual == pytest.approx(residual, abs=1e-9)
    assert subject.com["truth"] == pytest.approx(np.array([held.com for held in moved_wii.simulation.held]))
    # The noise is of millimetres: truth, estimate and CoP lie together.
    assert np.abs(subject.com["truth"] - subject.cop).max() < 0.03
    factor = balance.magnification(subject)
    assert 0.02 < factor * np.median(np.linalg.norm(residual, axis=1)) < 0.2


def test_postures_that_say_nothing_are_shown_without_an_estimate(wii, robot, tmp_path):
    part = wii.measurements.take(np.arange(1))
    write_measurements(tmp_path / "data", part)
    subject = measured(part, robot)
    assert "estimate" not in subject.com
    assert "No estimate: " in subject.notes[0]
    assert main(["view", str(tmp_path / "data"), "--save", str(tmp_path / "few.rrd")]) == 0


@cases("how", [signal.SIGHUP], [signal.SIGTERM, signal.SIGKILL])
def test_the_viewer_listens_to_this_machine_alone_and_ends_with_its_terminal(run_folder, tmp_path, how):
    """Without a screen: the viewer's own server in the place of its window."""
    assert main(["view", str(run_folder), "--save", str(tmp_path / "v.rrd")]) == 0
    ports = [free_port(), free_port()]
    command = [sys.executable, "-c", WITHOUT_WINDOW, str(tmp_path), *map(str, ports)]
    with subprocess.Popen(command) as process:
        listening = {}
        until = time.monotonic() + 20
        while len(listening) < 2 and time.monotonic() < until:
            time.sleep(0.3)
            listening = {port: address for port, address in _listening() if port in ports}
        process.send_signal(how)
    assert listening == dict.fromkeys(ports, "0100007F")
    until = time.monotonic() + 20
    while any(port in ports for port, _ in _listening()):
        assert time.monotonic() < until
        time.sleep(0.1)


WITHOUT_WINDOW = """
import sys, time
from pathlib import Path
from tulip_testbed.viewer import window
place, data, page = Path(sys.argv[1]), *sys.argv[2:]
options = (*window.LOCAL[:2], "--serve-web", "--port", data, "--web-viewer-port", page)
with window._viewer(place, place / "v.rrd", options):
    time.sleep(60)
"""


def _listening() -> list[tuple[int, str]]:
    """Port and address (hexadecimal) of every listening socket of this machine."""
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A":
                address, port = local.split(":")
                found.append((int(port, 16), address))
    return found


@rows("viewer")
def test_what_the_viewer_says_is_told_with_the_package_to_install(changes, words):
    check_words(words, window._fault(changes[0]))


def test_links_that_nothing_shows_are_told():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="shown"><geom size="0.1"/>
        <body name="bare"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
        </worldbody></mujoco>"""
    )
    assert undrawn(model) == ["bare"]


def test_a_box_of_its_inertia_stands_for_a_bare_link():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="brick"><geom type="box" size="0.1 0.2 0.3" pos="1 0 0"/></body>
        </worldbody></mujoco>"""
    )
    box: Any = robot_view.inertia_box(model, 1)
    assert sorted(box.half_sizes.as_arrow_array().to_pylist()[0]) == pytest.approx([0.1, 0.2, 0.3])
    assert box.centers.as_arrow_array().to_pylist() == [[1, 0, 0]]


def test_a_robot_with_sensors_in_its_feet_stands_on_no_boards(robot, plan):
    few = plan.take(plan.placement == 1)
    log = tt.Laboratory(robot, "foot-ideal").run(few, 3, "statics").measurements
    assert measured(log, robot).sensors_in_feet
    assert not planned(few, robot).sensors_in_feet


def test_a_polygon_may_have_no_inside(plan, robot):
    polygon = planned(plan, robot).polygons[0]
    assert inset(polygon, 0.02) is not None
    assert inset(polygon, 0.2) is None
