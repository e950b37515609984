"""Tables as text, HTML, Markdown and data frame, and what the commands print: nothing in a name steers it."""

import html as standard
import json
import math
from io import StringIO
from queue import Queue

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from tests.fuzz.documents import HOSTILE
from tulip_testbed.base.column import Column
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import STYLES, Cell, Shown, Table
from tulip_testbed.cli import terminal
from tulip_testbed.cli.terminal import PIPE_WIDTH, print_json, refuse, say, show, show_whole


def made(rows=()):
    columns = (
        Column("no.", format="d"),
        Column("parameter"),
        Column("estimate", "mm", ".2f", 1e3),
        Column("interval", "%", ".0f", 100, extra=True),
    )
    return Table("Parameters", columns, rows, "A note.")


ROWS = ([1, "torso.x", Cell(-0.01172, "fail"), (0.5, 0.75)], [2, "right_hip_yaw.x", None, [0.25, 1.0]])


@pytest.mark.parametrize(
    ("value", "spec", "text"),
    [
        (820.0, ".2g", "820"),
        (-820.4, ".2g", "-820"),
        (820.0, "+.2g", "+820"),
        (210558.5, ".4g", "210558"),
        (0.00012, ".2g", "0.00012"),
        (3.2e-9, ".2g", "3.2e-9"),
        (1e300, ".2f", "1e300"),
        (123456789, "d", "123456789"),
        (-0.001, ".2f", "0.00"),
        (0.001, "+.2f", "0.00"),
        (-1.25, "+.1f", "-1.2"),
        (math.inf, ".2f", "-"),
        (math.nan, ".2f", ""),
    ],
)
def test_numbers_are_readable(value, spec, text):
    assert number(value, spec) == text
    assert number(np.float64(value), spec if spec != "d" else ".0f") == text or spec == "d"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (True, "yes"),
        (False, "no"),
        ("any", "any"),
        (0.12345, "12.3"),
        ((0.5, 0.75), "50.0 to 75.0"),
        ([0.5, 0.75], "50.0 to 75.0"),
        ((-math.inf, 0.75), "at most 75.0"),
        ((0.5, math.inf), "at least 50.0"),
        ((0.6, 0.5, 0.75), "60.0 (50.0 to 75.0)"),
        ((0.6, -math.inf, math.inf), "60.0 (no interval)"),
    ],
)
def test_values_of_a_column_of_numbers(value, text):
    assert Column("share", "%", ".1f", 100).text(value) == text


@pytest.mark.parametrize("name", [name for name in HOSTILE if 1 < len(name) < 100])
def test_a_hostile_name_shows_as_it_is_and_steers_nothing(name):
    table = Table(name, (Column(name, name), Column("x")), [[name, Cell(name, "fail")]], name)
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in name)
    screen = StringIO()
    Console(file=screen, force_terminal=True, width=300, color_system=None).print(table)
    for text in (table.text(300), screen.getvalue()):
        assert text.count(escaped) >= 6
        assert all(line.isprintable() for line in text.splitlines())
    page = table.html()
    assert page.count(standard.escape(escaped)) >= 6
    assert "<script" not in page
    assert page.isprintable() or all(line.isprintable() for line in page.splitlines())
    assert table.markdown().count("\n") == 2
    assert table.markdown().replace("\\|", "").count("|") == 9
    page.encode()


@given(st.lists(st.text(max_size=30), min_size=1, max_size=4), st.integers(1, 120))
def test_any_text_at_any_width(texts, width):
    table = Table(texts[0], tuple(Column(f"c{k}") for k in range(len(texts))), [texts], texts[-1])
    lines = table.text(width).splitlines()
    assert all(line.isprintable() for line in lines)
    shown = "".join("".join(lines).split())
    assert all(c in shown for text in table.texts[0] for c in text if not c.isspace())


def test_html():
    page = made(ROWS).html()
    assert '<td class="number fail">-11.72</td>' in page
    assert '<th scope="col" class="number">estimate <span>mm</span></th>' in page
    assert "<caption>Parameters</caption>" in page
    assert '<p class="note">A note.</p>' in page
    assert made(ROWS)._repr_html_() == page


