"""Logs of a moving robot: every reader gives the same table, and rows obey the equation of motion."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import changed, put, within
from tests.first_look import cases
from tests.moving_robots import by_inverse_dynamics, moving
from tests.recorded_logs import BAD, CHANNELS, KINDS, motion, unit, write_dumper, write_table
from tests.test_refusals import check_words, rows
from tulip_testbed.experiments.posture_splits import by_halves
from tulip_testbed.experiments.predict import PredictionProblem
from tulip_testbed.experiments.table_import.series_import import _support, _touching
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.regressor import regression, with_cad_where_needed
from tulip_testbed.measurements.logs.joined_clocks import TIME
from tulip_testbed.measurements.logs.log_file import read_log
from tulip_testbed.measurements.logs.series_reduction import reduced, supports

BOWING = Path(__file__).parent / "data" / "bowing"
WEIGHT = 61.69 * 9.81


@pytest.fixture(scope="module")
def bowing():
    return tt.load_robot(BOWING / "robot.toml")


@pytest.fixture(scope="module")
def imported(bowing, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bowing") / "rows"
    result = tt.import_table(
        BOWING / "ExperimentDataset.mat", bowing, out=folder, map=[str(BOWING / "map.toml")]
    )
    assert result.problems == ()
    return tt.read_measurements(folder)


def moved(m):
    """Return wrenches of the right foot, angles, rates and accelerations."""
    return m.wrenches[:, 0], m.joint_angles, m.joint_rates, m.joint_accelerations


def needed(robot, angles, rates, accelerations):
    """Return the wrench of the ground on the foot at rest, by MuJoCo's inverse dynamics, (m, 6)."""
    states = zip(angles, rates, accelerations, strict=True)
    return np.array([by_inverse_dynamics(robot, robot.stance_foot, np.zeros(3), *one)[0] for one in states])


def samples(imported, robot, time):
    """Return samples of the motion with the wrenches that it needs."""
    angles, rates, accelerations = motion(time)
    one = imported.take(np.zeros(len(time), int))
    wrenches = np.full((len(time), 2, 6), np.nan)
    wrenches[:, 0] = needed(robot, angles, rates, accelerations)
    return dataclasses.replace(one, time=time, joint_angles=angles, wrenches=wrenches)


@pytest.mark.parametrize("regular", [True, False])
def test_rows_obey_the_equation_of_motion(imported, bowing, regular):
    rng = np.random.default_rng(100)
    steps = np.full(2000, 0.01) if regular else rng.uniform(0.005, 0.015, 2000)
    time = np.cumsum(steps)
    m: Any = reduced(samples(imported, bowing, time), WEIGHT).measurements
    assert len(m) > 70
    wrenches, angles, rates, accelerations = moved(m)
    off = wrenches - needed(bowing, angles, rates, accelerations)
    assert np.abs(off[:, 3:5]).max() < 6e-4 * WEIGHT  # 0.6 mm, of the curvature of sines
    assert np.abs(off[:, :3]).max() < 1.0
    middle = motion(m.time + m.window / 2)
    np.testing.assert_allclose(rates, middle[1], atol=0.08)
    np.testing.assert_allclose(accelerations, middle[2], atol=0.5)
    nominal = nominal_robot(bowing, "right")
    weighed = dataclasses.replace(m, weighed_mass=(nominal.mass, 0.0))
    center, *others = [contact_pressure(observe(one, nominal)).center for one in (m, weighed)]
    unknown = within("contacts", m, zero_sd=np.full((2, 6), np.inf))
    others.append(PredictionProblem(unknown, nominal).center)
    for other in others:  # over the weight in motion, which differs from the measured force by 1 N at most
        np.testing.assert_allclose(other, center, rtol=0, atol=1.0 / WEIGHT * np.abs(center).max())


