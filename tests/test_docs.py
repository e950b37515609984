"""The documentation: its navigation, paths, commands and notebooks."""

import asyncio
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import nbformat
import pytest
import yaml
from nbclient import NotebookClient

from tests.documented import ROOT, WIDTH, command_lines, matches, output, steps
from tulip_testbed.cli.main import command_of, read_arguments, split_name

DOCS = ROOT / "docs"
NAMED = re.compile(r"\bdocs/[A-Za-z0-9_/-]+\.(?:md|png|csv)")
# What a browser loads by itself; a plain link is none of it.
LOADED = (
    re.compile(r"""<(?!a\b)\w+\b[^>]*?\ssrc(?:set)?=["']?((?:https?:)?//[^"'\s>]+)"""),
    re.compile(r"""<link\b(?![^>]*rel=["']?canonical)[^>]*?\shref=["']?((?:https?:)?//[^"'\s>]+)"""),
    re.compile(r"""url\(["']?((?:https?:)?//[^"')]+)"""),
    re.compile(r"""@import\s+["']((?:https?:)?//[^"']+)"""),
)


def navigation() -> list[str]:
    class Loader(yaml.SafeLoader):
        pass

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)
    nav = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)["nav"]

    def pages(entry):
        if isinstance(entry, str):
            return [entry]
        return [p for part in (entry.values() if isinstance(entry, dict) else entry) for p in pages(part)]

    return pages(nav)


def test_the_navigation_lists_every_page_once():
    assert sorted(navigation()) == sorted(str(p.relative_to(DOCS)) for p in DOCS.rglob("*.md"))


def test_every_path_into_the_docs_exists():
    files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True)
    named = {}
    for name in files.stdout.split("\0"):
        path = ROOT / name
        if name and path.is_file() and path.suffix in (".md", ".py", ".toml", ".ipynb", ".yml", "", ".j2"):
            named |= dict.fromkeys(NAMED.findall(path.read_text(encoding="utf-8")), name)
    assert len(named) > 30
    assert {page: where for page, where in named.items() if not (ROOT / page).exists()} == {}


def test_the_site_loads_nothing_from_elsewhere():
    """The site is built by `make docs`; here what was built is read."""
    built = [p for p in (ROOT / "site").rglob("*") if p.suffix in (".html", ".css")]
    if not built:
        pytest.skip("`make docs` has not been run")
    loaded = {
        str(page): [a for pattern in LOADED for a in pattern.findall(page.read_text())] for page in built
    }
    assert not any(loaded.values()), loaded


TUTORIALS = [
    f"docs/tutorials/{name}.md" for name in ("first-identification", "hidden-effect", "first-day")
]  # in the order in which a user reads them
PAGES = ["README.md", *TUTORIALS, "docs/how-to/next-experiment.md", "docs/how-to/your-data.md"]
EVERY = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_pages_in_order_in_one_folder_print_what_they_show(slow, tmp_path, monkeypatch):
    assert sorted(TUTORIALS) == sorted(str(path.relative_to(ROOT)) for path in DOCS.glob("tutorials/*.md"))
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", WIDTH)
    for page in PAGES if slow else TUTORIALS[:1]:
        names: dict = {}
        for step in steps(page):
            if step.slow and not slow:
                continue
            said = output(step, names)
            if step.shown is not None:
                assert matches(step.shown, said), f"{page}: {step.code}\n--- printed ---\n{said}"


def test_every_command_of_every_page_can_be_parsed():
    lines = [(page, line) for page in EVERY for line in command_lines(page)]
    assert len(lines) > 40
    for page, line in lines:
        name, arguments = split_name(shlex.split(line)[1:])
        if arguments == ["--help"]:
            continue
        try:
            read_arguments(str(name), command_of(name), arguments)
        except SystemExit:
            pytest.fail(f"{page}: {line}")


EXAMPLES = Path(__file__).parent.parent / "examples"
NOTEBOOKS = [pytest.param(path, id=path.stem) for path in sorted(EXAMPLES.glob("*.ipynb"))]


def printed(notebook):
    """The text of every output, cell by cell, without how long it took."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    texts = [
        [out.get("text") or out.get("data", {}).get("text/plain", "") for out in cell.outputs]
        for cell in cells
    ]
    return [[re.sub(r"after \d+ s\b", "after ... s", text) for text in cell] for cell in texts]


@pytest.mark.slow  # test_api.py calls the same functions
@pytest.mark.filterwarnings("default")  # jupyter's own
@pytest.mark.parametrize("path", NOTEBOOKS)
def test_a_notebook_prints_what_is_committed(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    committed = nbformat.read(path, as_version=4)
    again: Any = nbformat.read(path, as_version=4)
    client = NotebookClient(again, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    asyncio.run(client.async_execute())
    for cell in again.cells:
        if cell.cell_type == "code":
            cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
    assert printed(again) == printed(committed)