def test_frame_holds_plain_numbers_in_the_units_that_it_names():
    frame = made(ROWS).frame()
    assert list(frame.columns) == [
        "no.",
        "parameter",
        "estimate [mm]",
        "interval low [%]",
        "interval high [%]",
    ]
    assert frame["estimate [mm]"].iloc[0] == pytest.approx(-11.72)
    assert math.isnan(frame["estimate [mm]"].iloc[1])
    assert frame["no."].tolist() == [1, 2]
    assert frame["interval high [%]"].tolist() == [75, 100]
    assert pd.api.types.is_numeric_dtype(frame["estimate [mm]"])


def test_markdown():
    assert made(ROWS).markdown().splitlines() == [
        "| no. | parameter | estimate [mm] | interval [%] |",
        "| ---: | --- | ---: | ---: |",
        "| 1 | torso.x | -11.72 | 50 to 75 |",
        "| 2 | right_hip_yaw.x |  | 25 to 100 |",
    ]


def test_marks_colour_the_terminal_alone():
    table = Table("", (Column("result"),), [[Cell(mark, mark=mark)] for mark in STYLES])
    assert "\x1b" not in table.text()
    screen = StringIO()
    Console(file=screen, force_terminal=True, color_system="standard").print(table)
    assert "\x1b[1;31mfail" in screen.getvalue()
    assert "<td>x</td>" in Table("", (Column("result"),), [[Cell("x", mark='"><script>')]]).html()


class Found(Shown):
    def tables(self):
        return ["Found [red]x[/].", made(ROWS), "Verdict: \x1b[2J<b>"]


def test_a_result_shows_its_tables_and_sentences():
    assert repr(Found()) == f"Found [red]x[/].\n{made(ROWS).text()}\n\nVerdict: \\x1b[2J<b>"
    assert Found()._repr_html_().startswith(f"<p>Found [red]x[/].</p>\n{made(ROWS).html()}\n")
    assert Found()._repr_html_().endswith("<p>Verdict: \\x1b[2J&lt;b&gt;</p>")


TERMINAL_HOSTILE = "[red]x[/] \x1b[2J"
AS_IT_IS = "[red]x[/] \\x1b[2J"
WIDE = Table(
    "Wide",
    tuple(Column(f"c{k}", format="d", extra=k > 0) for k in range(40)),
    [[10**7 + k for k in range(40)]],
)


@pytest.fixture(autouse=True)
def pipe(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)


def test_a_narrow_screen_gets_what_fits_and_is_told(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    show(WIDE)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 50
    assert "10000004" in lines[3]
    assert "Too narrow here for: c5," in " ".join(lines)


def test_sentences_wrap_and_what_is_copied_does_not(capsys):
    text = "word " * 60
    show(text)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= PIPE_WIDTH
    show_whole([text])
    assert capsys.readouterr().out == f"{text}\n"


def test_markup_and_control_characters_show_as_they_are(capsys):
    show(TERMINAL_HOSTILE)
    show_whole([TERMINAL_HOSTILE])
    say(TERMINAL_HOSTILE)
    refuse(TERMINAL_HOSTILE)
    out, err = capsys.readouterr()
    assert out.splitlines() == [AS_IT_IS, AS_IT_IS]
    assert err.splitlines() == [AS_IT_IS, f"tulip: {AS_IT_IS}"]


def test_json_knows_no_infinity(capsys):
    print_json({"a": math.inf, "b": [math.nan, 1.5], "c": {"d": (1, "x")}})
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [None, 1.5], "c": {"d": [1, "x"]}}


@pytest.mark.parametrize(("total", "line"), [(4, "work: 3 of 4"), (None, "work: step 3")])
def test_a_pipe_gets_lines_about_long_work(total, line, monkeypatch):
    lines: Queue[str] = Queue()
    monkeypatch.setattr(terminal, "QUIET", 0.01)
    monkeypatch.setattr(terminal, "say", lines.put)
    with terminal.progress("work", total, 1) as advance:
        advance(2)
        while lines.get(timeout=30) != line:  # those before the step are others
            pass
