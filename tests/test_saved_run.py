"""Run folders that were damaged or made up: refused in words, or read."""

import copy
import json
import shutil
from pathlib import Path

import pytest
from tulip_testbed.pages.page_tables import settings_table

from tests.test_view import calibration, run  # noqa: F401
from tulip_testbed.experiments.settings_table import settings_table
from tulip_testbed.sim.errors import InputError

GONE = object()
VALUES = (GONE, None, -1, 1e300, "\x1b[2J", [], {}, [None], {"": None})
READ = {"run": read_run, "montecarlo": read_montecarlo}


def mutations(document):
    """Every key of the first two levels, every value."""
    paths = [(key,) for key in document]
    paths += [(key, inner) for key, value in document.items() if isinstance(value, dict) for inner in value]
    for path in paths:
        if path[0] == "configuration" and len(path) == 2 and path[1] not in ("preset", "seed", "robot"):
            continue  # shown, not used
        for value in VALUES:
            changed = copy.deepcopy(document)
            place = changed
            for key in path[:-1]:
                place = place[key]
            if value is GONE:
                del place[path[-1]]
            else:
                place[path[-1]] = value
            yield changed


@pytest.fixture
def empty(tmp_path):
    """A folder for run.json alone: whatever passes it is refused for what is not there."""
    (tmp_path / "made_up").mkdir()
    return tmp_path / "made_up"


@pytest.mark.parametrize("name", READ)
def test_no_run_file_breaks_the_reader(name, run, calibration, robot, empty):  # noqa: F811
    folder = {"run": run, "montecarlo": calibration}[name]
    document = json.loads((folder / "run.json").read_text())
    tried = 0
    for changed in mutations(document):
        (empty / "run.json").write_text(json.dumps(changed))
        with pytest.raises(InputError):
            READ[run_kind(empty)](empty, robot)
        settings_table(changed)
        tried += 1
    assert tried > 100


@pytest.mark.parametrize("content", ["", "[]", "{", '{"format": 1}', '{"version": 1}', "\x00", '{"a": NaN}'])
def test_what_is_no_run_file(content, empty):
    (empty / "run.json").write_text(content)
    with pytest.raises(InputError, match=r"run\.json"):
        kind_of(empty)


def test_every_file_of_a_run_is_guarded(run, robot, tmp_path):  # noqa: F811
    """Changed, emptied or removed: each is noticed."""
    names = [path.relative_to(run) for path in sorted(run.rglob("*")) if path.is_file()]
    assert len(names) > 8
    for name in names:
        if name == Path("run.json"):
            continue
        for damage in ("changed", "emptied", "removed"):
            other = tmp_path / damage / str(name).replace("/", "-")
            shutil.copytree(run, other)
            content = (other / name).read_bytes()
            if damage == "removed":
                (other / name).unlink()
            else:
                (other / name).write_bytes(b"" if damage == "emptied" else content + b" ")
            with pytest.raises(InputError, match=name.name.replace(".", r"\.")):
                read_run(other, robot)


def test_outputs_lie_in_the_folder(run, robot, tmp_path):  # noqa: F811
    shutil.copytree(run, tmp_path / "run")
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    document["outputs"]["../elsewhere"] = "0"
    (tmp_path / "run" / "run.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"'\.\./elsewhere'"):
        read_run(tmp_path / "run", robot)
