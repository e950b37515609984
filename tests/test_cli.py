"""The command line as a user meets it: exit codes, one message, nothing half-written."""

import inspect
import json
import re
import subprocess
import sys
from typing import Any

import pytest

import tulip_testbed as tt
from tulip_testbed.cli.commands import COMMANDS
from tulip_testbed.cli.generated import PROGRESS, READERS, VALUE
from tulip_testbed.cli.main import command_of, main, usage
from tulip_testbed.cli.signatures import REQUIRED, public_function
from tulip_testbed.cli.terminal import PIPE_WIDTH
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN

TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]  # in its own process
NAMES = list(COMMANDS)
HEAVY = (
    *("mujoco", "numpy", "scipy", "pyarrow", "statsmodels"),
    *("pydantic", "rich", "pandas", "rerun", "plotly"),
)


def told(capsys, *arguments, code=0):
    """Run a command with `--json`; return its document."""
    capsys.readouterr()
    assert main([*map(str, arguments), "--json"]) == code
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments):
    """Run, expect exit code 2 and one message; returns it."""
    assert main([str(a) for a in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    return " ".join(err.split())


def test_plan_for_another_model(edited_tulip, tmp_path, capsys):
    heavier = edited_tulip('tulip.xml: mass="10.7" => mass="10.8"', built=False)
    here = ("--robot", heavier.path, "--out", tmp_path / "run")
    message = refused(capsys, "validate", *here)
    assert "the shipped one is TULip's. Draw one with `tulip plan random`" in message
    message = refused(capsys, "validate", DEFAULT_PLAN, *here)
    assert "hash mismatch of the robot's model" in message


def test_help_lists_every_command_with_the_first_line_of_its_docstring(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert out == usage() + "\n"
    assert max(map(len, out.splitlines())) <= 80
    for name in NAMES:
        summary = (command_of(name).__doc__ or "").partition("\n")[0]
        assert re.search(rf"  {name} +{re.escape(summary)}\n", out)


def in_a_process(code: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **options)


def loaded_by(code: str) -> list[str]:
    """Run code in a process of its own and return the heavy libraries that it has loaded."""
    tell = f"import sys; print(*[name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    done = in_a_process(f"{code}\n{tell}")
    return done.stderr.split()


def test_help_and_version_load_no_simulator():
    version = "import sys; sys.argv = ['tulip', '--version']\nfrom tulip_testbed.cli.entry import run"
    assert loaded_by(f"{version}\ntry: run()\nexcept SystemExit as stop: assert not stop.code") == []
    each = f"for name in {NAMES}:\n try: main([*name.split(), '--help'])\n except SystemExit: pass"
    assert loaded_by(f"from tulip_testbed.cli.main import main\nmain(['--help'])\n{each}") == []
    assert loaded_by("import mujoco") == ["mujoco", "numpy"]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_the_options_and_the_defaults_of_its_function(name):
    function = public_function(COMMANDS[name].function)
    parameters = inspect.signature(getattr(tt, function.name)).parameters
    assert [argument.name for argument in function.arguments] == list(parameters)
    options = inspect.signature(COMMANDS[name].load()).parameters
    for argument in function.arguments:
        default = parameters[argument.name].default
        assert argument.default == (REQUIRED if default is inspect.Parameter.empty else default)
        reader = READERS.get(argument.annotation)
        read = {argument.name} if reader is None else set(inspect.signature(reader).parameters)
        expected = {argument.name if one == VALUE else one for one in read} - {PROGRESS}
        assert expected <= set(options), argument.name
        if reader is None and argument.name in options:
            assert argument.text, f"the docstring says nothing of {argument.name}"


def test_interrupted_while_libraries_load_it_ends_quietly():
    code = """
import os, signal, sys

class Interruption:
    def find_spec(self, name, *rest):
        if name == "mujoco":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interruption())
sys.argv = ["tulip", "robot"]
from tulip_testbed.cli.entry import run
run()
"""
    done = in_a_process(code)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "tulip: interrupted; nothing was written\n"


def test_a_run_remembers_its_robot(edited_tulip, tmp_path):
    rose = edited_tulip('tulip.toml: name = "TULip" => name = "Rose"', built=False).path
    run, page = tmp_path / "run", tmp_path / "run.html"
    quick = ("--engine", "statics", "--estimator", "mixed-model", "--imperfections", "0")
    assert main(["validate", "--robot", str(rose), *quick, "--out", str(run)]) in (0, 1)
    rose.unlink()
    assert main(["report", str(run), "--out", str(page)]) == 0
    assert "<title>Rose: validation run</title>" in page.read_text()


def test_model_prints_links_with_their_brackets(capsys):
    assert main(["robot"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= PIPE_WIDTH
    assert len(out.splitlines()) < 60
    row = told(capsys, "robot")["base"][18]
    assert row["standard"].count("[") == row["terms"] == 11
    assert row["meaning"] == "z moment of right_upper_leg, 10 masses at 319.7 mm"
    assert told(capsys, "robot", "--support", "right")["counts"]["base"] == 26


@pytest.mark.parametrize("command", NAMES)
def test_help_has_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    said = capsys.readouterr().out
    assert f"tulip {command}" in said.split("Example:")[1]
    assert "{None}" not in said


def test_the_parser_repeats_no_control_or_direction_character(capsys):
    for hostile in ("\u202ewii", "\x1b[2J", "\x9b31m"):
        for arguments in (["identify", "x", "--robot", "y", hostile], ["validate", "--workers", hostile]):
            with pytest.raises(SystemExit) as end:
                main(arguments)
            said = capsys.readouterr()
            assert end.value.code == 2
            assert (said.out + said.err).replace("\n", "").isprintable()
