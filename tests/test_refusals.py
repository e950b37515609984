"""Refuse what the table tests/refusals.txt lists, in one line with the words that it states.

Sections about what is found or told, rather than refused, belong to the tests of its subject.

Changes that are drawn at random, and what the commands make of them, are in `tests/fuzz`.
"""

import json
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tulip_testbed as tt
from tests.contact_folders import EXAMPLE, contacts_of, write_contacts
from tests.edited_files import BUILT, change_texts, write_rig
from tests.published_robot import write_changed
from tulip_testbed.calibration.families import read_tolerances
from tulip_testbed.cli.main import main
from tulip_testbed.effects.random_effects import read_effects
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.experiments.robot_import import published
from tulip_testbed.experiments.robot_import.robot_import import import_robot
from tulip_testbed.experiments.validate import judge
from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.estimators import estimate_by
from tulip_testbed.identification.planning_ranges import free_joint_ranges, planning_ranges
from tulip_testbed.identification.regressor import regression
from tulip_testbed.measurements import Experiment, joined, read_measurements
from tulip_testbed.measurements.manipulations import arrangement_of
from tulip_testbed.sim import sandbox
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.robot_check import check_scene
from tulip_testbed.sim.shipped import TULIP

ENDLESS = re.compile(r'count="\d{3}')
TABLE = Path(__file__).with_name("refusals.txt").read_text()


def rows(section: str):
    """Parametrize a test by the rows of a section: changes, and words of the message."""
    lines = TABLE.split(f"[{section}]\n")[1].split("\n\n")[0].splitlines()
    pairs = [line.rsplit("| ", 1) for line in lines if line[0] != "#"]
    cases = [([part.strip() for part in change.split(" & ")], words.strip()) for change, words in pairs]
    names = [" & ".join(changes)[:60] for changes, _ in cases]
    return pytest.mark.parametrize(("changes", "words"), cases, ids=names)


def refuse(words: str, call, *arguments, **options) -> None:
    with pytest.raises(tt.InputError) as refusal:
        call(*arguments, **options)
    assert "\n" not in str(refusal.value)
    check_words(words, str(refusal.value))


def check_words(words: str, message: str) -> None:
    at = 0
    for part in words.split(" ... "):
        assert (at := message.find(part, at)) >= 0, message


def change_keys(document, change: str) -> None:
    """Change a key, `KEY.KEY = JSON`, or remove it, `KEY.KEY -`; `*` is every item of a list."""
    trail, _, value = change.partition(" = ")
    *above, key = [int(part) if part.isdigit() else part for part in trail.removesuffix(" -").split(".")]
    places = [document]
    for part in above:
        places = [inner for place in places for inner in (place if part == "*" else [place[part]])]
    for place in places:
        for each in range(len(place)) if key == "*" else [key]:
            if not value:
                del place[each]
            elif key == "*":
                place[each] = json.loads(value) | {"name": place[each]["name"]}
            else:
                place[each] = json.loads(value)


def change_document(path: Path, *changes: str) -> None:
    """Change keys of a JSON file, see `change_keys`."""
    document = json.loads(path.read_text())
    for change in changes:
        change_keys(document, change)
    path.write_text(json.dumps(document))


def change_folder(folder, changes, file="postures.csv") -> None:
    """Change keys of the manifest and columns of the table."""
    lines = [line for line in (folder / file).read_text().splitlines() if line[0] != "#"]
    names, *table = [line.split(",") for line in lines]
    names = [name.strip('"') for name in names]
    for change in changes:
        trail, _, value = change.partition(" = ")
        if trail.startswith("@"):
            name, _, row = trail.removesuffix(" -")[1:].partition("[")
            if name not in names:
                names, table = [*names, name], [[*cells, ""] for cells in table]
            column = names.index(name)
            for k, cells in enumerate([names, *table]):
                if not value:
                    del cells[column]
                elif k and row in ("", f"{k}]"):
                    cells[column] = value
            continue
        change_document(folder / "manifest.json", change)
    (folder / file).write_text("\n".join(",".join(cells) for cells in [names, *table]) + "\n")


