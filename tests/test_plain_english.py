"""The style check of `make lint`: it finds phrases in sentences, and leaves code alone."""

from pathlib import Path

import pytest

from tests import plain_english


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write a file of a small repository and return its findings."""
    monkeypatch.setattr(plain_english, "ROOT", tmp_path)

    def findings(name: str, text: str) -> list[str]:
        path: Path = tmp_path / name
        path.write_text(text)
        return plain_english.findings([path])

    return findings


def test_a_phrase_is_found_across_lines(write):
    found = write(
        "page.md", "# Title\n\nThe two are told\napart. `told apart` is code.\n\n```\ntold apart\n```\n"
    )
    assert found == ['page.md:3: found "told apart", write "distinguish" or "distinguished" instead']


def test_strings_and_docstrings_are_read_but_no_names(write):
    source = (
        '"""Build.\n\nThe boards lie beside it.\n"""\n\nbeside = f"{1} lies beside {2}"\nkey = "beside"\n'
    )
    advice = 'write "next to", "in addition to", "together with" or "compared with" instead'
    assert write("module.py", source) == [
        f'module.py:3: found "beside", {advice}',
        f'module.py:6: found "beside", {advice}',
    ]


def test_a_question_is_no_clause_used_as_a_noun(write):
    assert not write("page.md", "What does it find? Find out what it finds.\n")
    assert len(write("page.md", "What it finds is printed.\n")) == 1


def test_every_phrase_has_a_replacement():
    for pattern, write in plain_english.phrases():
        assert write.strip(), pattern.pattern
