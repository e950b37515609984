"""The runner of the studies: what it lists, passes on, writes and refuses."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from studies import runner, study_check
from studies.runner import Settings, header, row


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    """Put a study of one table in the place of `check`; return the list of the settings that it gets."""
    given: list[Settings] = []

    def study(settings: Settings) -> Iterator[str]:
        given.append(settings)
        yield header("a", "b")
        yield row(1, "two")

    monkeypatch.setattr(study_check, "study", study)
    return given


def test_every_study_has_a_module_and_a_sentence() -> None:
    found = runner.studies()
    assert {"atlas", "check", "hidden-effects", "verdict"} <= found.keys()
    for name, sentence in found.items():
        module = importlib.import_module(f"studies.study_{name.replace('-', '_')}")
        assert sentence == str(module.__doc__).split("\n")[0]
        assert callable(module.study)
        assert isinstance(module.SETTINGS, Settings)


def test_a_study_gets_its_own_settings_and_those_of_the_command(seen: list[Settings]) -> None:
    assert runner.main(["check"]) == 0
    assert runner.main(["check", "--seed", "7", "--size", "0.1", "--only", "wii"]) == 0
    assert seen[0] == study_check.SETTINGS
    assert (seen[1].seed, seen[1].count(300), seen[1].count(2), seen[1].only) == (7, 30, 1, ("wii",))


def test_the_file_holds_the_command_and_what_was_printed(
    seen: list[Settings], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a table.md"
    assert runner.main(["check", "--size", "0.5", "--out", str(out)]) == 0
    text = out.read_text()
    assert text == capsys.readouterr().out
    assert text.startswith(f"`python -m studies check --size 0.5 --out '{out}'` (seed 104)\n")
    assert "\n\n| a | b |\n|---|---|\n| 1 | two |\n\n" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chek"], "unknown study 'chek'; did you mean 'check'? valid: atlas, campaign, check"),
        (["check", "--only", "wii", "kinect"], "unknown part 'kinect'; valid: wii, force-plate"),
    ],
)
def test_unknown_names_are_refused(
    arguments: list[str], message: str, seen: list[Settings], capsys: pytest.CaptureFixture[str]
) -> None:
    assert runner.main(arguments) == 2
    assert message in capsys.readouterr().err
    assert not seen
