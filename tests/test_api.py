"""The door: what a researcher's notebook calls."""

import inspect
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tulip_testbed as tt
from tests.documented import blocks
from tests.drawing import draws_with
from tests.test_architecture import FLOW
from tulip_testbed.cli.main import main
from tulip_testbed.sim import robot as robot_module

ROOT = Path(__file__).parent.parent


@pytest.fixture
def screen(monkeypatch):
    """A virtual screen, on which the viewer opens; 90 keeps clear of real ones."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb")
    server = subprocess.Popen(["Xvfb", ":90", "-screen", "0", "1280x800x24"], stderr=subprocess.DEVNULL)
    monkeypatch.setenv("DISPLAY", ":90")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    yield
    server.terminate()
    server.wait()


def test_the_readme_begins_with_what_its_block_reads(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = blocks("README.md", "python")
    names: dict = {}
    exec(first.replace("seed=3)", 'seed=3, engine="statics")') + second, names)
    assert len(names["fit"]) == 25


@pytest.mark.parametrize(
    "page", ["docs/how-to/your-data.md", "docs/reference/measurements.md", "docs/how-to/effects.md"]
)
def test_the_python_of_a_page_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec("".join(blocks(page, "python")), {})


@pytest.fixture
def loads(monkeypatch) -> dict[str, list[str]]:
    """Names of the robot's files that are read, and of the models of a robot alone that are compiled."""
    seen: dict[str, list[str]] = {"read": [], "compiled": []}
    sha256, compile_spec = robot_module.sha256, robot_module.compile_spec
    monkeypatch.setattr(robot_module, "sha256", lambda p: seen["read"].append(Path(p).name) or sha256(p))

    def counted(spec, where):
        seen["compiled"].append(spec.modelname)
        return compile_spec(spec, where)

    monkeypatch.setattr(robot_module, "compile_spec", counted)
    return seen


def test_the_files_of_a_robot_are_read_and_compiled_once(loads):
    robot = tt.load_robot()
    tt.identify(tt.Laboratory(robot, "wii").run(tt.plans.random, seed=2, engine="statics"), robot)
    assert loads["compiled"].count(robot.model_file.stem) <= 1
    assert all(loads["read"].count(path.name) <= 1 for path in robot.files)


@pytest.mark.slow
@draws_with("vulkan")
def test_a_view_opens_on_the_screen(screen, run):
    tt.view(run)


def test_every_name_is_documented_and_found_by_completion():
    assert set(dir(tt)) == set(tt.__all__)
    assert {"Measurements", "Robot", "PosturePlan", "Identification", "load_robot"} <= set(tt.__all__)
    for name in tt.__all__:
        assert len(inspect.getdoc(getattr(tt, name)) or "") > 20, name


def test_importing_loads_no_more_than_is_needed_and_leaves_the_environment_alone():
    code = (
        "import os, sys; before = dict(os.environ); import tulip_testbed as tt;"
        "print(sorted({'numpy', 'mujoco', 'rich'} & set(sys.modules)));"
        "tt.load_robot; tt.plans; tt.effects; import tulip_testbed.api;"
        "print(sorted({'scipy.stats', 'pandas'} & set(sys.modules)), before == dict(os.environ))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n[] True\n"


@pytest.mark.parametrize(
    ("owner", "name", "message"),
    [
        (tt.plans, "rondom", "no plan 'rondom'; valid: random, optimal"),
        (tt, "discovery_of", "no attribute 'discovery_of'; valid: "),
    ],
)
def test_unknown_names_list_the_valid_ones(owner, name, message):
    with pytest.raises(AttributeError, match=message):
        getattr(owner, name)


def test_no_error_of_the_library_names_a_flag():
    """Every message of the rooms beside the command line is free of flags."""
    door = (f"tulip_testbed/{room}" for room in ("pages", "viewer"))
    for room in (*FLOW, *door):
        for path in (ROOT / room).rglob("*.py"):
            for raised in re.findall(r"raise \w+\((.*?)\)\n", path.read_text(), re.DOTALL):
                assert not re.search(r"(?<![\w-])--[a-z]", raised), f"{path}: {raised[:120]}"


def test_a_notebook_and_the_command_line_give_the_same_bits(run, tmp_path, capsys):
    tt.write_measurements(tmp_path / "data", run.measurements)
    assert main(["identify", str(tmp_path / "data"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["full"]["value"]
    fit = tt.identify(tt.read_measurements(tmp_path / "data"))
    assert told == fit.full.value.tolist()
