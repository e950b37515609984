"""The measurement folder, version 2: contact sensors of any kind, joints that are not logged, other names."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.contact_folders import EXAMPLE, GROUND, POSE, assert_same, contacts_of, readings, write_contacts
from tests.fuzz.documents import changed_anywhere, read_or_refused
from tests.test_refusals import refuse, rows
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.measurements import read_measurements, write_measurements
from tulip_testbed.measurements.contacts import VERTICAL, WRENCH
from tulip_testbed.measurements.contract import check_contract


@pytest.fixture(scope="module")
def plates():
    """Measurements on plates with four cells, of version 1."""
    return read_measurements(EXAMPLE)


@pytest.fixture
def write(plates, tmp_path):
    """Write a folder by hand: the contacts of the manifest, other columns and keys."""
    return lambda contacts, columns=None, drop=(), **keys: write_contacts(
        tmp_path / "data", plates, contacts, columns, drop, **keys
    )


STATED = {
    "below": {"mass": 0.4, "mass_sd": 0.02, "center": [0.02, 0.0, -0.04], "center_sd": 0.005},
    "covariance": np.diag([1.0, 1.0, 4.0, 0.01, 0.01, 0.01]).tolist(),
    "zero": [0, 0, 1.5, None, 0.1, 0.1],
}


def test_wrench_sensors_in_the_feet_are_read(write, plates):
    m: Any = read_measurements(write(contacts_of(**STATED), poses=False))
    assert m.contacts.mount == "foot"
    assert m.contacts.channels == WRENCH
    assert m.contacts.pose.tolist() == [[0.01, 0, -0.03, 0, 0, 0.5]] * 2
    assert m.contacts.zero_sd.tolist() == [[0, 0, 1.5, np.inf, 0.1, 0.1]] * 2
    assert m.contacts.below.tolist() == [[0.4, 0.02, 0.0, -0.04]] * 2
    assert m.contacts.below_sd.tolist() == [[0.02, 0.005, 0.005, 0.005]] * 2
    assert np.array_equal(np.asarray(m.contacts.covariance), STATED["covariance"])
    assert m.wrenches.shape == (len(plates), 2, 6)
    assert m.wrenches[:, 0, 2].tolist() == plates.cell_forces[:, :4].sum(axis=1).tolist()
    assert m.cell_forces.shape == (len(plates), 0)
    assert m.cells.shape == (2, 0, 2)
    assert not m.plate_poses.any()
    assert not m.top_height.any()


@pytest.mark.parametrize(
    "changes",
    [
        {"zero": "unknown"},
        {"zero": [None, 0, 0.25, 0, 0, 0]},
        {"below": {"mass": 0.4, "mass_sd": 0.02, "center": [0.0, 0.0, -0.04], "center_sd": [0.1, 0.2, 0.3]}},
        {"covariance": np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).tolist()},
        GROUND,
        GROUND | {"channels": list(VERTICAL)},
    ],
)
def test_what_is_read_is_written_and_read_again(write, tmp_path, changes):
    folder = write(
        contacts_of(**changes),
        poses="top_height" in changes,
        constant_joints={"right_knee": {"value": 0.25, "sd": 0.01}},
        drop=("q.right_knee",),
        gains={"left_knee": 5000.0},
        tolerances={"encoder-offset": 0.001, "link-length": 0.0},
    )
    m = read_measurements(folder)
    assert (m.gains, m.tolerances) == ({"left_knee": 5000.0}, {"encoder-offset": 0.001, "link-length": 0.0})
    write_measurements(tmp_path / "again", m)
    assert_same(m, read_measurements(tmp_path / "again"))
    manifest = json.loads((tmp_path / "again" / "manifest.json").read_text())
    assert manifest["version"] == 2
    assert manifest["constant_joints"] == {"right_knee": {"value": 0.25, "sd": 0.01}}
    assert "plates" not in manifest
    assert "mapping" not in manifest


def test_version_one_is_written_as_before(plates, tmp_path):
    write_measurements(tmp_path / "one", plates)
    manifest = json.loads((tmp_path / "one" / "manifest.json").read_text())
    keys = ["format", "version", "robot", "joints", "plates", "weighed_mass", "gravity", "sensors"]
    assert list(manifest) == [*keys, "created", "software", "tables"]
    assert manifest["version"] == 1


def test_four_corner_cells_are_the_case_of_version_one(write, plates):
    cells = json.loads((EXAMPLE / "manifest.json").read_text())["plates"]["right"]["cells"]
    entries = [
        {"name": side, "kind": "cells", "cells": cells, "top_height": 0.05} for side in ("left", "right")
    ]
    columns = {k: v for k, v in plates.columns().items() if k.startswith("cell.")}
    m = read_measurements(write(entries, columns))
    assert m.contacts is None
    assert_same(m, plates)


def three_cells(m):
    """Three cells a board that carry the wrench of the board's four, by name, and their places."""
    places = {"a": [0.2, 0.0], "b": [-0.1, 0.15], "c": [-0.1, -0.15]}
    system = np.array([[1.0, x, y] for x, y in places.values()]).T
    columns = {}
    for p, side in enumerate(("right", "left")):
        forces = m.cell_forces[:, 4 * p : 4 * p + 4]
        moments = np.column_stack([forces.sum(axis=1), forces @ m.cells[p]])
        for k, name in enumerate(places):
            columns[f"cell.{side}.{name}"] = np.linalg.solve(system, moments.T)[k]
    return places, columns