def test_means_are_exact_for_cubic_motion_by_any_clock(imported, bowing):
    rng = np.random.default_rng(101)
    time = np.cumsum(rng.uniform(0.002, 0.03, 400))
    cubic = np.polynomial.Polynomial([0.3, -0.2, 0.1, 0.05])
    made: Any = samples(imported, bowing, time)
    wrenches = 0 * made.wrenches + WEIGHT + cubic(time - 3)[:, None, None]
    made = dataclasses.replace(made, joint_angles=np.column_stack([cubic(time - 3)] * 2), wrenches=wrenches)
    m: Any = reduced(made, WEIGHT, window=0.4, step=0.3).measurements
    _, angles, rates, accelerations = moved(m)
    middle = m.time + 0.2 - 3
    spread = 0.2**2 / 7  # variance of the window's weights
    np.testing.assert_allclose(angles[:, 0], (cubic + spread / 2 * cubic.deriv(2))(middle), atol=1e-9)
    np.testing.assert_allclose(rates[:, 0], (cubic.deriv() + spread / 2 * cubic.deriv(3))(middle), atol=1e-9)
    np.testing.assert_allclose(accelerations[:, 0], cubic.deriv(2)(middle), atol=1e-9)
    np.testing.assert_allclose(m.wrench_jerks[:, 0, 0], cubic.deriv(3)(middle), atol=1e-6)
    np.testing.assert_allclose(m.joint_angles_sd[:, 0], 0, atol=1e-9)


def test_forces_change_as_fast_in_rows_as_in_samples(imported, bowing):
    """Means of a sine and of its derivatives have the ratio of its values, with two rows a period too."""
    time, pace, offset = np.arange(0, 30, 0.01), 5.4, 0.8 * WEIGHT
    made = samples(imported, bowing, time)
    made = changed(made, wrenches=put(..., 0, slice(None), value=offset + 10 * np.sin(pace * time)[:, None]))
    m: Any = reduced(made, WEIGHT, window=1.0, step=0.5).measurements
    swing = m.wrenches[:, 0] - offset
    assert swing.std() > 2
    np.testing.assert_allclose(m.wrench_accelerations[:, 0], -(pace**2) * swing, atol=0.01 * pace**2 * 10)
    rates = pace * (swing[2:] - swing[:-2]) / 2 / np.sin(pace * 0.5)
    np.testing.assert_allclose(m.wrench_rates[1:-1, 0], rates, atol=0.01 * pace * 10)
    ratio = m.wrench_jerks[:, 0] / m.wrench_rates[:, 0]  # by other weights, with more of fast motion
    assert (np.median(ratio, axis=0) < -(pace**2)).all()
    assert (np.median(ratio, axis=0) > -1.4 * pace**2).all()
    assert np.isnan(m.wrench_accelerations[:, 1]).all()


def test_a_person_who_bows_becomes_rows(imported, bowing):
    m = imported
    assert len(m) == 57
    assert set(m.support) == {"right"}
    assert set(m.placement) == {1, 2, 3, 4}  # blocks of four seconds
    assert np.isnan(m.wrenches[:, 1]).all()
    wrenches, angles, rates, accelerations = moved(m)
    off = wrenches - needed(bowing, angles, rates, accelerations)
    assert np.std(off[:, 4]) / WEIGHT < 6e-3  # CAD, inertia and a constant
    held = needed(bowing, angles, 0 * rates, 0 * rates)
    assert np.std(wrenches[:, 4] - held[:, 4]) > 1.2 * np.std(off[:, 4])


QUICK, SLOW = ("unknown", [8.3, 8.3, 23.5, 7.9, 6.0]), ("tared", [11.9, 6.6, 23.5, 8.4, 8.0])


@cases("zeros, expected", [QUICK], [SLOW])
def test_identified_masses_predict_the_person_better_than_cad(imported, bowing, zeros, expected):
    """Along the plane of the motion, halves both ways [mm]; CAD with an offset is not beaten surely."""
    if zeros == "tared":
        imported = within("contacts", imported, zero_sd=np.zeros((2, 6)))
    predicted = tt.predict(imported, bowing)
    found = {one.name: one.rms_mm.x for one in predicted.models if one.split == "halves"}
    names = ["CAD", "CAD with offset", "constant", "identified", "identified with corrections"]
    assert found == pytest.approx(dict(zip(names, expected, strict=True)), abs=0.1)
    assert predicted.beats_cad is True
    assert predicted.beats_cad_with_offset is None


