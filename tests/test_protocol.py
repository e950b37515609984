"""The folder of a protocol: trajectories, start of the measurements, pages that measure right on paper."""

import csv
import io
import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import yaml

import tulip_testbed as tt
from tests.contact_folders import assert_same
from tests.drawing import draws_with
from tests.looking import browse
from tests.test_cli import told
from tests.test_refusals import change_document
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.example import empty_measurements
from tulip_testbed.identification.planning.optimal_plan import with_repeats
from tulip_testbed.measurements import read_measurements, write_measurements
from tulip_testbed.measurements.measurement_folder import write_start
from tulip_testbed.pages.placement_drawing import placement_of, scale_for
from tulip_testbed.pages.protocol_page import rows_to_fill_in, write_protocol
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.sensors import PRESETS


@pytest.fixture(scope="module")
def folder(small_protocol, tmp_path_factory):
    """A protocol's folder, and the protocol."""
    path = tmp_path_factory.mktemp("protocol") / "day"
    assert write_protocol(path, small_protocol) == []
    return path, small_protocol


def test_trajectories_are_messages_of_ros(folder):
    path, small_protocol = folder
    files = sorted((path / "trajectories").glob("*.yaml"))
    assert len(files) == sum(motion is not None for motion in small_protocol.motions)
    for file in files[::4]:
        message = yaml.load(file.read_text(), yaml.CSafeLoader)
        assert list(message) == ["header", "joint_names", "points"]
        assert message["joint_names"] == list(small_protocol.plan.joints)
        stamps = [p["time_from_start"] for p in message["points"]]
        times = np.array([s["sec"] + 1e-9 * s["nanosec"] for s in stamps])
        rows = list(csv.reader(io.StringIO(file.with_suffix(".csv").read_text())))
        table = {name: np.array([float(r[k]) for r in rows[1:]]) for k, name in enumerate(rows[0])}
        assert times[0] == 0
        assert times[-1] == pytest.approx(table["time"][-1], abs=1e-5)
        for key, prefix in (
            ("positions", "q"),
            ("velocities", "qd"),
            ("accelerations", "qdd"),
            ("effort", "torque"),
        ):
            values = np.array([p[key] for p in message["points"]])
            for k, joint in enumerate(small_protocol.plan.joints):
                found = np.interp(times, table["time"], table[f"{prefix}.{joint}"])
                np.testing.assert_allclose(values[:, k], found, atol=2e-5)


@pytest.mark.parametrize("way", ["appended", "filled in"])
def test_the_started_folder_takes_rows(folder, robot, tmp_path, way):
    """Rows of a simulated run, appended by a logger or filled in by hand, are identified as the run's own."""
    path, small_protocol = folder
    kept = read_plan(path / "plan", robot)
    np.testing.assert_array_equal(kept.posture, small_protocol.plan.posture)
    run = tt.Laboratory(robot, "wii").run(kept, seed=411, engine="statics")
    write_measurements(tmp_path / "simulated", run.measurements)
    simulated = table_of(tmp_path / "simulated" / "postures.csv")
    shutil.copytree(path / "measurements", tmp_path / "data")
    table = tmp_path / "data" / "postures.csv"
    if way == "appended":
        names = table.read_text().strip().split(",")
        with table.open("a") as file:
            writer = csv.DictWriter(file, names, extrasaction="ignore")
            writer.writerows(simulated)
    else:
        rows = table_of(path / "rows.csv")
        assert [row["posture"] for row in rows] == [row["posture"] for row in simulated]  # none was lost
        with table.open("w") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            for row, measured in zip(rows, simulated, strict=True):
                writer.writerow({key: value or measured[key] for key, value in row.items()})
    manifest = tmp_path / "data" / "manifest.json"
    assert run.measurements.weighed_mass is not None
    mass, sd = run.measurements.weighed_mass
    assert json.loads(manifest.read_text())["weighed_mass"] is None
    change_document(manifest, f'weighed_mass = {{"value": {mass}, "sd": {sd}}}')
    expected = tt.identify(replace(run.measurements, command=None, motor=None), robot)
    found = tt.identify(tmp_path / "data", robot)
    np.testing.assert_allclose(found.full.value, expected.full.value, rtol=1e-9)
    np.testing.assert_allclose(found.full.covariance, expected.full.covariance, rtol=1e-9)


def table_of(path):
    return list(csv.DictReader(io.StringIO(path.read_text())))


def test_without_a_data_sheet_the_manifest_says_so(robot, small_plan, small_protocol, tmp_path, monkeypatch):
    without = replace(small_protocol, sensors=None)
    monkeypatch.setattr("tulip_testbed.api.planned.protocol_of", lambda *arguments: without)
    monkeypatch.setattr("tulip_testbed.pages.pictures.rendered", _no_pictures)
    tt.protocol(small_plan, robot, out=tmp_path / "day", repeats=0)
    manifest = json.loads((tmp_path / "day" / "measurements" / "manifest.json").read_text())
    assert set(manifest["sensors"].values()) == {None}
    page = (tmp_path / "day" / "protocol.html").read_text()
    assert "sensors.cell_sd" in page
    assert "Pictures of postures: nothing draws here" in page


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_laboratory_s_folder_can_be_started(robot, small_plan, tmp_path, preset):
    """The manifest is that of a simulated laboratory, without the mass, and so are the columns."""
    empty = empty_measurements(robot, preset)
    write_start(tmp_path / "data", empty)
    started = json.loads((tmp_path / "data" / "manifest.json").read_text())
    run = tt.Laboratory(robot, preset).run(small_plan, seed=412, engine="statics")
    write_measurements(tmp_path / "simulated", run.measurements)
    assert_same(read_measurements(tmp_path / "simulated"), run.measurements)
    simulated = json.loads((tmp_path / "simulated" / "manifest.json").read_text())
    for key in ("weighed_mass", "created", "software", "tables"):
        simulated.pop(key)
    assert started.pop("weighed_mass") is None
    if preset == "plate-cop":  # follows from the measurements' loads
        assert all(contact.pop("covariance", None) is None for contact in started["contacts"])
        [contact.pop("covariance", None) for contact in simulated["contacts"]]
    assert started == simulated
    names = (tmp_path / "data" / "postures.csv").read_text().strip().split(",")
    written = set(table_of(tmp_path / "simulated" / "postures.csv")[0])
    assert set(names) == {name for name in written if not name.startswith(("q_command.", "motor."))}
    assert rows_to_fill_in(empty, small_plan).count("\n") == len(small_plan) + 1


