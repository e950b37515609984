"""Records: what is written is read, from memory or from a folder; damaged folders are refused in words."""

import copy
import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.test_view import run  # noqa: F401
from tulip_testbed.base.document import Document
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import sha256
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.experiments.discovery_record import discovery_record, read_discovery, write_discovery
from tulip_testbed.experiments.estimate_report import ParameterRow
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.montecarlo.montecarlo_run import Place, montecarlo
from tulip_testbed.experiments.montecarlo.settings import Settings
from tulip_testbed.experiments.records import read_record, record_of
from tulip_testbed.experiments.run_file import kind_of
from tulip_testbed.experiments.settings_table import settings_tables
from tulip_testbed.experiments.validate import judge
from tulip_testbed.experiments.validation_record import ValidationRecord, read_validation, write_validation
from tulip_testbed.experiments.validation_result import validation_record
from tulip_testbed.pages.report_page import page_of, write_page
from tulip_testbed.pages.words import NO_TRUE_COM
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.sim.robot import Robot
from tulip_testbed.viewer import window
from tulip_testbed.viewer.record_view import record_view
from tulip_testbed.viewer.subject import validated

GONE = object()
VALUES = (GONE, None, -1, 1e300, "\x1b[2J", [], {}, [None], {"": None})
SEED = 141
DATA = Path(__file__).parent / "data"


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


@pytest.mark.parametrize("name", ["run", "montecarlo"])
def test_no_run_file_breaks_the_reader(name, run, coverage, robot, empty):  # noqa: F811
    folder = {"run": run, "montecarlo": coverage}[name]
    document = json.loads((folder / "run.json").read_text())
    tried = 0
    for changed in mutations(document):
        (empty / "run.json").write_text(json.dumps(changed))
        with pytest.raises(InputError):
            read_record(empty, robot)
        settings_tables(changed)
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
                read_validation(other, robot)


def test_outputs_lie_in_the_folder(run, robot, tmp_path):  # noqa: F811
    shutil.copytree(run, tmp_path / "run")
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    document["outputs"]["../elsewhere"] = "0"
    (tmp_path / "run" / "run.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"'\.\./elsewhere'"):
        read_validation(tmp_path / "run", robot)


@pytest.fixture(scope="module")
def static(static_run) -> ValidationRecord:
    return validation_record(judge(static_run))


def same(first, second) -> bool:
    """Documents and arrays alike; in memory nothing is known of hashes and folders."""
    if isinstance(first, Document):
        unknown = dict.fromkeys(("outputs", "rig"))
        return first.plain() | unknown == second.plain() | unknown
    if isinstance(first, Robot | Path | None):
        return True
    if dataclasses.is_dataclass(first):
        names = [field.name for field in dataclasses.fields(first)]
        return all(same(getattr(first, name), getattr(second, name)) for name in names)
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, np.ndarray) and first.dtype.kind == "f":
        return np.array_equal(first, second, equal_nan=True)
    return np.array_equal(first, second)


def same_page(first, second) -> bool:
    """All but title and settings, which hold the folder's name and hashes."""
    return first.sections[:-1] == second.sections[:-1] and first.facts == second.facts


def test_a_validation_in_memory_is_the_one_in_its_folder(moved_wii, robot, tmp_path):
    memory = validation_record(moved_wii)
    written = write_validation(tmp_path / "run", memory)
    read = read_validation(tmp_path / "run", robot)
    assert same(memory, read)
    assert written.document == read.document
    assert (written.report, written.truth, written.folder) == (read.report, read.truth, read.folder)
    for name, document in {"report.json": memory.report, "truth.json": memory.truth}.items():
        assert json.loads((tmp_path / "run" / name).read_text()) == document.plain()
    assert same_page(page_of(memory), page_of(read))


# Below these keys stand names that depend on the run.
OPEN = (
    *("base_parameters", "correlations", "failures", "files", "inputs", "outputs", "plan", "software"),
    "cell_gain",
)