def test_joints_that_stop_while_the_person_goes_on_are_a_frozen_log(imported, bowing):
    """The contact readings of half the record go on; a sensor repeats its last angles."""
    last = put(slice(28, None), value=imported.joint_angles[28])
    frozen = changed(imported, joint_angles=last)
    found = {one.name: one for one in tt.check(frozen, bowing).checks}["stuck readings"]
    assert (found.result, found.where) == ("fail", "rows 29 to 57")
    assert "no joint changes, while the centre of pressure moves by" in found.seen
    assert {one.name: one for one in tt.check(imported, bowing).checks}["stuck readings"].result == "pass"


def test_moments_that_are_named_forces_are_asked_for(bowing, tmp_path):
    text = (BOWING / "map.toml").read_text()
    for k in range(3):
        a, b = (f"fts_footFrame.{k + first}" for first in (1, 4))
        text = text.replace(a, "@").replace(b, a).replace("@", b)
    (tmp_path / "map.toml").write_text(text)
    result = tt.import_table(
        BOWING / "ExperimentDataset.mat", bowing, out=tmp_path / "rows", map=[str(tmp_path / "map.toml")]
    )
    assert result.folder is None
    assert "named as moments read 605, the robot weighs 605 N: are they the forces?" in result.problems[0]


def two_feet(imported, bowing, loads):
    """Return samples at 100 Hz with given forces on the right and the left foot, (n, 2) [of the weight]."""
    made = samples(imported, bowing, np.arange(len(loads)) / 100)
    wrenches = np.zeros((len(loads), 2, 6))
    wrenches[:, :, 1] = np.multiply(loads, WEIGHT)  # in whatever frame the sensors are
    return dataclasses.replace(made, wrenches=wrenches)


def test_support_follows_from_the_loads_and_transitions_are_left_out(imported, bowing):
    loads = [*[(0.5, 0.5)] * 200, *[(0.02, 0.98)] * 200, *[(0.5, 0.5)] * 200, *[(0.0, 0.0)] * 100]
    made = two_feet(imported, bowing, loads)
    made = dataclasses.replace(made, support=supports(made, WEIGHT))
    out = reduced(made, WEIGHT, window=0.5, step=0.25)
    m = out.measurements
    stances = [(a, b) for a, b in zip(m.support, m.placement.tolist(), strict=True)]
    assert sorted(set(stances)) == [("double", 1), ("double", 3), ("left", 2)]
    assert out.dropped == {
        "in which a foot lands or lifts": 3,
        "in which a foot that stands carries less than 5 % of the weight": 2,
    }


def test_a_foot_that_is_put_down_is_not_in_the_air(imported, bowing):
    loads = [*[(0.5, 0.5)] * 200, *[(0.045, 0.955)] * 100, *[(0.01, 0.99)] * 300]
    made = two_feet(imported, bowing, loads)
    made = dataclasses.replace(made, support=supports(made, WEIGHT))
    m = reduced(made, WEIGHT, window=0.5, step=0.5).measurements
    assert [f"{a:.1f}" for a in m.time[_touching(m, WEIGHT)]] == ["2.0", "2.5"]


def test_a_foot_whose_sensor_has_a_zero_is_in_the_air_where_the_legs_do_not_close(robot):
    nominal = nominal_robot(robot)
    weight = nominal.mass * 9.81
    made = moving(robot, np.random.default_rng(0), 500)
    angles = np.zeros_like(made.joint_angles)
    knee = [k for k, joint in enumerate(made.joints) if "knee" in joint and "left" in joint]
    angles[200:, knee] = 0.4
    wrenches = np.zeros((500, 2, 6))
    wrenches[:200, :, 1] = 0.5 * weight
    wrenches[200:, :, 1] = [0.9 * weight, 0.12 * weight]
    wrenches[200:250, 1, 1] = np.linspace(0.24, 0.14, 50) * weight  # a toe that still pushes
    made = dataclasses.replace(made, joint_angles=angles, wrenches=wrenches)
    assert _support(made, nominal, weight).tolist() == ["double"] * 200 + [""] * 50 + ["right"] * 250
    level = dataclasses.replace(made, joint_angles=np.zeros_like(angles))
    assert set(_support(level, nominal, weight)) == {"double"}


