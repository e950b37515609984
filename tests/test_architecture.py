"""The house: which room may import which, no cycles, one name for one module."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.durations import OUTSIDE, default_tests, read_durations

ROOT = Path(__file__).parent.parent
NAME = "tulip_testbed"
FLOW = (
    "base",
    "measurements",
    "sim",
    "identification",
    "effects",
    "calibration",
    "discovery",
    "experiments",
)  # each may import those before it
DOOR = ("cli", "pages", "viewer")


def modules() -> dict[str, Path]:
    """Every module of the package by its import name."""
    found = {}
    for path in [*(p for room in FLOW for p in (ROOT / room).rglob("*.py")), *(ROOT / NAME).rglob("*.py")]:
        parts = path.relative_to(ROOT).with_suffix("").parts
        parts = parts if parts[0] == NAME else (NAME, *parts)
        if not (
            len(parts) > 2 and (ROOT / NAME / parts[1]).is_symlink() and path.is_relative_to(ROOT / NAME)
        ):
            found[".".join(parts).removesuffix(".__init__")] = path
    return found


MODULES = modules()


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Everything in a file that may import or print, wherever it stands."""
    return [node for node in ast.walk(tree(path)) if isinstance(node, ast.Import | ast.ImportFrom | ast.Call)]


@cache
def imported(path: Path) -> set[str]:
    """Everything that a file imports, modules by their full names, wherever the import stands."""
    names = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                names.add(full if full in MODULES else str(node.module))
    return names


def room(module: str) -> str:
    """Of a module of the package; the door's own files are of the room NAME."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in (*FLOW, *DOOR) else NAME


@pytest.mark.parametrize("name", FLOW)
def test_data_flows_one_way(name):
    allowed = {*FLOW[: FLOW.index(name) + 1]}
    for module, path in MODULES.items():
        if room(module) == name:
            wrong = {n for n in imported(path) if n.split(".")[0] == NAME and room(n) not in allowed}
            assert not wrong, f"{module} imports {wrong}"


def test_everybody_uses_the_one_name():
    """`import sim` works in the repository's root and would load a second copy."""
    files = [
        *MODULES.values(),
        *(p for f in ("tests", "examples", "studies") for p in (ROOT / f).rglob("*.py")),
    ]
    for path in files:
        assert not {n.split(".")[0] for n in imported(path)} & {*FLOW, "assets"}, path


def test_nothing_imports_the_studies():
    for module, path in MODULES.items():
        assert not any(n.split(".")[0] in ("studies", "tests", "examples") for n in imported(path)), module


def test_there_is_no_import_cycle():
    """Nor one that an import inside of a function or under TYPE_CHECKING hides."""
    waiting = {m: {n for n in imported(p) if n in MODULES and n != m} for m, p in MODULES.items()}
    faces = {m for m, p in MODULES.items() if p.name == "__init__.py"}
    for module in waiting:  # importing a module runs the faces of its folders first, never the other way
        waiting[module] -= {face for face in faces if module.startswith(face + ".")}
    while free := [m for m, needs in waiting.items() if not needs & waiting.keys()]:
        for module in free:
            del waiting[module]
    assert not waiting, f"cycle among {sorted(waiting)}"


def test_two_modules_do_not_share_a_name():
    names = [p.stem for p in MODULES.values() if p.stem != "__init__"]
    folders = {p.parent.name for p in MODULES.values() if p.name == "__init__.py"}
    twice = {n for n in names if names.count(n) > 1 and n not in folders}
    assert not twice


def test_two_classes_do_not_share_a_name():
    places: dict[str, list[str]] = {}
    for name, path in MODULES.items():
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(name)
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_no_subpackage_has_the_name_of_a_function_of_the_api():
    import tulip_testbed as tt

    functions = {name for name in tt.__all__ if callable(getattr(tt, name))}
    packages = {
        p.parent.name for p in MODULES.values() if p.name == "__init__.py" and p.parent != ROOT / NAME
    }
    packages |= {p.stem for p in (ROOT / NAME).glob("*.py")}
    assert not functions & packages


def test_only_the_command_line_prints():
    for module, path in MODULES.items():
        if room(module) in FLOW:
            calls = [node.func for node in nodes(path) if isinstance(node, ast.Call)]
            assert not [one for one in calls if isinstance(one, ast.Name) and one.id == "print"], module


@pytest.mark.parametrize(
    ("library", "owners"),
    [
        ("mink", r"identification\.inverse_kinematics"),
        ("yaml", r"experiments\.protocols\.motion"),
        ("plotly", r"pages\.\w*figures"),
        ("rerun", r"viewer\.\w+"),
        ("dm_control", r"sim\.composer"),
        ("dm_env", r"sim\.composer"),
        ("tyro", r"cli\.\w+"),
        ("rich", r"(cli\.terminal|base\.table(_layout)?)"),
        ("jinja2", r"pages\.\w+"),
        ("pandas", r"(base\.table|measurements\.data|experiments\.correlations)"),
    ],
)
def test_a_library_has_one_room(library, owners):
    for module, path in MODULES.items():
        if any(n.split(".")[0] == library for n in imported(path)):
            assert re.fullmatch(rf"{NAME}\.{owners}", module), module


MOST = 390  # s of processor time, half of it on each of two cores
STALE = 0.05  # of the tests may be new or gone since the record was made


def test_the_default_suite_keeps_to_its_processor_time():
    durations = read_durations()
    assert sum(durations.values()) <= MOST, "make tests cheaper or mark them slow, then `make durations`"


def test_the_record_of_durations_is_current():
    recorded, present = set(read_durations()) - {OUTSIDE}, default_tests()
    new, gone = sorted(present - recorded), sorted(recorded - present)
    assert len(new) <= STALE * len(present), f"not recorded, run `make durations`: {new[:10]} ..."
    assert len(gone) <= STALE * len(present), f"recorded, but gone, run `make durations`: {gone[:10]} ..."
