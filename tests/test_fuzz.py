"""Broken folders and robots end in a right result or in one message (tests/fuzz)."""

import json
import math
from functools import partial

import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tulip_testbed as tt
from tests.fuzz.changes import drawn
from tests.fuzz.documents import json_values
from tests.fuzz.judge import KINDS, Judge
from tests.test_cli import refused
from tests.test_refusals import refuse
from tulip_testbed.base.table_files import MOST_DEPTH, TableFile, read_json

quick = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.mark.slow
def test_inputs_of_every_kind_end_in_a_right_result_or_in_one_message(tmp_path, subtests):
    judge, messages = Judge(tmp_path), []
    for target, kinds in KINDS.items():
        for kind in kinds:
            with subtests.test(target=target, kind=kind):
                messages += drawn(partial(judge.message, target, kind), 1, f"200 {target} {kind}")
    assert len(messages) > 150
    assert messages.count("") > 30


@quick
@given(content=st.dictionaries(st.text(), json_values) | st.binary(max_size=200))
def test_any_json_is_read_exactly_and_any_bytes_are_read_or_refused(tmp_path, content):
    path, binary = tmp_path / "a.json", isinstance(content, bytes)
    path.write_bytes(content if binary else json.dumps(content).encode())
    try:
        found = read_json(path)
    except tt.InputError as error:
        text, reasons = str(error), ("finite", "surrogate", "digits", "nested")
        assert text.startswith(str(path)), text
        assert binary or any(reason in text for reason in reasons), text
    else:
        assert isinstance(found, dict) if binary else found == content


@pytest.mark.parametrize("depth", [MOST_DEPTH - 1, MOST_DEPTH + 1, 1_000, 100_000])
def test_depth_is_limited_before_anything_recurses(tmp_path, depth):
    path = tmp_path / "a.json"
    path.write_text('{"a": ' + "[" * (depth - 1) + "]" * (depth - 1) + "}")
    if depth < MOST_DEPTH:
        assert read_json(path)
        return
    refuse("a.json: nested deeper than 32 levels", read_json, path)


@quick
@given(
    values=st.lists(st.floats(width=64) | st.none(), max_size=5),
    low=st.floats(-1e6, 0),
    high=st.floats(0, 1e6),
)
def test_numbers_are_finite_and_within_their_limits_or_refused_by_row(tmp_path, values, low, high):
    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(pa.table({"x": pa.array(values, pa.float64())}), path)
    wrong = [k for k, v in enumerate(values) if v is None or not math.isfinite(v)]
    outside = [k for k, v in enumerate(values) if v is not None and not low <= v <= high]
    refuse("a.parquet: broken table", TableFile, path, path.read_bytes()[:-4])
    if not values:
        refuse("a.parquet: found no rows", TableFile, path, path.read_bytes())
        return
    table = TableFile(path, path.read_bytes())
    if bad := wrong or outside:
        refuse(f"a.parquet: column 'x', row {bad[0] + 1}: found", table.numbers, "x", low=low, high=high)
    else:
        assert table.numbers("x", low=low, high=high).tolist() == values


def test_a_plan_too_small_or_too_uniform_is_refused_before_it_is_written(edited_tulip, tmp_path, capsys):
    out = tmp_path / "plan"
    draw = ["plan", "random", "--out", out, "--placements", "2", "--per-placement"]
    assert "found 12 postures, too few for 25" in refused(capsys, *draw, "6")
    ranges = {"torso_yaw_deg": "[-20, 20]", "swing_yaw_deg": "[-30, 30]"}
    still = [f"tulip.toml: {key} = {old} => {key} = [0, 0]" for key, old in ranges.items()]
    message = refused(capsys, *draw, "10", "--robot", edited_tulip(*still, built=False).path)
    assert f"{out}: the postures determine" in message
    assert "not determined separately" in message
    assert not out.exists()