def test_a_gap_in_the_clock_costs_its_windows_alone(imported, bowing):
    time = np.arange(1000) / 100
    made = samples(imported, bowing, time[(time < 3) | (time > 3.3)])
    out = reduced(made, WEIGHT)
    assert out.dropped == {"with too few samples or a gap between them": 2}
    assert set(out.measurements.placement) == {1, 2, 3}


def test_no_window_trains_that_overlaps_one_that_is_predicted(imported, bowing):
    observed = observe(imported, nominal_robot(bowing, "right"))
    for train, test in by_halves(imported).folds:
        apart = np.abs(imported.time[train][:, None] - imported.time[test])
        assert (apart >= imported.window[train][:, None]).all()
        assert len(observed.take(train).motion.by_cad) == len(train)


def test_a_moving_record_has_cad_as_prior_even_where_its_rows_have_full_rank(imported, bowing):
    """Without it a simulated TALOS missed the other half of its record by 28 mm, CAD by 4."""
    nominal = nominal_robot(bowing, "right")
    data = regression(nominal.parameters, imported, bowing)
    assert np.linalg.matrix_rank(data.matrix) == data.matrix.shape[1] < len(data.matrix)
    assert with_cad_where_needed(observe(imported, nominal), data).cad is not None
    still = dataclasses.replace(imported, joint_rates=None, joint_accelerations=None)
    assert with_cad_where_needed(observe(still, nominal), data).cad is not None  # nothing shows the weight
    still = dataclasses.replace(still, weighed_mass=(nominal.mass, 0.1))
    assert with_cad_where_needed(observe(still, nominal), data).cad is None


def test_the_gain_of_the_sensors_is_in_the_standard_error_of_a_mass_that_nobody_weighed(imported, bowing):
    found: Any = tt.identify(imported, bowing)
    exact = dataclasses.replace(imported, tolerances={**imported.tolerances, "wrench-gain": 0.0})
    without_gain = tt.identify(exact, bowing).mass[1]
    assert found.mass[1] ** 2 - without_gain**2 == pytest.approx((0.01 * found.mass[0]) ** 2, rel=1e-3)
    assert tt.identify(imported, bowing, tolerances={"wrench-gain": 0.0}).mass[1] == without_gain
    # Once: the force's own gain is the same gain.
    labels = [label for one in found.calibration.families for label in one.family.labels]
    assert "wrench-crosstalk:right.fz.fx" in labels
    assert "wrench-crosstalk:right.fz.fz" not in labels


CONTACTS = "".join(
    f'[[contacts]]\nname = "{side}"\nkind = "wrench"\nmount = "foot"\n' for side in ("right", "left")
)
MAP = '[series]\nsupport = "right"\n' + CONTACTS


def import_log(bowing, path, columns, text=MAP):
    stated = path.with_name("map.toml")
    stated.write_text(text)
    return tt.import_table(path, bowing, out=path.with_name("rows"), map=[str(stated), *columns])


@pytest.mark.parametrize("name", KINDS)
def test_every_reader_gives_the_same_rows(bowing, tmp_path, name):
    write, columns = KINDS[name]
    write(tmp_path / name)
    result = import_log(bowing, tmp_path / name, columns)
    assert result.folder is not None, result.problems
    assert any("`zero` is unknown" in text for text in result.assumed)
    m = tt.read_measurements(result.folder)
    assert len(m) == 10
    wrenches, _, rates, _ = moved(m)
    middle = m.time - m.time[0] + 0.25
    np.testing.assert_allclose(rates, motion(middle)[1], atol=0.06)
    expected = np.column_stack([np.sin(middle + k) * 10 + 600 * (k == 2) for k in range(6)])
    np.testing.assert_allclose(wrenches, expected, atol=0.1)


