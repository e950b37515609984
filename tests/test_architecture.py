"""Data flows one way: sim <- identification <- experiments."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return names


def importers(package: str, wanted: str) -> list[str]:
    paths = (ROOT / package).rglob("*.py")
    return [str(p) for p in paths if any(n == wanted or n.startswith(wanted + ".") for n in imported(p))]


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [("sim", "identification"), ("sim", "experiments"), ("identification", "experiments")],
)
def test_nothing_imports_against_the_flow(package, forbidden):
    assert importers(package, forbidden) == []


def test_identification_sees_of_sim_only_model_measurements_and_errors():
    allowed = ("sim.robot", "sim.measurements", "sim.errors")
    for path in (ROOT / "identification").rglob("*.py"):
        for name in imported(path):
            assert not name.startswith("sim") or name.startswith(allowed), f"{path.name} imports {name}"


@pytest.mark.parametrize(("module", "owner"), [("mink", "inverse_kinematics.py"), ("plotly", "figures.py")])
def test_a_library_has_one_importer(module, owner):
    for package in ("sim", "identification", "experiments"):
        assert all(path.endswith(owner) for path in importers(package, module))


def test_rerun_is_for_the_view_alone():
    for package in ("sim", "identification", "experiments"):
        assert all(Path(path).parent.name == "view" for path in importers(package, "rerun"))


@pytest.mark.parametrize("library", ["dm_control", "dm_env"])
def test_dm_control_is_for_the_composer_laboratory_alone(library):
    for package in ("sim", "identification", "experiments"):
        assert all(Path(path).parent.name == "composer" for path in importers(package, library))