def pressure(m):
    """Centre of pressure of vertical wrenches on the ground, (m, 2) [m], from first principles."""
    total, moment = np.zeros(len(m)), np.zeros((len(m), 2))
    for p in (0, 1):
        x, y, yaw = m.plate_poses[:, p].T
        fz, mx, my = m.wrenches[:, p].T
        a, b, c, s = -my / fz, mx / fz, np.cos(yaw), np.sin(yaw)
        total, moment = total + fz, moment + (fz * np.array([x + c * a - s * b, y + s * a + c * b])).T
    return moment / total[:, None]


def test_other_cells_are_read_as_vertical_wrenches(write, plates):
    places, columns = three_cells(plates)
    entries = [{"name": s, "kind": "cells", "cells": places, "top_height": 0.05} for s in ("right", "left")]
    m: Any = read_measurements(write(entries, columns))
    assert m.contacts.channels == VERTICAL
    assert m.contacts.mount == "ground"
    assert m.top_height.tolist() == [0.05, 0.05]
    assert pressure(m) == pytest.approx(center_of_pressure(plates), abs=1e-12)
    # Noise of the cells, drawn, gives the stated covariance of a wrench.
    noise = plates.sensors.cell_sd * np.random.default_rng(3).standard_normal((200_000, 3))
    at = np.array(list(places.values()))
    drawn = np.cov(np.column_stack([noise.sum(axis=1), noise @ at[:, 1], -noise @ at[:, 0]]).T)
    assert m.contacts.covariance == pytest.approx(drawn, rel=0.02, abs=0.01)


def test_centres_of_pressure_are_read_as_vertical_wrenches(write, plates):
    wrenches, columns, sd = readings(plates), {}, [0.002, 0.003, 0.5]
    for side in ("right", "left"):
        fz, mx, my = (wrenches[f"wrench.{side}.{c}"] for c in VERTICAL)
        columns |= {f"cop.{side}.x": -my / fz, f"cop.{side}.y": mx / fz, f"cop.{side}.fz": fz}
    entries = [
        {"name": s, "kind": "cop", "mount": "ground", "top_height": 0.05, "sd": sd} for s in ("right", "left")
    ]
    m: Any = read_measurements(write(entries, columns))
    assert pressure(m) == pytest.approx(center_of_pressure(plates), abs=1e-12)
    drawn, generator = [], np.random.default_rng(4)
    for side in ("right", "left"):
        mean = [columns[f"cop.{side}.{axis}"].mean() for axis in ("x", "y", "fz")]
        x, y, fz = np.add(mean, np.multiply(sd, generator.standard_normal((200_000, 3)))).T
        drawn.append(np.cov(np.array([fz, y * fz, -x * fz])))
    assert m.contacts.covariance == pytest.approx(np.mean(drawn, axis=0), rel=0.02, abs=0.003)
    folder = write([entry | {"mount": "foot", "pose": POSE} for entry in entries], columns)
    refuse("expected no key 'top_height' with mount 'foot'", read_measurements, folder)