def test_the_values_of_a_device_are_stated_at_once(bowing, tmp_path):
    write_dumper(tmp_path / "log")
    names, units = (
        json.dumps(each) for each in ([f"wrench.right.{c}" for c in CHANNELS], [*map(unit, CHANNELS)])
    )
    values = '[values]\nlegs = {names = ["q.ankle", "q.hip"], unit = "rad"}\n'
    values += f'"feet.right" = {{names = {names}, unit = UNITS}}\n'
    with pytest.raises(tt.InputError, match="found 5, expected one, or 6"):
        import_log(bowing, tmp_path / "log", [], MAP + values.replace("UNITS", units.replace('"N", ', "", 1)))
    mapped = import_log(bowing, tmp_path / "log", [], MAP + values.replace("UNITS", units)).mapped
    pairs = (text.split("=") for text in KINDS["log"][1])  # NAME=COLUMN:UNIT:SIGN
    told = {name: tuple(entry.split(":")[:2]) for name, entry in pairs}
    assert {name: (one.column, one.unit) for name, one in mapped.items() if name in told} == told


def test_devices_are_joined_on_the_slowest_clock_where_all_were_logged(tmp_path):
    clocks = {"slow": np.arange(100) / 20 + 1.013, "fast": np.arange(600) / 100}
    for device, clock in clocks.items():
        (tmp_path / device).mkdir()
        gap = (clock > 2.5) & (clock < 3) if device == "fast" else np.zeros(len(clock), bool)
        rows = np.column_stack([np.arange(len(clock)), clock, 3 * clock])[~gap]
        np.savetxt(tmp_path / device / "data.log", rows, "%.9f")
    table = read_log(tmp_path)
    time = table.numbers(TIME)
    expected = clocks["slow"]
    expected = expected[(expected <= 5.99) & ~((expected > 2.5) & (expected < 3))]
    np.testing.assert_allclose(time, expected, atol=1e-9)
    np.testing.assert_allclose(table.numbers("fast.1"), 3 * expected, atol=1e-6)


def test_a_long_table_with_a_fast_clock_is_a_series(bowing, tmp_path):
    write_table(tmp_path / "log.csv")
    result = import_log(bowing, tmp_path / "log.csv", [], CONTACTS)
    assert result.folder is None  # the left foot's wrench is not logged, nobody said that it is in the air
    assert "wrench.left.fx" in " ".join(result.problems)


@rows("logs")
def test_bad_logs_are_refused(bowing, tmp_path, changes, words):
    if changes[0] == "no bag":
        pytest.importorskip("mcap")
    name, write = BAD[changes[0]]
    write(tmp_path / name)
    try:
        result = import_log(bowing, tmp_path / name, KINDS["log"][1])
    except tt.InputError as error:
        messages = [str(error)]
    else:
        messages = result.problems
    assert len(messages) == 1
    check_words(words, messages[0])


def test_samples_without_a_number_are_missing(bowing, tmp_path):
    def unread(device, rows):
        rows = rows.copy()
        rows[150:170, 2:] = np.nan if device == "legs" else 0.0
        return rows

    found = []
    for name, change in (
        ("unread", unread),
        ("missing", lambda device, rows: np.delete(rows, slice(150, 170), 0)),
    ):
        (tmp_path / name).mkdir()
        write_dumper(tmp_path / name / "log", change)
        found.append(import_log(bowing, tmp_path / name / "log", KINDS["log"][1]))
    with_gaps, without = (tt.read_measurements(one.folder or "") for one in found)
    assert any("left out: 20 samples without a number" in text for text in found[0].assumed)
    assert len(with_gaps) < 10
    np.testing.assert_array_equal(with_gaps.joint_angles, without.joint_angles)
    np.testing.assert_array_equal(with_gaps.wrenches, without.wrenches)


def test_a_device_that_stops_is_told(bowing, tmp_path):
    write_dumper(tmp_path / "log", lambda device, rows: rows[: 150 if device == "legs" else None])
    with pytest.warns(UserWarning, match=r"legs stops 1.5 s before the others"):
        result = import_log(bowing, tmp_path / "log", KINDS["log"][1])
    assert result.folder is not None
