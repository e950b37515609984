"""What the commands print: whole in a pipe, fitted to a terminal, and nothing in a name steers it."""

import json
import math

import pytest

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Table
from tulip_testbed.cli.terminal import (
    PIPE_WIDTH,
    print_json,
    refuse,
    say,
    show,
    show_whole,
)

HOSTILE = "[red]x[/] \x1b[2J"
AS_IT_IS = "[red]x[/] \\x1b[2J"
WIDE = Table(
    "Wide",
    tuple(Column(f"c{k}", format="d", extra=k > 0) for k in range(40)),
    [[10**7 + k for k in range(40)]],
)


@pytest.fixture(autouse=True)
def pipe(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)


def test_a_pipe_gets_every_column(capsys):
    show(WIDE)
    out = capsys.readouterr().out
    assert all(str(10**7 + k) in out for k in range(40))
    assert "Too narrow" not in out


def test_a_narrow_screen_gets_what_fits_and_is_told(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    show(WIDE)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 50
    assert "10000004" in lines[3]
    assert "Too narrow here for: c5," in " ".join(lines)


def test_tables_stand_apart_and_sentences_do_not(capsys):
    table = Table("T", (Column("a"),), [["b"]])
    show("one", "two", table, "three")
    assert [line.strip() for line in capsys.readouterr().out.splitlines()] == [
        *("one", "two", "", "T", "a", "─", "b", "", "three"),
    ]


def test_sentences_wrap_and_what_is_copied_does_not(capsys):
    text = "word " * 60
    show(text)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= PIPE_WIDTH
    show_whole([text])
    assert capsys.readouterr().out == f"{text}\n"


def test_markup_and_control_characters_show_as_they_are(capsys):
    show(HOSTILE)
    show_whole([HOSTILE])
    say(HOSTILE)
    refuse(HOSTILE)
    out, err = capsys.readouterr()
    assert out.splitlines() == [AS_IT_IS, AS_IT_IS]
    assert err.splitlines() == [AS_IT_IS, f"tulip: {AS_IT_IS}"]


def test_json_knows_no_infinity(capsys):
    print_json({"a": math.inf, "b": [math.nan, 1.5], "c": {"d": (1, "x")}})
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [None, 1.5], "c": {"d": [1, "x"]}}