def _no_pictures(*arguments):
    raise tt.InputError("nothing draws here")


def strokes(pdf, number):
    """Every path of a page of a PDF: its corners on the paper, (k, 2) [mm]."""
    from pypdf import PdfReader

    found, path = [], []

    def visit(operator, operands, matrix, _):
        a, b, c, d, e, f = map(float, matrix)
        if operator in (b"m", b"re"):
            path.clear()
            found.append([])
        if operator == b"re":
            x, y, w, h = map(float, operands)
            corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
        else:
            corners = [tuple(map(float, operands))] if operator in (b"m", b"l") else []
        if corners:
            path.extend((a * x + c * y + e, b * x + d * y + f) for x, y in corners)
            found[-1] = path.copy()

    PdfReader(pdf).pages[number].extract_text(visitor_operand_before=visit)
    return [np.array(one) * 25.4 / 72 for one in found]


@draws_with("chromium")
def test_drawings_measure_right_on_paper(folder, robot, tmp_path):
    path, small_protocol = folder
    pdf = tmp_path / "protocol.pdf"
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"]
    profile = f"--user-data-dir={tmp_path / 'profile'}"
    subprocess.run(
        [*command, profile, f"--print-to-pdf={pdf}", (path / "protocol.html").as_uri()],
        check=True,
        capture_output=True,
        timeout=60,
    )
    from pypdf import PdfReader

    pages = PdfReader(pdf).pages
    assert len(pages) == len(small_protocol.placements) + 2  # a page before and one after
    box = pages[0].mediabox
    assert [float(box.width) * 25.4 / 72, float(box.height) * 25.4 / 72] == pytest.approx([210, 297], abs=0.5)
    size = nominal_plates(robot)[0].size
    placed = []
    for number in small_protocol.placements:
        plan, row = small_protocol.plan, int(np.flatnonzero(small_protocol.plan.placement == number)[0])
        boards = small_protocol.boards[row]
        placed.append(placement_of(robot, boards, plan.foot_poses[row], plan.support[[row]]))
    scale = scale_for(placed)
    for page, placement in enumerate(placed, 1):
        shapes = strokes(pdf, page)
        bars = [s for s in shapes if len(s) == 2 and np.ptp(s[:, 0]) == pytest.approx(100, abs=0.1)]
        assert len(bars) == 1
        assert np.ptp(bars[0][:, 1]) < 0.01
        sides = [np.linalg.norm(np.diff(s[:4], axis=0), axis=1) for s in shapes if len(s) >= 4]
        boards = [s for s in sides if sorted(s[:2]) == pytest.approx(sorted(1e3 * size / scale), abs=0.1)]
        assert len(boards) >= 2
        wanted = np.linalg.norm(np.diff(placement.soles, axis=1), axis=2) * 1e3 / scale
        for sole in wanted:
            assert any(s == pytest.approx(sole, abs=0.1) for s in sides)


@draws_with("chromium")
def test_pages_ask_the_network_for_nothing(folder):
    path, _ = folder
    seen = browse(path / "protocol.html", path.parent / "protocol.png", size=(800, 1100))
    assert seen.requests == []
    assert seen.complaints == []


def test_command_prints_one_document(tmp_path, small_protocol, capsys, monkeypatch):
    monkeypatch.setattr("tulip_testbed.pages.pictures.rendered", _no_pictures)
    monkeypatch.setattr("tulip_testbed.api.planned.protocol_of", lambda *arguments: small_protocol)
    said = told(capsys, "protocol", "optimal", "--out", tmp_path / "day")
    assert said["rows"] == len(small_protocol.plan)
    assert sum(said["motions"][kind] for kind in ("free", "hoist", "set_down")) == said["rows"]
    assert {name.split("/")[-1] for name in said["files"]} == {p.name for p in (tmp_path / "day").iterdir()}
    assert len(said["missing"]) == 1


@pytest.mark.slow
def test_a_plan_s_own_repeats_are_kept(robot, small_plan, tmp_path):
    """The whole command, on a plan that repeats postures."""
    write_plan(tmp_path / "plan", with_repeats(small_plan, 4, 1))
    assert main(["protocol", str(tmp_path / "plan"), "--out", str(tmp_path / "day")]) == 0
    kept = read_plan(tmp_path / "day" / "plan", robot)
    assert len(kept) == 24
    assert kept.postures == 20
    assert len((tmp_path / "day" / "rows.csv").read_text().splitlines()) == 25
