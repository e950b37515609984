"""The protocol of a laboratory day: order, motions, files, pages that measure right on paper."""

import csv
import io
import itertools
import json
import shutil
import subprocess
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml

import tulip_testbed as tt
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.protocols.measurement_start import empty_measurements, rows_to_fill_in
from tulip_testbed.experiments.protocols.measuring_order import (
    drift_inflation,
    order_of_placements,
    shortest_path,
    shortest_tour,
)
from tulip_testbed.experiments.protocols.motion import FREE, HOIST, LIFT, MotionPlanner
from tulip_testbed.experiments.protocols.motion_files import motion_csv, motion_yaml
from tulip_testbed.experiments.protocols.motion_limits import dynamic_room
from tulip_testbed.experiments.protocols.motion_loads import LoadsInMotion
from tulip_testbed.experiments.protocols.protocol_run import REPEATS, ProtocolSettings, protocol_of
from tulip_testbed.identification.feasibility import stability_margin, support_polygon
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.planning.optimal_plan import with_repeats
from tulip_testbed.identification.planning_ranges import planning_ranges
from tulip_testbed.pages.placement_drawing import placement_of, scale_for
from tulip_testbed.pages.protocol_page import write_protocol
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.measurements import read_plan, write_measurements
from tulip_testbed.sim.measurements.measurement_folder import write_start
from tulip_testbed.sim.measurements.plan_folder import write_plan
from tulip_testbed.sim.robot import joint_ranges
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.sensors import PRESETS

G = 9.81


@pytest.fixture(scope="module")
def small():
    return tt.plans.optimal.take(tt.plans.optimal.placement <= 4)


@pytest.fixture(scope="module")
def made(robot, small):
    return protocol_of(robot, small, ProtocolSettings("wii", repeats=3))


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    """A protocol's folder, and the protocol."""
    path = tmp_path_factory.mktemp("protocol") / "day"
    with (
        pytest.MonkeyPatch.context() as patch
    ):  # drawing takes long; what counts is the space of the pictures
        patch.setattr("tulip_testbed.pages.protocol_page.rendered", _grey)
        assert write_protocol(path, made) == []
    return path, made


def _grey(robot, angles, support, boards, width, height):
    return np.full((len(angles), height, width, 3), 200, np.uint8)


def at_rest(loads, angles, support="double"):
    return loads.at(np.arange(3.0), np.tile(angles, (3, 1)), support)


@pytest.mark.parametrize("name", ["optimal", "mixed"])
def test_torques_at_rest_are_the_plan_s(robot, name):
    """Which planning computed from its own kinematics."""
    plan, loads = getattr(tt.plans, name), LoadsInMotion(robot)
    for k in range(0, len(plan), 7):
        found = at_rest(loads, plan.joint_angles[k], str(plan.support[k]))
        np.testing.assert_allclose(found.torques[1], plan.torques[k], atol=1e-6)
        np.testing.assert_allclose(found.zmp[1], found.com[1], atol=1e-9)


def test_zero_moment_point_follows_from_momentum(robot, made):
    """Differences of the momentum of all links, which inverse dynamics does not use."""
    motion = max(
        (m for m in made.motions if m and not m.via_stance), key=lambda m: np.ptp(m.angles, axis=0).max()
    )
    loads = LoadsInMotion(robot)
    fast = motion.times / 4
    found = loads.at(fast, motion.angles, "double")
    data, model, step = mujoco.MjData(robot.model), robot.model, fast[1]
    poses = [loads.position(angles, 0) for angles in motion.angles]
    com, spin = [], []
    for before, after in itertools.pairwise(poses):
        middle, speed = before.copy(), np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, speed, step, before, after)
        mujoco.mj_integratePos(model, middle, speed, step / 2)
        data.qpos, data.qvel = middle, speed
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        com.append(data.subtree_linvel[1].copy())
        spin.append(data.subtree_angmom[1].copy())
    a, turn = np.diff(com, axis=0) / step, np.diff(spin, axis=0) / step
    heights = []
    for pose in poses[1:-1]:
        data.qpos = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        heights.append(data.subtree_com[1].copy())
    c, mass = np.array(heights), model.body_subtreemass[1]
    up = G + a[:, 2]
    x = c[:, 0] - c[:, 2] * a[:, 0] / up - turn[:, 1] / (mass * up)
    y = c[:, 1] - c[:, 2] * a[:, 1] / up + turn[:, 0] / (mass * up)
    away = np.abs(found.zmp - found.com).max()
    assert away > 2e-3  # the motion is fast enough to tell
    np.testing.assert_allclose(found.zmp[1:-1], np.column_stack([x, y]), atol=0.05 * away)


