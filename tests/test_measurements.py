"""The data contract: round trips, and everything that breaks it is named."""

import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import sha256
from tulip_testbed.experiments.check_folder import check_folder
from tulip_testbed.experiments.identify import identify
from tulip_testbed.measurements import read_measurements, write_measurements
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.plan_folder import read_plan, write_plan


@pytest.fixture
def folder(wii, tmp_path):
    write_measurements(tmp_path / "data", wii.measurements)
    return tmp_path / "data"


def rewrite(folder, change, name="postures"):
    """Change the Parquet table and keep the manifest's hash honest; the CSV goes."""
    path = folder / f"{name}.parquet"
    pyarrow.parquet.write_table(change(pyarrow.parquet.read_table(path)), path)
    (folder / f"{name}.csv").unlink()
    manifest = next(p for p in (folder / "manifest.json", folder / "plan.json") if p.exists())
    content = json.loads(manifest.read_text())
    content["tables"] = {path.name: sha256(path)}
    manifest.write_text(json.dumps(content))


def replace_column(table, name, values):
    return table.set_column(table.column_names.index(name), name, pa.array(values))


def same(first, second):
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if isinstance(a, np.ndarray):
            assert np.array_equal(a, b), field.name
        else:
            assert a == b, field.name


def test_round_trip_is_exact(wii, folder):
    same(wii.measurements, read_measurements(folder))


def test_csv_alone_says_the_same(wii, folder):
    (folder / "postures.parquet").unlink()
    same(wii.measurements, read_measurements(folder))


def test_an_edited_twin_is_not_passed_over(folder):
    """Whoever edits the CSV must not get the Parquet's results."""
    path = folder / "postures.csv"
    path.write_text(path.read_text().replace("double", "right", 1))
    with pytest.raises(InputError, match=r"postures\.csv: hash mismatch"):
        read_measurements(folder)


def test_twins_with_other_numbers_are_refused_even_if_both_hashes_are_right(folder):
    path = folder / "postures.csv"
    table = pyarrow.csv.read_csv(path)
    table = replace_column(table, "q.right_knee", table["q.right_knee"].to_numpy() + 0.1)
    pyarrow.csv.write_csv(table, path)
    content = json.loads((folder / "manifest.json").read_text())
    content["tables"][path.name] = sha256(path)
    (folder / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(
        InputError, match=r"postures\.csv: next to postures\.parquet: column 'q\.right_knee', row 1: found"
    ):
        read_measurements(folder)


@pytest.mark.parametrize("end", ["\r", "\r\n"])
def test_any_line_end_will_do(wii, folder, end):
    (folder / "postures.parquet").unlink()
    path = folder / "postures.csv"
    path.write_bytes(path.read_bytes().replace(b"\n", end.encode()))
    content = json.loads((folder / "manifest.json").read_text())
    content["tables"] = {path.name: sha256(path)}
    (folder / "manifest.json").write_text(json.dumps(content))
    same(wii.measurements, read_measurements(folder))


def test_optional_columns_may_be_absent_and_unknown_spreads_null(folder):
    def strip(table):
        table = table.select([n for n in table.column_names if not n.startswith(("motor.", "q_command."))])
        return replace_column(table, "q_std.left_knee", [None] * len(table))

    rewrite(folder, strip)
    measured = read_measurements(folder)
    assert measured.motor is None
    assert measured.command is None
    assert np.isnan(measured.joint_angles_sd[:, 9]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop_columns(["q.left_knee"]), r"postures.parquet: column 'q.left_knee' is missing"),
        (
            lambda t: replace_column(t, "cell.left.rear_left", [float("nan")] + [1.0] * (len(t) - 1)),
            r"column 'cell.left.rear_left', row 1: found nan, expected a finite number",
        ),
        (
            lambda t: replace_column(t, "q.right_knee", ["bent"] * len(t)),
            r"column 'q.right_knee': found string, expected numbers",
        ),
        (
            lambda t: replace_column(t, "support", ["both"] * len(t)),
            r"column 'support', row 1: found 'both', expected one of double, right, left",
        ),
        (
            lambda t: replace_column(t, "placement", [0.5] * len(t)),
            r"column 'placement', row 1: found 0.5, expected a whole number",
        ),
        (lambda t: t.slice(0, 0), r"found no rows"),
    ],
)
def test_a_broken_table_is_named(folder, change, message):
    rewrite(folder, change)
    with pytest.raises(InputError, match=message):
        read_measurements(folder)


def edit_manifest(folder, change):
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("gravity"), r"manifest.json: key 'gravity': found nothing"),
        (lambda m: m.update(format="other"), r"key 'format': found 'other'"),
        (lambda m: m["sensors"].pop("cell_sd"), r"key 'sensors.cell_sd': found nothing"),
        (lambda m: m["plates"]["left"]["cells"].pop("rear_left"), r"key 'plates.left.cells.rear_left'"),
        (lambda m: m["tables"].update({"postures.parquet": "0" * 64}), r"hash mismatch: found sha256"),
    ],
)
def test_a_broken_manifest_is_named(folder, change, message):
    edit_manifest(folder, change)
    with pytest.raises(InputError, match=message):
        read_measurements(folder)


