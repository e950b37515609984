"""What the suite asks of itself: the record of durations, what draws, and plain sentences."""

import ast
from pathlib import Path

import pytest

from tests import plain_english
from tests.drawing import PACKAGES, decide, obstacle_to, unreachable
from tests.durations import OUTSIDE, default_tests, read_durations

DRAW = {"headless_viewer", "browse", "browser", "look", "contact_sheet"}


@pytest.mark.parametrize("program", PACKAGES)
def test_without_drivers_nothing_is_drawn_and_the_packages_are_named(program, tmp_path, monkeypatch):
    for name, value in unreachable(tmp_path).items():
        monkeypatch.setenv(name, value)
    assert obstacle_to(program).endswith(f"apt-get install {PACKAGES[program]}")


def test_an_obstacle_skips_or_fails_as_was_asked():
    decide("vulkan", "", "possible")
    decide("vulkan", "", "always")
    for when in ("possible", "never"):
        with pytest.raises(pytest.skip.Exception, match="no driver"):
            decide("vulkan", "no driver", when)
    with pytest.raises(pytest.fail.Exception, match="no driver"):
        decide("vulkan", "no driver", "always")
    with pytest.raises(pytest.fail.Exception, match="made unreachable"):
        decide("vulkan", "", "never")


def test_every_test_that_draws_is_marked():
    for path in sorted(Path(__file__).parent.glob("test_*.py")):
        for test in ast.parse(path.read_text()).body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                names = {node.id for node in ast.walk(test) if isinstance(node, ast.Name)}
                if names & DRAW:
                    marks = [ast.unparse(mark) for mark in test.decorator_list]
                    assert any(mark.startswith("draws_with(") for mark in marks), f"{path.name}: {test.name}"


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write a file of a small repository and return its findings."""
    monkeypatch.setattr(plain_english, "ROOT", tmp_path)

    def findings(name: str, text: str) -> list[str]:
        path: Path = tmp_path / name
        path.write_text(text)
        return plain_english.findings([path])

    return findings


def test_strings_and_docstrings_are_read_but_no_names(write):
    source = (
        '"""Build.\n\nThe boards lie beside it.\n"""\n\nbeside = f"{1} lies beside {2}"\nkey = "beside"\n'
    )
    advice = 'write "next to", "in addition to", "together with" or "compared with" instead'
    assert write("module.py", source) == [
        f'module.py:3: found "beside", {advice}',
        f'module.py:6: found "beside", {advice}',
    ]


def test_every_phrase_has_a_replacement():
    for pattern, write in plain_english.phrases():
        assert write.strip(), pattern.pattern


MOST = 8 * 60  # s of processor time, half of it on each of two cores
STALE = 0.05  # of the tests may be new or gone since the record was made


def test_the_default_suite_takes_eight_minutes_of_a_processor_at_most():
    durations = read_durations()
    assert sum(durations.values()) <= MOST, "make tests cheaper or mark them slow, then `make durations`"


def test_the_record_of_durations_is_current():
    recorded, present = set(read_durations()) - {OUTSIDE}, default_tests()
    new, gone = sorted(present - recorded), sorted(recorded - present)
    assert len(new) <= STALE * len(present), f"not recorded, run `make durations`: {new[:10]} ..."
    assert len(gone) <= STALE * len(present), f"recorded, but gone, run `make durations`: {gone[:10]} ..."
