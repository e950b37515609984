"""The wheel: one import name, every file that is needed, the main job in an environment of its own."""

import json
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from the files that git knows, so that nothing of this folder slips in."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    subprocess.run(["tar", "cf", source / "all.tar", "--null", "-T", "-"], cwd=ROOT, input=files, check=True)
    subprocess.run(["tar", "xf", "all.tar"], cwd=source, check=True)
    options = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, "-w", built, source], check=True)
    (found,) = built.glob("*.whl")
    return found


def test_it_adds_one_name_and_holds_every_file(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"tulip_testbed"}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for room in ("sim", "identification", "effects", "discovery", "experiments", "assets"):
        code = [
            f for f in tracked.splitlines() if f.startswith(f"{room}/") and not f.endswith("CHANGELOG.md")
        ]
        assert {f"tulip_testbed/{f}" for f in code} <= {*names, f"tulip_testbed/{room}/__init__.py"}
    assert "tulip_testbed/pages/page.html.j2" in names


@pytest.mark.slow
def test_the_main_job_in_a_clean_environment(wheel, tmp_path):
    """validate, discover and report from an empty folder, where the repository is out of sight."""
    venv.create(tmp_path / "env", with_pip=True)
    python, empty = tmp_path / "env" / "bin" / "python", tmp_path / "empty"
    empty.mkdir()
    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--require-hashes", "-r", ROOT / "constraints.txt"], check=True)
    subprocess.run([*pip, "--no-deps", wheel], check=True)

    def tulip(*arguments):
        command = [tmp_path / "env" / "bin" / "tulip", *arguments, "--json"]
        return json.loads(subprocess.run(command, cwd=empty, capture_output=True, check=True).stdout)

    assert tulip("validate", "--out", "validated", "--seed", "1")["verdict"] == "pass"
    hidden = ["--effects", "encoder-offset:right_knee=0.01"]
    tulip(
        "simulate", "--engine", "statics", "--sensors", "force-plate", "--seed", "3", *hidden, "--out", "data"
    )
    assert tulip("discover", "data", "--out", "found")["verdict"] == "named"
    for run in ("validated", "found"):
        assert tulip("report", run, "--out", f"{run}.html")["bytes"] > 1e6
