"""Broken folders and robots end in a right result or in one message: a part of `make study-fuzz`."""

import json
import math
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from studies.study_fuzz import cases_of
from tests.fuzz.runner import Bases, run_cases
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.table import printable
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import write_measurements
from tulip_testbed.sim.measurements.table_files import MOST_DEPTH, Table, read_json
from tulip_testbed.sim.robot import load_robot, load_spec
from tulip_testbed.sim.shipped import ASSETS

HEAVY = ("rows_that_take_no_space", "a_table_that_unpacks_hugely", "models_without_end")
ONLY_ON_PLATES = (  # `tulip model`, the one call of the brief study, does not see these
    *("paths_that_lead_elsewhere", "scenes_that_cannot_be", "drives_that_cannot_be"),
    *("strange_xml_text", "strange_drives", "scenes_that_are_built"),
)
TULIP = ASSETS / "tulip_mjcf"

quick = settings(
    max_examples=50,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.fixture(scope="module")
def bases(wii, plan, tmp_path_factory):
    from tulip_testbed.sim.measurements import write_plan

    place = tmp_path_factory.mktemp("bases")
    write_measurements(place / "data", wii.run.measurements)
    write_plan(place / "plan", plan.take(np.arange(30)))
    return Bases(place / "data", place / "plan", TULIP, place / "plan")


def test_a_hundred_folders_and_thirty_robots(bases):
    cases = [case for case in cases_of(108, 42, seed=200) if case.mutation not in HEAVY + ONLY_ON_PLATES]
    outcomes = list(run_cases(cases, bases, workers=2, brief=True))
    assert len(outcomes) == len(cases)
    assert sum(case.target != "robot" for case in cases) >= 100
    assert sum(case.target == "robot" for case in cases) >= 30
    assert [outcome for outcome in outcomes if outcome.failed] == []
    results = [outcome.result for outcome in outcomes]
    assert min(results.count("accepted"), results.count("refused")) > 20


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@quick
@given(content=st.dictionaries(st.text(), json_values))
def test_any_json_is_read_exactly_or_refused(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(content))
    try:
        assert read_json(path) == content
    except InputError as error:
        text = str(error)
        reasons = ("finite", "surrogate", "digits", "nested")
        assert text.startswith(str(path)), text
        assert any(reason in text for reason in reasons), text


@quick
@given(content=st.binary(max_size=200))
def test_any_bytes_are_no_json_but_a_message(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    message = ""
    try:
        assert isinstance(read_json(path), dict)
    except InputError as error:
        message = str(error)
    assert message == "" or str(path) in message


@pytest.mark.parametrize("depth", [MOST_DEPTH - 1, MOST_DEPTH + 1, 1_000, 100_000])
def test_depth_is_limited_before_anything_recurses(tmp_path, depth):
    path = tmp_path / "a.json"
    path.write_text('{"a": ' + "[" * (depth - 1) + "]" * (depth - 1) + "}")
    if depth < MOST_DEPTH:
        assert read_json(path)
        return
    with pytest.raises(InputError, match=r"a.json: nested deeper than 32 levels"):
        read_json(path)


@quick
@given(
    values=st.lists(st.floats(width=64) | st.none(), min_size=1, max_size=5),
    low=st.floats(-1e6, 0),
    high=st.floats(0, 1e6),
)
def test_numbers_are_finite_and_within_their_limits_or_refused_by_row(tmp_path, values, low, high):
    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(pa.table({"x": pa.array(values, pa.float64())}), path)
    wrong = [k for k, v in enumerate(values) if v is None or not math.isfinite(v)]
    outside = [k for k, v in enumerate(values) if v is not None and not low <= v <= high]
    table = Table(path, path.read_bytes())
    if wrong or outside:
        with pytest.raises(
            InputError, match=rf"a.parquet: column 'x', row {(wrong or outside)[0] + 1}: found"
        ):
            table.numbers("x", low=low, high=high)
    else:
        assert table.numbers("x", low=low, high=high).tolist() == values


@quick
@given(text=st.text(st.characters(exclude_categories=())))
def test_messages_neither_steer_a_terminal_nor_fail_to_print(text):
    shown = printable(text)
    assert shown.isprintable()
    shown.encode()


# --- the robot's files -------------------------------------------------------------------------


@pytest.fixture
def robot_folder(tmp_path):
    shutil.copytree(TULIP, tmp_path / "robot")
    return tmp_path / "robot"


def replace(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def refusal(capsys, *arguments):
    assert main([str(a) for a in arguments]) == 2
    return " ".join(capsys.readouterr().err.split())


def test_an_mjcf_may_lie_beside_the_folder_of_its_meshes_but_not_outside_the_robot_s(robot_folder):
    """robot/mjcf/robot.xml with meshdir ../meshes is how many robots come."""
    (robot_folder / "mjcf").mkdir()
    (robot_folder / "meshes").mkdir()
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (robot_folder / "meshes" / "a.obj").write_text(tetrahedron)
    shutil.move(robot_folder / "tulip.xml", robot_folder / "mjcf" / "tulip.xml")
    path = robot_folder / "mjcf" / "tulip.xml"
    replace(path, "<compiler ", '<compiler meshdir="../meshes" ')
    replace(path, "<asset>", '<asset><mesh name="a" file="a.obj"/>')
    replace(robot_folder / "tulip.toml", '"tulip.xml"', '"mjcf/tulip.xml"')
    assert load_robot(robot_folder / "tulip.toml").visual_model.nmesh == 1
    with pytest.raises(InputError, match=r"attribute 'meshdir': found '../meshes', expected a path inside"):
        load_spec(path)
    replace(path, "../meshes", "../../meshes")
    with pytest.raises(InputError, match=r"line \d+, <compiler>, attribute 'meshdir'"):
        load_robot(robot_folder / "tulip.toml")


def test_what_would_crash_mujoco_is_one_message(robot_folder, capsys):
    """A model that attaches itself makes MuJoCo 3.17 crash; here by a detour that only MuJoCo follows."""
    replace(robot_folder / "tulip.xml", "<asset>", '<asset><model name="m" file="tulip.xml"/>')
    message = refusal(capsys, "model", "--robot", robot_folder / "tulip.toml")
    assert "tulip.xml: broken MJCF: includes itself (tulip.xml -> tulip.xml)" in message


def test_a_crash_and_an_endless_compilation_are_survived(robot_folder, monkeypatch):
    from tulip_testbed.sim import sandbox as trial

    path = robot_folder / "tulip.xml"
    monkeypatch.setattr(trial, "CHILD", "import os; os.abort()")
    with pytest.raises(
        InputError, match=r"tulip.xml: broken MJCF: MuJoCo crashed while compiling it \(SIGABRT\)"
    ):
        trial.try_to_compile(path, {path: "crash"})
    monkeypatch.setattr(trial, "CHILD", trial.CHILD.replace("os.abort()", "os.kill(os.getpid(), 24)"))
    with pytest.raises(InputError, match="MuJoCo did not compile it within 20 s of processor time"):
        trial.try_to_compile(path, {path: "endless"})


def test_an_unknown_key_in_planning_is_refused_at_load(robot_folder, capsys):
    replace(robot_folder / "tulip.toml", "swing_x =", "swing_q =")
    for command in (["model"], ["identify", "nowhere"], ["postures"], ["simulate", "--out", "x"]):
        message = refusal(capsys, *command, "--robot", robot_folder / "tulip.toml")
        assert "tulip.toml: [planning]: unknown key 'swing_q'; valid: swing_x" in message


def test_a_plan_too_small_or_too_uniform_is_refused_before_it_is_written(robot_folder, tmp_path, capsys):
    out = tmp_path / "plan"
    draw = ["postures", "--random", "--out", out, "--placements", "2", "--per-placement"]
    assert "--placements, --per-placement: found 12 postures, too few for 25" in refusal(capsys, *draw, "6")
    replace(robot_folder / "tulip.toml", "torso_yaw_deg = [-20, 20]", "torso_yaw_deg = [0, 0]")
    replace(robot_folder / "tulip.toml", "swing_yaw_deg = [-30, 30]", "swing_yaw_deg = [0, 0]")
    message = refusal(capsys, *draw, "10", "--robot", robot_folder / "tulip.toml")
    assert f"{out}: the postures determine" in message
    assert "not determined separately" in message
    assert not out.exists()
