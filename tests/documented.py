"""The commands and the Python of a documentation page: read, run and compared with what the page shows."""

import contextlib
import io
import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tulip_testbed.cli.main import main

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"(<!-- slow -->\n)?^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FENCED = re.compile(r"^```(\w*)(.*?)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# A page shows what a terminal of this width prints.
WIDTH = "100"


@dataclass(frozen=True)
class Step:
    """A command or a piece of Python, and what the page shows of its output.

    Args:
        code: the command line, or the Python.
        shown: lines, in which `...` stands for anything; None if the page shows no output.
        slow: whether the page marks it.
        python: whether it is Python.
    """

    code: str
    shown: str | None
    slow: bool
    python: bool


def command_lines(page: str) -> Iterator[str]:
    """Yield the `tulip` commands in all blocks of a page, without comments."""
    for _, _, text in FENCED.findall((ROOT / page).read_text()):
        for line in text.replace("\\\n", " ").splitlines():
            command = re.match(r"(?:\$ |.*\| )?(tulip [a-z].*?)(?:\s+#.*)?$", line)
            if command:
                yield command[1]


def blocks(page: str, language: str) -> list[str]:
    """Return the text of a page's fenced blocks of a language."""
    return [text for _, named, text in BLOCK.findall((ROOT / page).read_text()) if named == language]


def steps(page: str) -> Iterator[Step]:
    """Yield a page's commands (`console`) and Python (`python`) in order.

    A `text` block right after a `python` block is what that prints.
    """
    found = [(bool(slow), *rest) for slow, *rest in BLOCK.findall((ROOT / page).read_text())]
    for (slow, language, text), (_, after, told) in zip(found, [*found[1:], (False, "", "")], strict=True):
        if language == "python":
            yield Step(text, told if after == "text" else None, slow, python=True)
        elif language == "console":
            for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                command = re.match(r"(?:.*\\\n)*.*\n", part)
                assert command, f"{page}: found {part!r}, expected a command and the end of its line"
                shown = part[command.end() :]
                yield Step(command[0].strip().replace("\\\n", " "), shown or None, slow, python=False)


def output(step: Step, names: dict[str, Any]) -> str:
    """Run a step in the present folder; return what it prints on stdout and stderr.

    Args:
        names: what the Python of a page has defined so far.
    """
    if not step.python and not step.code.startswith("tulip "):
        return subprocess.run(step.code, shell=True, check=True, capture_output=True, text=True).stdout
    written = io.StringIO()
    with contextlib.redirect_stdout(written), contextlib.redirect_stderr(written):
        if step.python:
            exec(step.code, names)
        else:
            code = main(shlex.split(step.code)[1:])
            assert code == 0, f"$ {step.code}\n{written.getvalue()}exit code {code}"
    return written.getvalue()


def matches(shown: str, printed: str) -> bool:
    """Tell whether a page shows what was printed: `...` is any text in a line, alone on a line any lines."""
    pattern = "".join(
        r"(?:.*\n)*?" if line.strip() == "..." else re.escape(line.rstrip()).replace(r"\.\.\.", ".*") + "\n"
        for line in shown.strip("\n").splitlines()
    )
    trimmed = "\n".join(line.rstrip() for line in printed.strip("\n").splitlines()) + "\n"
    return re.fullmatch(pattern, trimmed) is not None
