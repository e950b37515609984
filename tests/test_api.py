"""The door: what a notebook calls, and what is refused there before any work."""

import inspect
import pickle
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell

import tulip_testbed as tt
from tests.documented import blocks
from tests.test_architecture import FLOW
from tests.test_cli import in_a_process, told
from tulip_testbed.base.arguments import checked
from tulip_testbed.sim import robot as robot_module

ROOT = Path(__file__).parent.parent


def test_the_readme_begins_with_what_its_block_reads(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = blocks("README.md", "python")
    names: dict = {}
    exec(first.replace("seed=3)", 'seed=3, engine="statics")') + second, names)
    assert len(names["fit"]) == 25


@pytest.mark.parametrize(
    "page", ["docs/reference/measurements.md", "docs/how-to/effects.md", "docs/how-to/composer.md"]
)
def test_the_python_of_a_page_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    exec("".join(blocks(page, "python")), {})


def test_the_files_of_a_robot_are_read_and_compiled_once(run, monkeypatch):
    """After the shipped plans have read theirs."""
    seen: dict[str, list[str]] = {"read": [], "compiled": []}
    sha256, compile_spec = robot_module.sha256, robot_module.compile_spec
    monkeypatch.setattr(robot_module, "sha256", lambda p: seen["read"].append(Path(p).name) or sha256(p))

    def counted(spec, where):
        seen["compiled"].append(spec.modelname)
        return compile_spec(spec, where)

    monkeypatch.setattr(robot_module, "compile_spec", counted)
    robot = tt.load_robot()
    tt.identify(tt.Laboratory(robot, "wii").run(tt.plans.random, seed=2, engine="statics"), robot)
    assert seen["compiled"].count(robot.model_file.stem) <= 1
    assert all(seen["read"].count(path.name) <= 1 for path in robot.files)


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
    done = in_a_process(code)
    assert done.stdout == "[]\n[] True\n"


def test_no_error_of_the_library_names_a_flag():
    """Every message of the rooms beside the command line is free of flags."""
    door = (f"tulip_testbed/{room}" for room in ("pages", "viewer"))
    for room in (*FLOW, *door):
        for path in (ROOT / room).rglob("*.py"):
            for raised in re.findall(r"raise \w+\((.*?)\)\n", path.read_text(), re.DOTALL):
                assert not re.search(r"(?<![\w-])--[a-z]", raised), f"{path}: {raised[:120]}"


DOUBTFUL = "cell-gain:right.front_left=3"


@checked
def asked(
    count: int, size: float | None = None, names: Sequence[str | float] | str = (), *more: bool
) -> tuple:
    return count, size, names, more


def test_what_fits_passes_and_numbers_of_numpy_become_plain():
    assert asked(1, 2, ["a", 0.5], True) == (1, 2, ["a", 0.5], (True,))
    count: Any = np.int64(3)
    assert type(asked(count)[0]) is int
    with pytest.raises(TypeError, match="count"):
        asked()  # type: ignore[missing-argument]  # as Python says it


def test_measurements_run_folder_and_command_line_give_the_same_bits(run, tmp_path, capsys):
    tt.write_measurements(tmp_path / "data", run.measurements)
    values = told(capsys, "identify", tmp_path / "data", "--estimator", "mixed-model")["full"]["value"]
    for given in (run.measurements, run, tmp_path / "data"):
        assert tt.identify(given, estimator="mixed-model").full.value.tolist() == values
    assert tt.check(run).verdict == tt.check(run.measurements).verdict


@pytest.mark.parametrize(
    "call",
    [
        f"lab.with_effects('{DOUBTFUL}')",
        f"lab.with_known(tt.effects.parse('{DOUBTFUL}', lab.robot))",
        f"tt.Laboratory(lab.robot, hidden=('{DOUBTFUL}',))",
        f"tt.check(run, corrections='{DOUBTFUL}')",
    ],
)
def test_an_implausible_value_warns_at_the_line_that_called(call, run):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        exec(f"\n\n{call}", {"__name__": "notebook", "tt": tt, "run": run, "lab": run.laboratory})
    (warning,) = seen
    assert (warning.category, warning.filename, warning.lineno) == (tt.InputWarning, "<string>", 3)
    assert str(warning.message) == (
        "cell-gain:right.front_left: gain 3 (300 %) is 60 times what is plausible (0.05); "
        "values are in SI units"
    )


def test_a_notebook_shows_the_line_and_the_message(capsys):
    shell = InteractiveShell()
    shell.run_cell("import tulip_testbed as tt\nplan = 3\ntt.plans.write('folder', plan)")
    out = capsys.readouterr().out
    assert out.splitlines() == [
        "----> 3 tt.plans.write('folder', plan)",
        "InputError: plan: found the int 3, expected PosturePlan",
    ]
    assert str(pickle.loads(pickle.dumps(tt.InputError("as it was")))) == "as it was"


def test_results_are_pickled_and_compared(robot, two):
    run = tt.Laboratory(robot).with_effects("cell-gain:right.front_left=0.03").run(two, engine="statics")
    again = pickle.loads(pickle.dumps(run))
    assert str(again.laboratory.hidden[0]) == str(run.laboratory.hidden[0])
    assert np.array_equal(again.measurements.cell_forces, run.measurements.cell_forces)
    assert run == run
    assert run != again
    assert len({run, again}) == 2
