"""Find homemade phrases in the documentation and in the program's sentences: `python -m tests.plain_english`.

The phrases are in `tests/plain_english.txt`, each with a plain replacement. Code in Markdown is not read; of
Python files, docstrings and strings of more than one word are. `make lint` runs this.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.test_architecture import FLOW, NAME

ROOT = Path(__file__).parent.parent
PHRASES = Path(__file__).with_suffix(".txt")
ROOMS = (*FLOW, NAME, "studies")
CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.MULTILINE | re.DOTALL)


def phrases() -> list[tuple[re.Pattern[str], str]]:
    """Return the banned phrases as patterns that match across line breaks, with their replacements."""
    lines = [line for line in PHRASES.read_text().splitlines() if line and not line.startswith("#")]
    pairs = [re.split(r"\s+=>\s+", line) for line in lines]
    return [
        (re.compile(rf"\b(?:{found})(?!\w)".replace(" ", r"\s+"), re.IGNORECASE), write)
        for found, write in pairs
    ]


def found_in(text: str, banned: list[tuple[re.Pattern[str], str]]) -> Iterator[tuple[int, str, str]]:
    """Yield the line within a text, the phrase and its replacement for every banned phrase."""
    for pattern, write in banned:
        for match in pattern.finditer(text):
            yield text.count("\n", 0, match.start()), " ".join(match.group().split()), write


def sentences_of_markdown(source: str) -> list[tuple[int, str]]:
    """Return the text without code, which is blanked so that line numbers stay; its first line is 1."""
    return [(1, CODE.sub(lambda code: re.sub(r"[^\n]", " ", code.group()), source))]


def sentences_of_python(source: str) -> Iterator[tuple[int, str]]:
    """Yield docstrings and strings of more than one word with their first lines; a field reads `{}`."""
    tree = ast.parse(source)
    formatted = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    parts = {id(part) for whole in formatted for part in whole.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            text = node.value
        else:
            continue
        if " " in text.strip():
            yield node.lineno, text


def findings(paths: list[Path]) -> list[str]:
    """Return one line `FILE:LINE: found "...", write "..." instead` for every banned phrase in the files."""
    banned = phrases()
    lines = []
    for path in paths:
        source = path.read_text()
        read = sentences_of_python if path.suffix == ".py" else sentences_of_markdown
        for first, text in read(source):
            for line, found, write in found_in(text, banned):
                place = f"{path.relative_to(ROOT)}:{first + line}"
                lines.append(f'{place}: found "{found}", write {write} instead')
    return sorted(lines)


def files() -> list[Path]:
    """Return the files that people read: README, CONTRIBUTING, docs, and the program's Python files."""
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")]
    code = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    return sorted(set(map(Path.resolve, documents + code)))


if __name__ == "__main__":
    sys.exit("\n".join(findings(files())) or None)