@rows("measurements")
def test_a_measurement_folder_is_refused(tmp_path, changes, words):
    folder = shutil.copytree(EXAMPLE, tmp_path / "data")
    change_folder(folder, changes)
    refuse(words, read_measurements, folder)


@rows("motion")
def test_samples_of_a_motion_are_refused(tmp_path, changes, words):
    folder = shutil.copytree(EXAMPLE, tmp_path / "data")
    lines = [line for line in (folder / "postures.csv").read_text().splitlines() if line[0] != "#"]
    names = [name.strip('"') for name in lines[0].split(",")]
    first = dict(zip(names, lines[1].split(","), strict=True))
    samples = [first | {"segment": "1", "time": f"{k / 100:g}"} for k in range(100)]
    kept = [name for name in (*names, "segment", "time") if name not in ("posture", "window", "samples")]
    kept = list(dict.fromkeys(kept))
    (folder / "postures.csv").unlink()
    table = [",".join(kept), *(",".join(one[name] for name in kept) for one in samples)]
    (folder / "motion.csv").write_text("\n".join(table) + "\n")
    assert len(read_measurements(folder)) == 1
    change_folder(folder, changes, "motion.csv")
    refuse(words, read_measurements, folder)


@rows("identified")
def test_measurements_of_another_robot_are_refused(tmp_path, robot, changes, words):
    folder = shutil.copytree(EXAMPLE, tmp_path / "data")
    change_folder(folder, changes)
    refuse(words, identify, read_measurements(folder), robot)


@rows("contacts")
def test_contacts_and_mappings_are_refused(tmp_path, changes, words):
    plates = read_measurements(EXAMPLE)
    folder = write_contacts(tmp_path / "data", plates, contacts_of(), {"F1": np.arange(len(plates)) / 100})
    change_folder(folder, changes)
    refuse(words, read_measurements, folder)


@rows("robot")
@pytest.mark.filterwarnings("ignore:compiler attribute")
def test_a_robot_is_refused(tmp_path, changes, words):
    folder = shutil.copytree(TULIP.parent, tmp_path / "robot")
    change_texts(
        folder, changes if changes[0].startswith(("scene", "tulip.toml", "table2")) else [BUILT, *changes]
    )
    refuse(words, lambda: check_scene(preset_rig("ideal", described_robot(folder / "tulip.toml"))))


@rows("published")
@pytest.mark.filterwarnings("error")  # none next to a refusal
def test_a_published_robot_is_refused(tmp_path, monkeypatch, capfd, changes, words):
    """What would be read without end is, in a process of its own."""
    file = write_changed(tmp_path, changes)
    if ENDLESS.search(changes[0]):
        monkeypatch.setattr(sandbox, "MOST_SECONDS", 1)
        monkeypatch.setattr(published, "call_safely", sandbox.call_safely)
    refuse(f"{file}: {words}", import_robot, file)
    assert capfd.readouterr() == ("", "")


@rows("humanoid")
def test_ranges_of_free_joints_are_refused(tmp_path, foreign, changes, words):
    folder = shutil.copytree(foreign["humanoid"].folder, tmp_path / "robot")
    change_texts(folder, changes)

    def ranges():
        robot = load_robot(folder / "robot.toml")
        free_joint_ranges(robot, robot.model, planning_ranges(robot))

    refuse(words, ranges)


@rows("corrections")
def test_corrections_are_refused(tmp_path, robot, changes, words):
    texts = ("encoder-offset:right_knee=0.01", "joint-compliance:left_ankle_roll=0.0005")
    effects = [tt.EffectInstance.parse(text, robot) for text in texts]
    write_rig(tmp_path / "rig", robot, effects)
    change_texts(tmp_path / "rig", changes)
    refuse(f"{tmp_path} ... {words}", read_rig, tmp_path / "rig", robot)