def test_a_foot_in_the_air_may_lack_its_reading(write, plates, tmp_path):
    columns = readings(plates)
    support = np.where(np.arange(len(plates)) == 4, "right", "double")
    left = {name: np.where(support == "right", np.nan, v) for name, v in columns.items() if "left" in name}
    columns |= left
    folder = write(contacts_of(), columns | {"support": support})
    m: Any = read_measurements(folder)
    assert np.isnan(m.wrenches[4, 1]).all()
    assert np.isfinite(np.delete(m.wrenches, 4, axis=0)).all()
    write_measurements(tmp_path / "again", m)
    assert_same(m, read_measurements(tmp_path / "again"))
    broken = replace(m, support=np.full(len(m), "double"))
    refuse("measurements: column 'wrench.left.fx', row 5: found nan", check_contract, broken)
    columns["wrench.left.fz"][4] = 0.2
    some = write(contacts_of(), columns | {"support": support})
    words = "column 'wrench.left.fx', row 5: found nothing, expected all of the contact's readings"
    refuse(words, read_measurements, some)


def test_a_table_keeps_its_own_names_units_and_signs(write, plates):
    columns = readings(plates)
    own = {
        "RKnee [deg]": -np.rad2deg(plates.joint_angles[:, plates.joints.index("right_knee")]),
        "F1": columns["wrench.right.fz"] / 9.81,
        "M1": -1e3 * columns["wrench.right.mx"],
        "no": plates.posture,
        "clock": plates.time / 60,
    }
    mapping = {
        "q.right_knee": {"column": "RKnee [deg]", "unit": "deg", "sign": -1},
        "wrench.right.fz": {"column": "F1", "unit": "kg"},
        "wrench.right.mx": {"column": "M1", "unit": "Nmm", "sign": -1},
        "posture": {"column": "no"},
        "time": {"column": "clock", "unit": "min"},
    }
    direct = read_measurements(write(contacts_of()))
    folder = write(contacts_of(), columns | own, drop=tuple(mapping), mapping=mapping)
    mapped = read_measurements(folder)
    for name in ("joint_angles", "wrenches", "time"):
        assert getattr(mapped, name) == pytest.approx(getattr(direct, name), rel=1e-12, abs=1e-12)
    assert mapped.posture.tolist() == direct.posture.tolist()
    write_measurements(folder.parent / "plain", mapped)
    again = read_measurements(folder.parent / "plain")
    assert "mapping" not in json.loads((folder.parent / "plain" / "manifest.json").read_text())
    assert_same(mapped, again)


@rows("contract of contacts")
def test_contacts_in_memory_are_held_against_the_contract(write, changes, words):
    m = read_measurements(write(contacts_of(), poses=False))
    check_contract(m)
    refuse(words, check_contract, eval(changes[0], {"m": m, "replace": replace, "np": np}))


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_change_of_the_contacts_is_read_or_refused_in_one_line(write, plates, data):
    kinds: dict[str, dict[str, Any]] = {
        "wrench": STATED,
        "cop": {"sd": [0.1, 0.1, 1.0], "mount": "ground", "top_height": 0.0},
        "cells": {"cells": {"a": [0.0, 0.0], "b": [1.0, 0.0], "c": [0.0, 1.0]}, "top_height": 0.0},
    }
    kind = data.draw(st.sampled_from(sorted(kinds)))
    plain = [{"name": side, "kind": kind} for side in ("right", "left")]
    entries = [one | kinds[kind] for one in (contacts_of() if kind == "wrench" else plain)]
    document = {
        "contacts": json.loads(json.dumps(entries)),
        "mapping": {"q.right_knee": {"column": "F1", "unit": "deg", "sign": -1}},
        "constant_joints": {"left_knee": {"value": 0.1, "sd": 0.1}},
    }
    columns = readings(plates) | {"F1": np.rad2deg(plates.joint_angles[:, 3])} | three_cells(plates)[1]
    for side in ("right", "left"):
        columns |= {f"cop.{side}.{axis}": columns[f"wrench.{side}.fz"] / 1e3 for axis in ("x", "y")}
        columns[f"cop.{side}.fz"] = columns[f"wrench.{side}.fz"]
    drop = ("q.right_knee", "q.left_knee")
    changed_anywhere(document, data.draw)
    folder = write(document.pop("contacts", None), columns, drop, **document)
    read = read_or_refused(lambda: read_measurements(folder))
    assert read is None or len(read)