def key_paths(value, path=""):
    """Paths of all keys of a JSON document, # for any place in a list."""
    if isinstance(value, dict) and path.rpartition(".")[2] not in OPEN:
        return {p for key, inner in value.items() for p in key_paths(inner, f"{path}.{key}")}
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return {p for item in value for p in key_paths(item, f"{path}.#")}
    return {path}


def test_the_keys_on_disk_are_those_of_version_2(moved_wii, discovered, robot, plan, tmp_path):
    """Whoever renames a field in memory does not rename a key in everybody's files."""
    write_validation(tmp_path / "validation", validation_record(moved_wii))
    checked = dataclasses.replace(discovered, check=DynamicsCheck(2, 3, 0.1, (1.0, 0.5), ""))
    write_discovery(tmp_path / "discovery", discovery_record(checked))
    settings = Settings(30, SEED, "mixed-model", None, imperfections=0)
    montecarlo(Laboratory(robot, "wii"), plan, settings, Place(tmp_path / "montecarlo", 1, None))
    expected: dict[str, set[str]] = {}
    for line in (DATA / "record_keys.txt").read_text().splitlines():
        name, path = line.split(" ")
        expected.setdefault(name, set()).add(f".{path}")
    assert len(expected) == 8
    for name, paths in expected.items():
        assert key_paths(json.loads((tmp_path / name).read_text())) == paths, name


def test_the_same_run_gives_the_same_bytes(static, static_run, tmp_path):
    """All but what is a time: of the work and of the manifest."""
    first = write_validation(tmp_path / "first", static).document.outputs
    again = static_run.laboratory.run(static_run.plan, static_run.seed, "statics")
    second = write_validation(tmp_path / "second", validation_record(judge(again))).document.outputs
    assert first.keys() == second.keys()
    timed = ("report.json", "measurements/manifest.json")
    assert all(first[name] == second[name] for name in first if name not in timed)


def test_a_discovery_in_memory_is_the_one_in_its_folder(discovered, robot, tmp_path):
    memory = discovery_record(discovered)
    assert memory.report.rig is None
    written = write_discovery(tmp_path / "found", memory)
    read = read_discovery(tmp_path / "found", robot)
    assert same(memory, read)
    assert same_page(page_of(memory), page_of(read))
    assert written.document == read.document
    assert written.report == read.report
    assert read.report.rig == str(tmp_path / "found" / "rig")
    with pytest.raises(InputError, match="exists already"):
        write_discovery(tmp_path / "found", memory)


def test_a_monte_carlo_in_memory_is_the_one_in_its_folder(robot, plan, tmp_path):
    laboratory, settings = Laboratory(robot, "wii"), Settings(30, SEED, "mixed-model", None, imperfections=0)
    memory = record_of(montecarlo(laboratory, plan, settings, Place(tmp_path / "runs", 1, None)))
    read = read_record(tmp_path / "runs", robot)
    assert same(memory, read)
    assert same_page(page_of(memory), page_of(read))
    assert isinstance(read, MonteCarlo)
    assert json.loads((tmp_path / "runs" / "report.json").read_text()) == read.to_json()


def test_any_result_in_memory_has_a_page_and_a_view(static_run, discovered, robot, plan, tmp_path):
    settings = Settings(10, SEED, "mixed-model", None, imperfections=0)
    repeated = montecarlo(Laboratory(robot, "wii"), plan, settings, Place(tmp_path / "runs", 1, None))
    for kind, result in {"validation": static_run, "discovery": discovered, "Monte Carlo": repeated}.items():
        record = record_of(result)
        page = write_page(tmp_path / f"{kind}.html", record)
        assert page.title == f"TULip: {kind}"
        assert page.verdict == (record if isinstance(record, MonteCarlo) else record.report).verdict
        view = record_view(record)
        assert view.title == f"TULip ({kind})"
        assert window.save(tmp_path / f"{kind}.rrd", view.title, view.log) > 1e5
        with pytest.raises(InputError, match="exists already"):
            write_page(tmp_path / f"{kind}.html", record)


