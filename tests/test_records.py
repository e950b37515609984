"""Records: what is written is read, from memory or from a folder; damaged folders are refused in words."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tulip_testbed as tt
from tests.first_look import cases
from tests.fuzz.documents import changed_anywhere, read_or_refused
from tests.test_refusals import change_document, refuse, rows
from tulip_testbed.base.files import sha256
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.experiments.saved_runs import RunResult, read_run
from tulip_testbed.experiments.validate import judge
from tulip_testbed.pages import NO_TRUE_COM
from tulip_testbed.pages.run_page import page_of, write_page
from tulip_testbed.sim.plan_folder import write_plan
from tulip_testbed.viewer import window
from tulip_testbed.viewer.run_view import view_of
from tulip_testbed.viewer.subject import validated

DATA = Path(__file__).parent / "data"


def test_every_file_of_a_run_is_guarded(run_folder, robot, tmp_path):
    """Changed, emptied or removed: each is noticed."""
    names = [path.relative_to(run_folder) for path in run_folder.rglob("*") if path.is_file()]
    names.remove(Path("run.json"))
    assert len(names) > 7
    for name in names:
        for damage in ("changed", "emptied", "removed"):
            other = tmp_path / damage / str(name).replace("/", "-")
            shutil.copytree(run_folder, other)
            content = (other / name).read_bytes()
            if damage == "removed":
                (other / name).unlink()
            else:
                (other / name).write_bytes(b"" if damage == "emptied" else content + b" ")
            with pytest.raises(tt.InputError, match=name.name.replace(".", r"\.")):
                tt.Validation.load(other, robot)


def test_outputs_lie_in_the_folder(run_folder, robot, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run")
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    document["outputs"]["../elsewhere"] = "0"
    (tmp_path / "run" / "run.json").write_text(json.dumps(document))
    refuse("'../elsewhere'", tt.Validation.load, tmp_path / "run", robot)


@pytest.fixture(scope="module")
def static(static_run) -> tt.Validation:
    return judge(static_run)


def same(first: RunResult, second: RunResult) -> bool:
    """Document, tables and settings alike; in memory nothing is known of hashes and folders."""
    documents = [result.to_json() | {"rig": None} for result in (first, second)]
    tables = [
        [str(part) for part in result.tables() if "Run folder" not in str(part)] for result in (first, second)
    ]
    made = [result.document.to_json() | {"outputs": {}} for result in (first, second)]
    return documents[0] == documents[1] and tables[0] == tables[1] and made[0] == made[1]


def same_page(first, second) -> bool:
    """All but title and settings, which hold the folder's name and hashes."""
    return first.sections[:-1] == second.sections[:-1] and first.facts == second.facts


def test_a_validation_in_memory_is_the_one_in_its_folder(moved_wii, robot, tmp_path):
    moved_wii.save(tmp_path / "run")
    read = tt.Validation.load(tmp_path / "run", robot)
    assert same(moved_wii, read)
    assert json.loads((tmp_path / "run" / "result.json").read_text()) == moved_wii.to_json()
    assert json.loads((tmp_path / "run" / "truth.json").read_text()) == moved_wii.simulation.to_json()
    manifest = (tmp_path / "run" / "measurements" / "manifest.json").read_text()
    assert not [word for word in ("seed", "preset", "truth", "command_sd", "plate_sd") if word in manifest]
    assert same_page(page_of(moved_wii), page_of(read))
    assert np.array_equal(read.identification.full.covariance, moved_wii.identification.full.covariance)
    assert repr(read.identification) == repr(moved_wii.identification)
    refuse("exists already", moved_wii.save, tmp_path / "run")


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


def test_the_keys_on_disk_are_those_of_version_2(run_folder, discovered, coverage, tmp_path):
    """Whoever renames a field in memory does not rename a key in everybody's files."""
    checked = dataclasses.replace(discovered, check=DynamicsCheck(2, 3, 0.1, (1.0, 0.5), ""))
    checked.save(tmp_path / "discovery")
    folders = {"validation": run_folder, "discovery": tmp_path / "discovery", "montecarlo": coverage}
    expected: dict[tuple[str, str], set[str]] = {}
    for line in (DATA / "record_keys.txt").read_text().splitlines():
        name, path = line.split(" ")
        kind, _, file = name.partition("/")
        expected.setdefault((kind, file), set()).add(f".{path}")
    assert len(expected) == 8
    for (kind, file), paths in expected.items():
        assert key_paths(json.loads((folders[kind] / file).read_text())) == paths, f"{kind}/{file}"


def test_the_same_run_gives_the_same_bytes(static, static_run, robot, tmp_path):
    """All but what is a time: of the work and of the manifest."""
    again = static_run.laboratory.run(static_run.plan, static_run.seed, "statics")
    static.save(tmp_path / "first")
    judge(again).save(tmp_path / "second")
    folders = (tmp_path / "first", tmp_path / "second")
    first, second = (tt.Validation.load(folder, robot).document.outputs for folder in folders)
    assert first.keys() == second.keys()
    timed = ("result.json", "measurements/manifest.json")
    assert all(first[name] == second[name] for name in first if name not in timed)


def test_a_discovery_in_memory_is_the_one_in_its_folder(discovered, robot, tmp_path):
    assert discovered.rig is None
    discovered.save(tmp_path / "found")
    read = tt.Discovered.load(tmp_path / "found", robot)
    assert same(discovered, read)
    assert same_page(page_of(discovered), page_of(read))
    assert repr(read.after) == repr(discovered.after)
    assert read.rig == str(tmp_path / "found" / "rig")
    assert read.corrections == discovered.corrections == discovered.discovery.corrections
    refuse("exists already", discovered.save, tmp_path / "found")


