"""Whether a test that draws runs is decided by drawing, and the decision can be negative."""

import ast
from pathlib import Path

import pytest

from tests.drawing import PACKAGES, decide, obstacle_to, unreachable

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
