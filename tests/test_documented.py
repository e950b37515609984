"""The docs: every command can be parsed; those of the tutorials run and print what the page shows.

The blocks that a page marks with `<!-- slow -->` run in `make test-docs` only.
"""

import shlex

import pytest

from tests.documented import ROOT, WIDTH, command_lines, matches, output, steps
from tulip_testbed.cli.main import command_of, read_arguments, split_name

TUTORIALS = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs" / "tutorials").glob("*.md"))
PAGES = [*TUTORIALS, "docs/how-to/next-experiment.md", "docs/how-to/your-data.md"]
EVERY = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]


def play(page: str, slow: bool, folder, monkeypatch) -> None:
    if not (folder / "docs").exists():
        (folder / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", WIDTH)
    names: dict = {}
    for step in steps(page):
        if step.slow and not slow:
            continue
        printed = output(step, names)
        if step.shown is not None:
            assert matches(step.shown, printed), f"{page}: {step.code}\n--- printed ---\n{printed}"


@pytest.mark.parametrize("page", PAGES)
def test_the_quick_blocks_of_a_page_print_what_it_shows(page, tmp_path, monkeypatch):
    play(page, False, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_whole_page_prints_what_it_shows(page, tmp_path, monkeypatch):
    play(page, True, tmp_path, monkeypatch)


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


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_shows_the_output_of_its_commands(page):
    told = [step for step in steps(page) if step.shown is not None]
    assert len(told) > 3


@pytest.mark.parametrize(
    ("shown", "same"),
    [
        ("a 1\nb 2\nc 3\n", True),
        ("a 1\n...\n", True),
        ("...\nb 2\n...\n", True),
        ("a 1\nb ...\nc 3\n", True),
        ("a 1\nb 2\nc 3\n...\n", True),
        ("a 1\nc 3\n", False),
        ("...\nb 2\n", False),
        ("a 1\nb 2\nc 30\n", False),
        ("a .\n...\n", False),
    ],
)
def test_dots_stand_for_anything_and_for_nothing_else(shown, same):
    assert matches(shown, "\na 1  \nb 2\nc 3\n\n") is same


PAGE = """
```console
$ echo a \\
    b > file
$ cat file
a b
```

<!-- slow -->
```console
$ cat file
no 1
```

```python
two = 2
```
```python
print(two)
```
```text
2
```
"""


def test_a_page_is_played_in_order_and_its_slow_blocks_are_left_out(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert [step.slow for step in steps(str(page))] == [False, False, True, False, False]
    play(str(page), False, tmp_path, monkeypatch)
    with pytest.raises(AssertionError, match=r"cat file\n *--- printed ---\n *a b"):
        play(str(page), True, tmp_path, monkeypatch)
    page.write_text(PAGE.replace("\n2\n", "\n3\n"))
    with pytest.raises(AssertionError, match=r"print\(two\)"):
        play(str(page), False, tmp_path, monkeypatch)


def test_a_command_that_fails_is_noticed(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("```console\n$ tulip check nowhere\n...\n```\n")
    with pytest.raises(AssertionError, match="no such measurement folder"):
        play(str(page), False, tmp_path, monkeypatch)