def test_any_result_in_memory_has_a_page_and_a_view(static, discovered, coverage, robot, tmp_path):
    repeated = tt.MonteCarlo.load(coverage, robot)
    for kind, result in {"validation": static, "discovery": discovered, "Monte Carlo": repeated}.items():
        alone = dataclasses.replace(result, folder=None)
        page = write_page(tmp_path / f"{kind}.html", alone)
        assert page.title == f"TULip: {kind}"
        assert page.verdict == result.verdict
        if kind == "Monte Carlo":
            continue
        title, log = view_of(alone, alone.robot)
        assert title == f"TULip ({kind})"
        assert window.save(tmp_path / f"{kind}.rrd", title, log) > 1e5
    refuse("exists already", write_page, tmp_path / "discovery.html", discovered)


def test_a_run_of_the_statics_says_that_it_has_no_true_centre_of_mass(static):
    assert static.books is None
    assert static.simulation.com is None
    page = page_of(static)
    assert any(NO_TRUE_COM in section.paragraphs for section in page.sections)
    assert "CoM, truth" not in "".join(figure.json for part in page.sections for figure in part.figures)
    subject = validated(static)
    assert set(subject.com) == {"estimate", "nominal model"}
    assert NO_TRUE_COM in subject.notes


def refuse_edited(intact, folder, kind, robot, changes, words):
    """Change a document of a run folder and put its hash right: the message names the file and the key."""
    shutil.copytree(intact, folder)
    name, _, change = changes[0].partition(": ")
    change_document(folder / name, change)
    put_right(folder, name)
    refuse(f"{name}: ... {words}", kind.load, folder, robot)


@pytest.mark.filterwarnings("ignore")  # of arithmetic on strange numbers
@cases("name", ["run.json", "rig/rig.json"], ["result.json", "truth.json"])
@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_value_anywhere_is_read_or_refused_in_one_line(
    name, data, run_folder, discovered_folder, robot, tmp_path
):
    """With matching hashes."""
    corrections = name.startswith("rig")
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
    folder = shutil.copytree(discovered_folder if corrections else run_folder, tmp_path / "run")
    document = json.loads((folder / name).read_text())
    changed_anywhere(document, data.draw)
    (folder / name).write_text(json.dumps(document))
    if name in ("result.json", "truth.json"):
        put_right(folder, name)
    if not corrections:
        read_or_refused(lambda: page_of(read_run(folder, robot)))
        return
    for effect in read_or_refused(lambda: read_rig(folder / "rig", robot)) or ():
        assert effect.finding
        assert np.isfinite(effect.values).all()


@rows("validation")
def test_an_edited_validation_is_refused(run_folder, robot, tmp_path, changes, words):
    refuse_edited(run_folder, tmp_path / "run", tt.Validation, robot, changes, words)


@rows("discovery")
def test_an_edited_discovery_is_refused(discovered_folder, robot, tmp_path, changes, words):
    refuse_edited(discovered_folder, tmp_path / "found", tt.Discovered, robot, changes, words)


def put_right(folder, name):
    document = json.loads((folder / "run.json").read_text())
    document["outputs"][name] = sha256(folder / name)
    (folder / "run.json").write_text(json.dumps(document))


def test_a_run_of_another_robot_is_refused(run_folder, robot, tmp_path):
    folder = shutil.copytree(run_folder, tmp_path / "run")
    change_document(folder / "run.json", "inputs = {}")
    refuse("key 'inputs': found no tulip.xml with the hash", read_run, folder, robot)


def test_keys_that_nobody_knows_are_passed_over(run_folder, robot, tmp_path):
    """As another version might write them."""
    folder = shutil.copytree(run_folder, tmp_path / "run")
    document = json.loads((folder / "result.json").read_text())
    change_document(folder / "result.json", 'weather = {"sky": "blue"}')
    put_right(folder, "result.json")
    assert tt.Validation.load(folder, robot).to_json() == document


def test_what_is_infinite_or_undefined_is_null_on_disk(static, robot, tmp_path):
    """An estimate of exactly 0 has no relative standard error."""
    own = static.identification
    value = np.where(own.full.numbers == 1, 0.0, own.full.value)
    changed = dataclasses.replace(own, full=dataclasses.replace(own.full, value=value))
    dataclasses.replace(static, identification=changed).save(tmp_path / "run")
    document = json.loads((tmp_path / "run" / "result.json").read_text())
    assert document["identification"]["full"]["relative_standard_error"][0] is None
    full = tt.Validation.load(tmp_path / "run", robot).identification.full
    assert np.isinf(full.relative_standard_error[0])


def test_a_monte_carlo_with_another_plan_or_more_runs_than_anybody_makes_is_refused(
    coverage, robot, plan, tmp_path
):
    """run.json lists no hashes of the runs' files: the plan has its own, and a number of runs is bounded."""
    folder = shutil.copytree(coverage, tmp_path / "runs")
    intact = (folder / "run.json").read_text()
    change_document(folder / "run.json", "settings.runs = 10000000000000")
    refuse("run.json: key 'settings.runs': found 10000000000000", read_run, folder, robot)
    (folder / "run.json").write_text(intact)
    shutil.rmtree(folder / "plan")
    write_plan(tmp_path / "plan", plan.take(plan.placement <= 11))
    (tmp_path / "plan").rename(folder / "plan")
    refuse("plan: hash mismatch: found a plan with sha256", read_run, folder, robot)