def test_wrong_joint_order_is_refused(folder, robot):
    edit_manifest(folder, lambda m: m["joints"].reverse())
    with pytest.raises(
        InputError, match=r"key 'joints': found left_ankle_roll, .*expected the model's order right_hip_yaw"
    ):
        identify(read_measurements(folder), robot)


def test_another_model_is_refused(folder, robot):
    edit_manifest(folder, lambda m: m["robot"].update(sha256="0" * 64))
    with pytest.raises(InputError, match="hash mismatch of the robot's model"):
        identify(read_measurements(folder), robot)


def test_unknown_foot_is_refused(folder, robot):
    edit_manifest(folder, lambda m: m["robot"].update(stance_foot="left_foot"))
    with pytest.raises(
        InputError, match=r"key 'robot.stance_foot': found 'left_foot', expected 'right_foot'"
    ):
        identify(read_measurements(folder), robot)


def test_fewer_postures_than_parameters_are_refused(folder, robot):
    rewrite(folder, lambda t: t.slice(0, 12))
    with pytest.raises(InputError, match=r"found 12 postures .* expected at least 13 for 25 base parameters"):
        identify(read_measurements(folder), robot)


def test_truncated_parquet_and_missing_folder(folder, tmp_path):
    path = folder / "postures.parquet"
    path.write_bytes(path.read_bytes()[:500])
    edit_manifest(folder, lambda m: m["tables"].update({path.name: sha256(path)}))
    with pytest.raises(InputError, match=r"postures.parquet: broken table"):
        read_measurements(folder)
    with pytest.raises(InputError, match="no such measurement folder"):
        read_measurements(tmp_path / "nothing")


def test_plan_round_trip_and_limits(plan, robot, model, tmp_path):
    write_plan(tmp_path / "plan", plan)
    assert read_plan(tmp_path / "plan", robot).joint_angles.tobytes() == plan.joint_angles.tobytes()
    rewrite(tmp_path / "plan", lambda t: replace_column(t, "q.left_knee", [-0.2] * len(t)))
    with pytest.raises(
        InputError, match=r"column 'q.left_knee', row 1: found -0.2000 rad, expected within \[0.0000"
    ):
        read_plan(tmp_path / "plan", robot)


def test_a_failed_write_leaves_nothing(plan, tmp_path):
    broken = dataclasses.replace(plan, made={"objective": object()})
    with pytest.raises(TypeError):
        write_plan(tmp_path / "plan", broken)
    assert list(tmp_path.iterdir()) == []


def by_hand(folder, change=lambda manifest: None, name="postures.csv"):
    """Leave a folder as a person writes it: one CSV, and a manifest without hashes."""
    manifest = json.loads((folder / "manifest.json").read_text()) | {"tables": None}
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "postures.parquet").unlink()
    (folder / "postures.csv").rename(folder / name)


def refusal(folder):
    with pytest.raises(InputError) as error:
        read_measurements(folder)
    return str(error.value).replace(str(folder), "DATA")


def test_an_incomplete_folder_names_its_tables_and_what_lists_the_rest(folder):
    by_hand(folder, name="wednesday.csv")
    rest = "; found wednesday.csv; `tt.check('DATA')` lists all that is missing or wrong"
    assert (
        refusal(folder)
        == f"DATA: found neither postures.parquet nor postures.csv, expected one of them{rest}"
    )
    (folder / "manifest.json").unlink()
    assert refusal(folder) == f"DATA/manifest.json: missing{rest}"
    with pytest.raises(InputError, match=r"and the table as postures.csv; `tt.check\('.*data'\)` lists what"):
        read_measurements(folder / "wednesday.csv")


def test_all_missing_columns_are_named_and_close_ones_that_are_there(folder):
    by_hand(folder)
    path = folder / "postures.csv"
    path.write_text(
        path.read_text().replace("q.right_knee", "q.rightknee", 1).replace('"posture"', '"no"', 1)
    )
    assert "columns 'posture', 'q.right_knee' are missing (found 'q.rightknee'); `tt.check(" in refusal(
        folder
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda m: [m.pop(key) for key in ("gravity", "sensors")],
            "keys 'gravity', 'sensors': found nothing",
        ),
        (lambda m: m.update(gravity=981), "key 'gravity': found 981; expected 100 or less"),
        (lambda m: m.update(gravity="9.81"), "key 'gravity': found '9.81'; expected a number"),
        (lambda m: m.update(joints=[]), "key 'joints': found []; expected 1 or more values"),
        (lambda m: m.update(sensors=3), "key 'sensors': found 3; expected an object"),
        (lambda m: m["sensors"].update(placement_sd=0.001), "found 0.001; expected a list"),
        (lambda m: m["sensors"].update(cell_sd=1e-20), "found 1e-20; expected 0 or at least 1e-12"),
    ],
)
def test_the_manifests_faults_are_told_in_our_words(folder, change, message):
    by_hand(folder, change)
    assert message in refusal(folder)


