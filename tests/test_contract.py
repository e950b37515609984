"""The contract holds measurements in memory as it holds a folder."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tulip_testbed as tt
from tulip_testbed.measurements import Measurements, SensorSheet, read_measurements, write_measurements
from tulip_testbed.measurements.contract import check_contract


@pytest.fixture(scope="module")
def measured(run):
    return run.measurements


def changed(m, **fields):
    """Replace fields by what functions make of them."""
    return dataclasses.replace(m, **{name: make(getattr(m, name).copy()) for name, make in fields.items()})


def put(*place, value):
    def make(values):
        values[place] = value
        return values

    return make


def rows(m, chosen):
    """Take rows, by indices."""
    fields = {field.name: getattr(m, field.name) for field in dataclasses.fields(m)}
    of_rows = {n: v for n, v in fields.items() if isinstance(v, np.ndarray) and len(v) == len(m)}
    return dataclasses.replace(m, **{name: value[chosen] for name, value in of_rows.items()})


WRONG = {
    "degrees": (lambda m: changed(m, joint_angles=np.rad2deg), r"column 'q\..*', row \d+: found .*rad, m"),
    "commands in degrees": (lambda m: changed(m, command=np.rad2deg), r"column 'q_command\..*expected"),
    "millimetres": (lambda m: changed(m, plate_poses=lambda v: 1e3 * v), r"column 'plate\..*', row \d+"),
    "a row twice": (
        lambda m: rows(m, np.append(np.arange(len(m)), 3)),
        r"column 'posture', row \d+: found \d+, expected another posture or another time",
    ),
    "no number": (
        lambda m: changed(m, cell_forces=put(2, 2, value=np.nan)),
        r"column 'cell\.right\.rear_right', row 3: found nan, expected a finite number",
    ),
    "infinite s.d.": (
        lambda m: changed(m, cell_forces_sd=put(2, 3, value=np.inf)),
        r"'cell_std\..* found inf",
    ),
    "one joint too few": (
        lambda m: changed(m, joint_angles=lambda v: v[:, 1:]),
        r"joint_angles: found float64 \(.*, 11\), expected an array of numbers \(.*, 12\)",
    ),
    "a list": (lambda m: dataclasses.replace(m, time=list(m.time)), "time: found list, expected an array"),
    "fewer rows": (lambda m: changed(m, placement=lambda v: v[1:]), "placement: found int64"),
    "numbers with a fraction": (lambda m: changed(m, posture=lambda v: v + 0.5), "posture: found float64"),
    "another support": (lambda m: changed(m, support=put(1, value="both")), "found both, expected one of"),
    "no rows": (lambda m: rows(m, np.arange(0)), "found no rows, expected one per posture"),
    "gravity": (lambda m: dataclasses.replace(m, gravity=np.nan), "key 'gravity': found nan"),
    "top height": (lambda m: changed(m, top_height=put(0, value=np.inf)), "key 'plates.right.top_height'"),
    "cells on a line": (lambda m: changed(m, cells=lambda v: 0 * v), "found cells on one line"),
    "a mass without s.d.": (lambda m: dataclasses.replace(m, weighed_mass=23.0), "'weighed_mass'"),
    "a robot without name": (
        lambda m: dataclasses.replace(m, robot={}),
        "robot: found {}, expected the keys",
    ),
    "a negative s.d.": (
        lambda m: dataclasses.replace(m, sensors=SensorSheet(cell_sd=-1.0)),
        r"key 'sensors\.cell_sd': found -1\.0; expected 0 or more",
    ),
    "an s.d. of 100 kN": (
        lambda m: dataclasses.replace(m, sensors=SensorSheet(cell_sd=1e5)),
        r"key 'sensors\.cell_sd': found 100000\.0, expected 1000 or less",
    ),
    "numbers that begin anew": (
        lambda m: changed(m, posture=lambda v: np.arange(len(v)) % 5),
        r"column 'posture', row 6: found number 0 again, with q\..* rad from row 1; expected a number of its",
    ),
    "no weight": (lambda m: changed(m, cell_forces=lambda v: 0 * v), "weight as their sum"),
}


@pytest.mark.parametrize("name", WRONG)
def test_measurements_in_memory_are_held_against_the_contract(measured, name):
    change, message = WRONG[name]
    with pytest.raises(tt.InputError, match=f"^measurements: .*{message}"):
        check_contract(change(measured))


def test_every_door_holds_measurements_against_the_contract(measured, robot, tmp_path):
    wrong = changed(measured, joint_angles=np.rad2deg)
    for call in (
        lambda: tt.identify(wrong, robot),
        lambda: tt.discover(wrong, robot),
        lambda: tt.write_measurements(tmp_path / "data", wrong),
        lambda: tt.optimize_plan(robot, after=wrong),
        lambda: tt.view(wrong, robot, save=tmp_path / "view.rrd"),
    ):
        with pytest.raises(tt.InputError, match=r"^measurements: column 'q\."):
            call()
    assert list(tmp_path.iterdir()) == []


def test_the_preflight_reads_on_to_say_which_unit_was_meant(measured, robot):
    degrees = changed(measured, joint_angles=np.rad2deg)
    (units,) = [c for c in tt.check(degrees, robot).to_json()["checks"] if c["name"] == "units"]
    assert units["result"] == "fail"
    assert "degrees?" in units["seen"]
    with pytest.raises(tt.InputError, match="found nan, expected a finite number"):
        tt.check(changed(measured, joint_angles=put(0, 0, value=np.nan)), robot)


@pytest.mark.parametrize(
    ("name", "check"), [("numbers that begin anew", "repeats"), ("an s.d. of 100 kN", "units")]
)
def test_what_identify_refuses_the_preflight_explains(measured, robot, tmp_path, name, check):
    wrong = WRONG[name][0](measured)
    write_measurements(tmp_path / "data", wrong, likely=False)
    for given in (wrong, tmp_path / "data"):
        failed = [c.name for c in tt.check(given, robot).checks if c.result == "fail"]
        assert check in failed
    with pytest.raises(tt.InputError):
        read_measurements(tmp_path / "data")


def test_measurements_are_made_from_arrays_in_memory(measured, robot):
    m = measured
    names = ("placement", "joint_angles", "cell_forces", "plate_poses")
    rows = {name: getattr(m, name).tolist() for name in names}
    made = Measurements.from_arrays(m.header, posture=m.posture, time=m.time, **rows)
    assert made.header.stated.keys() == m.header.stated.keys()
    assert np.array_equal(made.support, m.support)
    assert np.isnan(made.joint_angles_sd).all()
    assert made.command is None
    assert np.array_equal(tt.identify(made, robot).full.value, tt.identify(m, robot).full.value)
    for wrong, message in (
        ({"joint_angels": 0}, "unknown field 'joint_angels'; did you mean 'joint_angles'"),
        ({"cell_forces": None}, "found no cell_forces, expected values of every row"),
        ({"placement": [1, 2]}, r"placement: found int64 \(2,\), expected an array of whole num"),
        ({"plate_poses": [[1], [1, 2]]}, "found no array of numbers"),
    ):
        with pytest.raises(tt.InputError, match=f"^measurements: {message}"):
            Measurements.from_arrays(m.header, **(rows | wrong))


def test_a_plan_whose_swing_foot_is_elsewhere_is_refused(robot, tmp_path):
    pose = tt.plans.random.swing_pose.copy()
    pose[:5, 0] += 5.0
    wrong = dataclasses.replace(tt.plans.random, swing_pose=pose)
    message = (
        r"columns 'swing\.\*', row 1: found 4\.\d+, .*, expected .*, where the joint angles put the foot"
    )
    with pytest.raises(tt.InputError, match=f"plan: {message}"):
        tt.Laboratory(robot).run(wrong, engine="statics")
    tt.plans.write(tmp_path / "plan", wrong)
    with pytest.raises(tt.InputError, match=message):
        tt.plans.read(tmp_path / "plan", robot)


def test_a_plan_in_memory_must_fit_the_robot(foreign, robot):
    plan = tt.plans.random
    angles = plan.joint_angles.copy()
    angles[3, 2] = np.nan
    for wrong, at, message in (
        (plan, foreign["humanoid"], "made for another robot"),
        (dataclasses.replace(plan, joints=plan.joints[::-1]), robot, "plan: found joints"),
        (dataclasses.replace(plan, joint_angles=angles), robot, "plan: row 4: found joint_angles"),
        (plan.take(np.zeros(len(plan), bool)), robot, "plan: found .* joint angles"),
        (dataclasses.replace(plan, joint_angles=np.degrees(plan.joint_angles)), robot, "expected within"),
    ):
        with pytest.raises(tt.InputError, match=message):
            tt.Laboratory(at).run(wrong, engine="statics")
        with pytest.raises(tt.InputError, match=message):
            tt.atlas(wrong, at)


def test_the_shipped_plan_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        tt.plans.random.joint_angles[0, 0] += 0.05