@rows("effects")
def test_an_effect_is_refused(robot, changes, words):
    where = "rig.json, key 'effects'"
    asked = {"seed": 0, "statics": True, "where": where}
    refuse(f"{where} ... {words}", read_effects, changes, robot, (1, 2, 30), **asked)


@rows("tolerances")
def test_tolerances_are_refused(changes, words):
    refuse(words, read_tolerances, changes)


@rows("manipulations")
def test_manipulations_are_refused(changes, words):
    refuse(words, arrangement_of, changes)


@pytest.fixture(scope="module")
def names(robot, run):
    """What the calls use."""
    standing = {"joint_angles": robot.model.key("stand").qpos[7:]}

    def composed(preset="ideal", **options):
        return laboratory_environment(preset_rig(preset, robot), **(standing | options))

    @cache
    def started(actuation):
        environment = composed(actuation=actuation)
        environment.reset()
        return environment

    def stepped(action, actuation="angles"):
        started(actuation).step(action)

    feet = tt.Laboratory(robot, sensors="foot-ft").run(tt.plans.random, seed=2, engine="statics").measurements
    few, session = tt.plans.random.take(np.arange(30)), run.laboratory.manipulated(session="one")
    one, other = (session.run(few, seed=seed, engine="statics").measurements for seed in (3, 4))
    m = run.measurements
    rates = dict.fromkeys(("joint_rates", "joint_accelerations"), 0 * one.joint_angles)
    own = {
        "arrays": {
            name: getattr(m, name) for name in ("placement", "joint_angles", "cell_forces", "plate_poses")
        },
        "data": regression(base_parameters(robot), m, robot),
        "degrees": replace(m, joint_angles=np.rad2deg(m.joint_angles)),
        "knee": tt.effects.parse("encoder-offset:right_knee=0.01", robot),
        "moving": tt.plan_motion(few.take(np.arange(3)), robot).plan,
        "one": one,
        "other": other,
        "rows": replace(one, **rates),  # of a robot that moves
        "joined": joined,
        "Experiment": Experiment,
        "feet": feet.take(np.arange(40)),
        "replace": replace,
        "composed": composed,
        "stepped": stepped,
        "np": np,
        "Path": Path,
        "tt": tt,
        "base_parameters": base_parameters,
        "center_of_pressure": center_of_pressure,
        "estimate_by": estimate_by,
        "identify": identify,
    }
    fit = tt.identify(run, estimator="mixed-model")
    return own | {"run": run, "lab": run.laboratory, "plan": tt.plans.random, "fit": fit}


@rows("calls")
def test_a_call_is_refused(names, monkeypatch, changes, words):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    refuse(words, eval, changes[0], names)


@pytest.fixture(scope="module")
def folders(names, tmp_path_factory):
    """A folder with measurements, also in kilograms, a plan and the run of a validation."""
    place = tmp_path_factory.mktemp("folders")
    measured = names["run"].measurements
    tt.write_measurements(place / "data", measured)
    tt.write_measurements(place / "kg", replace(measured, cell_forces=measured.cell_forces / 9.81))
    tt.plans.write(place / "plan", names["plan"])
    judge(names["run"]).save(place / "run")
    for name in ("taken.html", "taken.rrd", "taken.xml"):
        (place / name).touch()
    (place / "loop").symlink_to("loop")
    (place / "link").symlink_to("data")
    return place


@rows("commands")
def test_a_command_is_refused(folders, monkeypatch, capsys, changes, words):
    monkeypatch.chdir(folders)
    before = sorted(folders.iterdir())
    try:
        code = main(changes[0].split())
    except SystemExit as end:  # of the parser of arguments
        code = end.code
    check_words(words, " ".join(capsys.readouterr().err.split()))
    assert code == 2
    assert sorted(folders.iterdir()) == before


@rows("said")
def test_a_command_says(folders, monkeypatch, capsys, changes, words):
    monkeypatch.chdir(folders)
    assert main(changes[0].split()) == 0
    check_words(words, " ".join(capsys.readouterr().out.split()))