def test_a_joint_that_is_missing_is_named_alone(folder, robot):
    by_hand(folder, lambda m: m["joints"].remove("left_ankle_roll"))
    with pytest.raises(InputError, match=r"key 'joints': missing: left_ankle_roll$"):
        identify(read_measurements(folder), robot)


def test_measurements_print_as_a_line_and_have_a_frame_with_the_folders_columns(wii, folder):
    measured = wii.measurements
    for shown in (measured, wii.simulation, Outcome(measured, wii.simulation), wii.plan):
        assert len(repr(shown).splitlines()) == 1, repr(shown)
        assert len(repr(shown)) < 250
    assert repr(measured).startswith(f"Measurements: {len(measured)} rows, ")
    assert repr(measured).endswith("on 30 placements, support double, robot tulip.xml")
    frame = measured.to_frame()
    assert list(frame) == pyarrow.parquet.read_table(folder / "postures.parquet").column_names
    assert (
        frame["q.right_knee"].tolist()
        == measured.joint_angles[:, measured.joints.index("right_knee")].tolist()
    )


def test_gains_are_read_and_written_back(folder, tmp_path):
    edit_manifest(folder, lambda m: m.update(gains={"right_knee": 5000.0}))
    measured = read_measurements(folder)
    assert measured.gains == {"right_knee": 5000.0}
    write_measurements(tmp_path / "again", measured)
    assert read_measurements(tmp_path / "again").gains == measured.gains
    edit_manifest(folder, lambda m: m.update(gains=None))
    assert read_measurements(folder).gains == {}


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"right_kne": 5000.0}, r"key 'gains': unknown joint 'right_kne'; did you mean 'right_knee'"),
        ({"right_knee": 0.0}, r"key 'gains.right_knee': found 0.0; expected more than 0"),
        ({"right_knee": "stiff"}, r"key 'gains.right_knee': found 'stiff'; expected a number"),
    ],
)
def test_impossible_gains_are_named(folder, gains, message):
    edit_manifest(folder, lambda m: m.update(gains=gains))
    with pytest.raises(InputError, match=message):
        read_measurements(folder)


def test_tolerances_are_read_and_written_back(wii, folder, tmp_path):
    assert "tolerances" not in json.loads((folder / "manifest.json").read_text())
    edit_manifest(folder, lambda m: m.update(tolerances={"encoder-offset": 0.001, "link-length": 0}))
    measured = read_measurements(folder)
    assert measured.tolerances == {"encoder-offset": 0.001, "link-length": 0.0}
    write_measurements(tmp_path / "again", measured)
    same(measured, read_measurements(tmp_path / "again"))
    edit_manifest(folder, lambda m: m.update(tolerances=None))
    assert read_measurements(folder).tolerances == {}
    broken = dataclasses.replace(measured, tolerances={"tilt": float("nan")})
    with pytest.raises(InputError, match=r"measurements: key 'tolerances.tilt': found nan"):
        write_measurements(tmp_path / "broken", broken)


@pytest.mark.parametrize(
    ("tolerances", "message"),
    [
        ([1], r"manifest.json: key 'tolerances': found \[1\]; expected an object"),
        ({"tilt": -1.0}, r"key 'tolerances.tilt': found -1.0; expected 0 or more"),
        ({"tilt": "small"}, r"key 'tolerances.tilt': found 'small'; expected a number"),
        ({"tilt": float("inf")}, r"found the number Infinity, expected a finite one"),
    ],
)
def test_impossible_tolerances_are_named(folder, tolerances, message):
    edit_manifest(folder, lambda m: m.update(tolerances=tolerances))
    with pytest.raises(InputError, match=message):
        read_measurements(folder)


def test_tolerances_of_unknown_families_are_refused(folder, robot):
    unknown = {"encoder-ofset": 0.001, "tilt": 50.0, "magic": 1.0}
    edit_manifest(folder, lambda m: m.update(tolerances=unknown))
    message = r"measurements: key 'tolerances': unknown family 'encoder-ofset'; did you mean 'encoder-offset'"
    with pytest.raises(InputError, match=message):
        identify(read_measurements(folder), robot)
    told = " ".join(check_folder(folder, robot).to_json()["complaints"]["manifest"])
    for part in ("unknown family 'encoder-ofset'", "unknown family 'magic'", "tilt: found 50.0, expected"):
        assert part in told