def test_a_run_of_the_statics_says_that_it_has_no_true_centre_of_mass(static):
    assert static.report.books is None
    assert static.truth.com is None
    page = page_of(static)
    assert any(NO_TRUE_COM in section.paragraphs for section in page.sections)
    assert "CoM, truth" not in "".join(figure.json for part in page.sections for figure in part.figures)
    subject = validated(static)
    assert set(subject.com) == {"estimate", "nominal model"}
    assert NO_TRUE_COM in subject.notes


def changed(document, path, value):
    """A copy with another value at a path; GONE removes it."""
    document = copy.deepcopy(document)
    *way, last = path
    place = document
    for key in way:
        place = place[key]
    if value is GONE:
        del place[last]
    else:
        place[last] = value
    return document


EDITED = [
    ("report.json", ("verdict",), "maybe", "key 'verdict': found 'maybe'; expected 'pass' or 'fail'"),
    ("report.json", ("checks", 0, "result"), None, "key 'checks.0.result': found None"),
    ("report.json", ("checks", 4, "threshold"), [-1.0], "key 'checks.4.threshold"),
    ("report.json", ("checks", 1, "name"), "total mass", "key 'checks': found"),
    ("report.json", ("total_mass", "truth"), "23", "key 'total_mass.truth': found '23'"),
    ("report.json", ("total_mass",), GONE, "key 'total_mass': found nothing"),
    ("report.json", ("full", "parameters", 3, "estimate"), GONE, "key 'full.parameters.3.estimate': found"),
    ("report.json", ("full", "parameters", 3, "truth"), None, "key 'full.parameters.3.truth': found None"),
    ("report.json", ("full", "parameters", 24), GONE, "key 'full.parameters': found 24 rows, expected 25"),
    ("report.json", ("simplified", "parameters", 0, "number"), 7, "key 'simplified.parameters.0': found"),
    ("report.json", ("full", "parameters", 9, "name"), "x", "key 'full.parameters.9': found parameter 10, x"),
    ("report.json", ("full", "placement_sd_mm"), [1.0], "key 'full.placement_sd_mm'"),
    ("report.json", ("dropped",), [[1, "tipped"]], "key 'dropped.0'"),
    ("truth.json", ("version",), 2, "key 'version': found 2; expected 1"),
    ("truth.json", ("attempts", 0, "com"), [0.1], "key 'attempts.0.com'"),
    ("truth.json", ("attempts", 0, "com"), GONE, "key 'attempts.0': found"),
    ("truth.json", ("attempts", 0, "posture"), 77, "found other postures than in the measurements"),
    ("truth.json", ("standard_parameters", 2), [1.0, 0.0, 0.0], "key 'standard_parameters.2'"),
    ("truth.json", ("links",), ["torso"], "key 'links'"),
]