def test_feet_and_drives_carry_the_motion(robot, made):
    """Applied to the free robot, torques and feet's wrenches give the motion's accelerations."""
    motion = next(m for m in made.motions if m and np.ptp(m.angles, axis=0).max() > 0.3)
    loads = LoadsInMotion(robot)
    found = loads.at(motion.times / 3, motion.angles, "double")
    speeds, accelerations = loads.derivatives(
        motion.times / 3, np.array([loads.position(q, 0) for q in motion.angles])
    )
    model, data = robot.model, mujoco.MjData(robot.model)
    k = len(motion.times) // 3
    data.qpos, data.qvel = loads.position(motion.angles[k], 0), speeds[k]
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    total, jacobian = np.zeros(model.nv), np.zeros((6, model.nv))
    total[loads.dofs] = found.torques[k]
    for side, foot in enumerate(loads.feet):
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], np.zeros(3), foot)
        total += jacobian.T @ found.foot_wrenches[k, side]
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    left = inertia @ accelerations[k] + data.qfrc_bias + model.dof_damping * speeds[k]
    np.testing.assert_allclose(total, left, atol=1e-6)


def test_every_motion_keeps_every_limit(robot, made):
    """Looked at anew: ranges, speed, torque, feet, centre of mass."""
    nominal, chain = nominal_robot(robot), MotionPlanner(robot, made.plan).chain
    ranges, torques = joint_ranges(robot.model), torque_limits(robot)
    inside = planning_ranges(robot).stability_margin
    motions = [m for m in made.motions if m]
    assert len(motions) > 10
    assert any(m.via_stance for m in motions)
    for motion in motions:
        assert motion.kind == FREE
        assert min(motion.room.values()) >= 0
        assert (motion.angles >= ranges[:, 0] - 1e-4).all()
        assert (motion.angles <= ranges[:, 1] + 1e-4).all()
        assert np.abs(motion.speeds).max() <= 0.5 * 1.01
        assert (np.abs(motion.torques) <= torques).all()
        swing = np.array([chain.swing_pose(q) for q in motion.angles])
        assert np.ptp(swing, axis=0).max() < 1e-4
        polygon = support_polygon(nominal.soles_in_base(motion.angles[:1])[0])
        assert stability_margin(nominal.center_of_mass(motion.angles), polygon) >= inside - 2e-4


