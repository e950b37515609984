"""The documentation: every page is in the site's navigation, every path that is named exists."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
NAMED = re.compile(r"\bdocs/[A-Za-z0-9_/-]+\.(?:md|png|csv)")
# What a browser loads by itself; a plain link is none of it.
LOADED = (
    re.compile(r"""<(?!a\b)\w+\b[^>]*?\ssrc(?:set)?=["']?((?:https?:)?//[^"'\s>]+)"""),
    re.compile(r"""<link\b(?![^>]*rel=["']?canonical)[^>]*?\shref=["']?((?:https?:)?//[^"'\s>]+)"""),
    re.compile(r"""url\(["']?((?:https?:)?//[^"')]+)"""),
    re.compile(r"""@import\s+["']((?:https?:)?//[^"']+)"""),
)


def loaded_from_elsewhere(text: str) -> list[str]:
    return [address for pattern in LOADED for address in pattern.findall(text)]


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


@pytest.mark.parametrize(
    "text",
    [
        '<script src="https://unpkg.com/iframe-worker/shim"></script>',
        '<link rel="stylesheet" href="//fonts.googleapis.com/css">',
        "a { background: url(https://example.org/a.png) }",
    ],
)
def test_what_a_browser_would_load_is_recognised(text):
    assert loaded_from_elsewhere(text)


def test_the_site_loads_nothing_from_elsewhere():
    """The site is built by `make docs`; here what was built is read."""
    built = [p for p in (ROOT / "site").rglob("*") if p.suffix in (".html", ".css")]
    if not built:
        pytest.skip("`make docs` has not been run")
    assert {str(p): found for p in built if (found := loaded_from_elsewhere(p.read_text()))} == {}