@pytest.mark.parametrize(("name", "path", "value", "message"), EDITED)
def test_an_edited_validation_is_refused(run, robot, tmp_path, name, path, value, message):  # noqa: F811
    """Edited by hand, with the hash put right."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    document = json.loads((folder / name).read_text())
    (folder / name).write_text(json.dumps(changed(document, path, value)))
    _put_right(folder, name)
    with pytest.raises(InputError, match=f"{re.escape(name)}: {re.escape(message)}"):
        read_validation(folder, robot)


EDITED_DISCOVERY = [
    (("verdict",), "found", "key 'verdict': found 'found'"),
    (("candidates", 0, "log_bayes_factor"), None, "key 'candidates.0.log_bayes_factor': found None"),
    (("candidates", 0, "parameters", 0, "value"), "0", "key 'candidates.0.parameters.0.value': found '0'"),
    (("candidates", 0, "parameters", 0, "unit"), GONE, "key 'candidates.0.parameters.0.unit': found nothing"),
    (("gap", "C", "floor"), GONE, "key 'gap.C.floor': found nothing"),
    (("gap", "B"), None, "key 'gap.B"),
    (("noise", "placement_sd"), [1e-3], "key 'noise.placement_sd'"),
    (("noise", "encoder_sd"), 1e300, "key 'noise.encoder_sd': found 1e+300"),
    (("repeats", "p"), {}, "key 'repeats': found"),
    (("parameters", 24), GONE, "key 'parameters': found 24 rows, expected 25"),
    (("parameters", 0, "name"), "head.x", "key 'parameters.0': found parameter 1, head.x, expected 1"),
    (("story",), [], "key 'story'"),
    (("check",), {"reason": None}, "keys 'check.postures', 'check.tried'"),
]


def test_another_run_is_no_discovery(run, plan, robot, tmp_path):  # noqa: F811
    with pytest.raises(InputError, match="run folder of a validation, expected that of a discovery"):
        read_discovery(run, robot)
    write_plan(tmp_path / "plan", plan)
    with pytest.raises(InputError, match="found a plan folder, expected a run folder"):
        read_discovery(tmp_path / "plan", robot)


@pytest.mark.parametrize(("path", "value", "message"), EDITED_DISCOVERY)
def test_an_edited_discovery_is_refused_by_key(discovered, robot, tmp_path, path, value, message):
    folder = tmp_path / "found"
    write_discovery(folder, discovery_record(discovered))
    document = json.loads((folder / "discovery.json").read_text())
    (folder / "discovery.json").write_text(json.dumps(changed(document, path, value)))
    _put_right(folder, "discovery.json")
    with pytest.raises(InputError, match=f"discovery.json: {re.escape(message)}"):
        read_discovery(folder, robot)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("full_mm", "whole_mm", "column 'full_mm' is missing"),
        ("\r\n1,1,", "\r\n1,1,x", "column 'full_mm': found string, expected numbers"),
        ("\r\n1,1,", "\r\n1,1,2.0,2.0\r\n1,1,", "rows, expected"),
    ],
)
def test_an_edited_table_is_refused(static, robot, tmp_path, old, new, message):
    folder = tmp_path / "run"
    write_validation(folder, static)
    table = folder / "residuals.csv"
    text = table.read_bytes().decode()
    assert old in text
    table.write_bytes(text.replace(old, new, 1).encode())
    _put_right(folder, "residuals.csv")
    with pytest.raises(InputError, match=f"residuals.csv: .*{message}"):
        read_validation(folder, robot)


def _put_right(folder, name):
    document = json.loads((folder / "run.json").read_text())
    document["outputs"][name] = sha256(folder / name)
    (folder / "run.json").write_text(json.dumps(document))


def test_keys_that_nobody_knows_are_kept(run, robot, tmp_path):  # noqa: F811
    """As another version might write them."""
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    document = json.loads((folder / "report.json").read_text()) | {"weather": {"sky": "blue"}}
    (folder / "report.json").write_text(json.dumps(document))
    _put_right(folder, "report.json")
    assert read_validation(folder, robot).report.plain() == document


def test_what_is_infinite_or_undefined_is_null_on_disk(static, robot, tmp_path):
    """An estimate of exactly 0 has no relative standard error."""
    first, *others = static.report.full.parameters
    row = ParameterRow.model_validate(first.plain() | {"relative_standard_error": np.inf})
    full = static.report.full.model_copy(update={"parameters": [row, *others]})
    record = dataclasses.replace(static, report=static.report.model_copy(update={"full": full}))
    write_validation(tmp_path / "run", record)
    assert read_validation(tmp_path / "run", robot).report.full.parameters[0].relative_standard_error is None


def test_a_monte_carlo_with_another_plan_or_more_runs_than_anybody_makes_is_refused(robot, plan, tmp_path):
    """run.json lists no hashes of the runs' files: the plan has its own, and a number of runs is bounded."""
    folder = tmp_path / "runs"
    montecarlo(
        Laboratory(robot, "wii"),
        plan,
        Settings(2, SEED, "least-squares", None, imperfections=0),
        Place(folder, 1, None),
    )
    shutil.copytree(folder, tmp_path / "more")
    document = json.loads((folder / "run.json").read_text())
    document["settings"]["runs"] = 10**13
    (tmp_path / "more" / "run.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"run\.json: key 'settings\.runs': found 10000000000000"):
        read_record(tmp_path / "more", robot)
    shutil.rmtree(folder / "plan")
    write_plan(folder / "plan", plan.take(plan.placement <= 20))
    with pytest.raises(InputError, match=r"plan: hash mismatch: found a plan with sha256"):
        read_record(folder, robot)