def test_legs_do_not_touch_on_the_way(robot, made):
    """By MuJoCo's distances between the geoms of both legs below the hips, in the robot's own coordinates."""
    model, data = robot.model, mujoco.MjData(robot.model)
    loads, side = LoadsInMotion(robot), {}
    for name in ("right", "left"):
        legs = {model.body(f"{name}_{part}").id for part in ("upper_leg", "lower_leg")}
        side[name] = [g for g in range(model.ngeom) if model.geom_bodyid[g] in legs]
    assert min(map(len, side.values())) >= 2

    def apart(angles):
        data.qpos = loads.position(angles, 0)
        mujoco.mj_kinematics(model, data)
        pairs = itertools.product(side["right"], side["left"])
        return min(mujoco.mj_geomDistance(model, data, a, b, 0.1, None) for a, b in pairs)

    nearest = []
    for motion in made.motions:
        if motion is not None and not motion.via_stance:
            distances = [apart(angles) for angles in motion.angles[:: len(motion.angles) // 12]]
            ends = min(apart(motion.angles[0]), apart(motion.angles[-1]))
            assert min(distances) > min(ends, 0.005) - 3e-4
            nearest.append(min(distances))
    assert min(nearest) < 0.05  # some come near each other


def test_motions_begin_and_end_at_rest_in_their_postures(made):
    for k, motion in enumerate(made.motions):
        if motion is None:
            continue
        np.testing.assert_allclose(motion.angles[[0, -1]], made.plan.joint_angles[[k - 1, k]], atol=1e-9)
        assert np.abs(motion.speeds[[0, -1]]).max() < 1e-9
        slope = np.gradient(motion.angles, motion.times, axis=0)
        np.testing.assert_allclose(motion.speeds[2:-2], slope[2:-2], atol=0.02)
        assert (np.diff(motion.times) > 0).all()


def test_a_posture_that_asks_too_much_is_reached_in_the_hoist(robot):
    """Posture 25 of the random plan needs more than its drives give, if the load is shared as planned."""
    plan = tt.plans.random
    loads, limits = LoadsInMotion(robot), MotionPlanner(robot, plan).limits
    over = [
        k
        for k in range(60)
        if dynamic_room(limits, at_rest(loads, plan.joint_angles[k]), "double")["torque"] < -0.05
        and plan.placement[k] == plan.placement[k - 1]
    ]
    motion = MotionPlanner(robot, plan).motion(over[0] - 1, over[0])
    assert motion.kind == HOIST
    assert "torque" in motion.reason
    assert "torque." not in motion_csv(motion, plan.joints).splitlines()[0]
    assert yaml.safe_load(motion_yaml(motion, plan.joints))["points"][0]["effort"] == []


def test_motions_on_one_foot_keep_the_other_in_the_air(robot):
    """Near each other: from a posture on the right foot to one with a little of the way to the next."""
    mixed = tt.plans.mixed
    plan = mixed.take(np.flatnonzero(mixed.support == "right")[[0, 0]])
    turned = plan.joint_angles + np.array([[0.0], [0.05]]) * np.eye(12)[6]  # the left hip's yaw
    plan = replace(plan, joint_angles=turned, posture=np.array([1, 2]), placement=np.array([1, 1]))
    motion = MotionPlanner(robot, plan).motion(0, 1)
    assert motion.kind == FREE
    found = LoadsInMotion(robot).at(motion.times, motion.angles, "right")
    assert found.soles[:, 1, :, 2].min() > 0.01
    assert np.isnan(found.foot_points[:, 1]).all()
    assert (found.foot_wrenches[:, 1] == 0).all()


def test_where_links_would_touch_the_robot_is_lifted(robot, small, monkeypatch):
    """And what follows has a placement of its own, since its boards are recorded anew."""
    found = MotionPlanner._found
    monkeypatch.setattr(MotionPlanner, "_found", lambda self, a, b: (found(self, a, b)[0], LIFT))
    lifted = protocol_of(robot, small, ProtocolSettings(repeats=0))
    assert lifted.motions == (None,) * len(small)
    assert len(lifted.placements) == len(small)
    assert sorted(lifted.plan.posture.tolist()) == sorted(small.posture.tolist())


def test_order_is_as_short_as_the_shortest():
    rng = np.random.default_rng(5)
    for count in (3, 5, 6):
        points = rng.random((count, 3))
        cost = np.linalg.norm(points[:, None] - points, axis=-1)

        def length(order, cost=cost):
            return cost[list(order[:-1]), list(order[1:])].sum()

        every = list(itertools.permutations(range(count)))
        assert length(shortest_path(cost)) == pytest.approx(min(map(length, every)))
        closed = min(length((*order, order[0])) for order in every)
        tour = shortest_tour(cost)
        assert length([*tour, tour[0]]) == pytest.approx(closed)


def test_everything_is_measured_once_and_repeats_are_spread(made, small):
    plan = made.plan
    assert sorted(set(plan.posture.tolist())) == sorted(small.posture.tolist())
    assert len(plan) == len(small) + 3
    changes = np.count_nonzero(np.diff(plan.placement)) + 1
    assert changes == len(np.unique(plan.placement))
    for number in np.unique(plan.posture):
        rows = np.flatnonzero(plan.posture == number)
        assert (np.diff(rows) > 1).all()
        assert (plan.joint_angles[rows] == plan.joint_angles[rows[0]]).all()
    again = [n for n in made.placements if n > small.placement.max()]
    assert again  # boards are laid anew
    assert all(motion is None for k, motion in enumerate(made.motions) if not k or changes_at(plan, k))


def changes_at(plan, k):
    return plan.placement[k] != plan.placement[k - 1]


def test_time_grows_with_nothing_else(robot):
    """A plan whose placements are sorted by the place of the foot confuses a drift; the order does not."""
    plan = tt.plans.random.take(tt.plans.random.placement <= 12)
    first = plan.swing_pose[np.searchsorted(plan.placement, plan.placement)][:, 0]
    plan = plan.take(np.argsort(first, kind="stable"))
    order = order_of_placements(robot, plan)
    ordered = plan.take(np.concatenate([np.flatnonzero(plan.placement == number) for number in order]))
    assert drift_inflation(robot, ordered) < 0.8 * drift_inflation(robot, plan)


@pytest.mark.parametrize("rows", [1, 5])
def test_a_short_plan_that_alone_tells_nothing_has_a_protocol(robot, small, rows):
    """Such as the next experiment of a session."""
    made = protocol_of(robot, small.take(np.arange(rows)))
    assert sorted(set(made.plan.posture.tolist())) == list(range(1, rows + 1))
    assert len(made.plan) == rows + rows // 5
    assert "Protocol" in repr(made)


def test_trajectories_are_messages_of_ros(folder):
    path, made = folder
    files = sorted((path / "trajectories").glob("*.yaml"))
    assert len(files) == sum(motion is not None for motion in made.motions)
    for file in files:
        message = yaml.safe_load(file.read_text())
        assert list(message) == ["header", "joint_names", "points"]
        assert message["joint_names"] == list(made.plan.joints)
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
            for k, joint in enumerate(made.plan.joints):
                found = np.interp(times, table["time"], table[f"{prefix}.{joint}"])
                np.testing.assert_allclose(values[:, k], found, atol=2e-5)


def test_statics_measures_in_the_order_of_the_protocol(robot, made):
    measured = tt.Laboratory(robot, "ideal").run(made.plan, seed=413, engine="statics").measurements
    np.testing.assert_array_equal(measured.posture, made.plan.posture)
    assert (np.diff(measured.placement) < 0).any()
    assert (np.diff(measured.time) > 0).all()


@pytest.mark.parametrize("way", ["appended", "filled in"])
def test_the_started_folder_takes_rows(folder, robot, tmp_path, way):
    """Rows of a simulated run, appended by a logger or filled in by hand, are identified as the run's own."""
    path, made = folder
    kept = read_plan(path / "plan", robot)
    np.testing.assert_array_equal(kept.posture, made.plan.posture)
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
    manifest = json.loads((tmp_path / "data" / "manifest.json").read_text())
    assert run.measurements.weighed_mass is not None
    mass, sd = run.measurements.weighed_mass
    assert manifest["weighed_mass"] is None
    manifest["weighed_mass"] = {"value": mass, "sd": sd}
    (tmp_path / "data" / "manifest.json").write_text(json.dumps(manifest))
    expected = tt.identify(replace(run.measurements, command=None, motor=None), robot)
    found = tt.identify(tmp_path / "data", robot)
    np.testing.assert_allclose(found.full.value, expected.full.value, rtol=1e-9)
    np.testing.assert_allclose(found.full.covariance, expected.full.covariance, rtol=1e-9)


def table_of(path):
    return list(csv.DictReader(io.StringIO(path.read_text())))


def test_without_a_data_sheet_the_manifest_says_so(robot, small, made, tmp_path, monkeypatch):
    without = replace(made, settings=ProtocolSettings())
    monkeypatch.setattr("tulip_testbed.api.protocol_of", lambda *arguments: without)
    monkeypatch.setattr("tulip_testbed.pages.protocol_page.rendered", _no_pictures)
    tt.protocol(small, tmp_path / "day", robot, repeats=0)
    manifest = json.loads((tmp_path / "day" / "measurements" / "manifest.json").read_text())
    assert set(manifest["sensors"].values()) == {None}
    page = (tmp_path / "day" / "protocol.html").read_text()
    assert "sensors.cell_sd" in page
    assert "Pictures of postures: nothing draws here" in page


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_laboratory_s_folder_can_be_started(robot, small, tmp_path, preset):
    """The manifest is that of a simulated laboratory, without the mass, and so are the columns."""
    empty = empty_measurements(robot, preset)
    write_start(tmp_path / "data", empty)
    started = json.loads((tmp_path / "data" / "manifest.json").read_text())
    run = tt.Laboratory(robot, preset).run(small, seed=412, engine="statics")
    write_measurements(tmp_path / "simulated", run.measurements)
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
    assert rows_to_fill_in(empty, small).count("\n") == len(small) + 1


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


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_drawings_measure_right_on_paper(folder, robot, tmp_path):
    path, made = folder
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
    assert len(pages) == len(made.placements) + 2  # a page before and one after
    box = pages[0].mediabox
    assert [float(box.width) * 25.4 / 72, float(box.height) * 25.4 / 72] == pytest.approx([210, 297], abs=0.5)
    size = nominal_plates(robot)[0].size
    placed = []
    for number in made.placements:
        row = int(np.flatnonzero(made.plan.placement == number)[0])
        placed.append(
            placement_of(robot, made.boards[row], made.plan.foot_poses[row], made.plan.support[[row]])
        )
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


def test_pages_ask_the_network_for_nothing(folder):
    from tests.looking import browse

    path, _ = folder
    if shutil.which("chromium") is None:
        pytest.skip("needs Chromium")
    seen = browse(path / "protocol.html", path.parent / "protocol.png", size=(800, 1100))
    assert seen.requests == []
    assert seen.complaints == []


def test_command_refuses_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    out = tmp_path / "day"
    assert main(["protocol", "optimal", "--out", str(out), "--speed", "0"]) == 2
    assert "--speed: found 0, expected above 0" in capsys.readouterr().err
    assert main(["protocol", "nothing", "--out", str(out)]) == 2
    assert "no shipped plan has this name" in capsys.readouterr().err
    assert not out.exists()
    out.mkdir()
    assert main(["protocol", "optimal", "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_another_robot_s_plan_is_refused(tmp_path, small):
    other = replace(small, robot={"model": "other.xml", "sha256": "0" * 64})
    with pytest.raises(tt.InputError, match="made for another robot than TULip"):
        tt.protocol(other, tmp_path / "day")
    assert not list(tmp_path.iterdir())


def test_command_prints_one_document(tmp_path, made, capsys, monkeypatch):
    from tulip_testbed.experiments.protocols import protocol_run

    monkeypatch.setattr("tulip_testbed.pages.protocol_page.rendered", _no_pictures)
    monkeypatch.setattr(protocol_run, "protocol_of", lambda *arguments: made)
    assert main(["protocol", "optimal", "--out", str(tmp_path / "day"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == len(made.plan)
    assert sum(told["motions"][kind] for kind in ("free", "hoist", "set_down")) == told["rows"]
    assert {name.split("/")[-1] for name in told["files"]} == {p.name for p in (tmp_path / "day").iterdir()}
    assert len(told["missing"]) == 1


@pytest.mark.slow
def test_a_plan_s_own_repeats_are_kept(robot, small, tmp_path):
    """The whole command, on a plan that repeats postures."""
    write_plan(tmp_path / "plan", with_repeats(small, 4, 1))
    assert main(["protocol", str(tmp_path / "plan"), "--out", str(tmp_path / "day")]) == 0
    kept = read_plan(tmp_path / "day" / "plan", robot)
    assert len(kept) == 24
    assert kept.postures == 20
    assert len((tmp_path / "day" / "rows.csv").read_text().splitlines()) == 25


def test_the_command_s_defaults_are_the_library_s():
    from inspect import signature

    from tulip_testbed.cli.protocol_command import protocol_command

    given = {name: p.default for name, p in signature(protocol_command).parameters.items()}
    settings = ProtocolSettings()
    assert (given["preset"], given["speed"], given["repeats"]) == (None, settings.speed, REPEATS)
