"""A table: columns with units and rows of plain values, rendered as text, HTML, Markdown or a data frame."""

import io
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from textwrap import wrap
from typing import Any

from tulip_testbed.base.column import Column, printable

GAP = 2  # blanks between two columns
COMFORTABLE = 32  # characters of a column of text that wraps without being hard to read
SHORT_TEXT = 12  # characters of a text that does not wrap
SHORT_HEADING = 9  # characters of a heading that does not wrap unless it must
LONGEST_WORD = 48  # characters; longer ones, such as hashes, are broken

Texts = Sequence[Sequence[str]]
WIDTH = 100  # characters of a table that is shown by its repr
STYLES = {
    "pass": "green",
    "good": "green",
    "warn": "yellow",
    "inconclusive": "yellow",
    "fail": "bold red",
    "not evaluated": "dim",
    "moved": "bold",
    "aside": "dim",
}


@dataclass(frozen=True)
class _Widths:
    """Widths of a column [characters].

    Attributes:
        natural: its heading takes two lines at most. whole: none of its cells wraps.
        least: no number and no word is cut.
    """

    natural: int
    whole: int
    least: int

    @property
    def comfortable(self) -> int:
        """Return the width at which wrapped text is not hard to read."""
        return min(self.whole, max(self.least, COMFORTABLE))


def shown_columns(columns: Sequence[Column], texts: Texts, width: int) -> dict[int, int]:
    """Choose the columns that a width has room for.

    Columns that are `extra` are left out from the right until the others fit; then headings wrap, then
    texts. Numbers and words are never cut: a table that still does not fit is wider than asked for.

    Args:
        texts: of the cells, row by row.

    Returns:
        Width by number of the column [characters].
    """
    of = _widths(columns, texts)
    shown = {k: one.natural for k, one in enumerate(of)}

    for k in reversed(range(len(of))):
        if columns[k].extra and _room(of[n].comfortable for n in shown) > width:
            del shown[k]
    for least in ([one.whole for one in of], [one.least for one in of]):
        while _room(shown.values()) > width and (wider := [k for k in shown if shown[k] > least[k]]):
            shown[max(wider, key=shown.__getitem__)] -= 1
    return shown


def _room(widths: Iterable[int]) -> int:
    sizes = list(widths)
    return sum(sizes) + GAP * (len(sizes) - 1)


def _widths(columns: Sequence[Column], texts: Texts) -> list[_Widths]:
    return [_width(column, [row[k] for row in texts]) for k, column in enumerate(columns)]


def _width(column: Column, cells: Sequence[str]) -> _Widths:
    from rich.cells import cell_len

    words = max(cell_len(word) for word in [*column.name.split(), column.unit])
    inside = max(map(cell_len, cells), default=0)
    whole = max(words, inside)
    least = whole
    if not column.format and inside > SHORT_TEXT:
        longest = max(cell_len(word) for text in cells for word in text.split())
        least = max(words, min(longest, LONGEST_WORD))
    return _Widths(max(whole, _heading_width(column.name)), whole, least)


def _heading_width(name: str) -> int:
    """Return the least width at which a heading takes two lines, or one if it is short."""
    if len(name) <= SHORT_HEADING:
        return len(name)
    return next(width for width in range(1, len(name) + 1) if len(wrap(name, width)) <= 2)


@dataclass(frozen=True)
class Cell:
    """A value that a renderer emphasises.

    Attributes:
        value: see `Column.text`.
        mark: one of `STYLES`; others have no effect.
    """

    value: Any
    mark: str = ""


@dataclass(frozen=True, repr=False)
class Table:
    """Rows of values under headings.

    Attributes:
        heads: of the columns: a name of a column of text, the arguments of `Column`, or a `Column` itself.
        rows: values or `Cell`s, one per column.
        note: what a reader needs below it.
    """

    title: str
    heads: Sequence[str | tuple[Any, ...] | Column]
    rows: Sequence[Sequence[Any]]
    note: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", printable(self.title))
        object.__setattr__(self, "note", printable(self.note))

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        return tuple(
            Column(one) if isinstance(one, str) else one if isinstance(one, Column) else Column(*one)
            for one in self.heads
        )

    @cached_property
    def cells(self) -> list[list[Cell]]:
        """Return the rows with every value in a `Cell`."""
        return [[v if isinstance(v, Cell) else Cell(v) for v in row] for row in self.rows]

    @cached_property
    def texts(self) -> list[list[str]]:
        """Return the cells as they are shown; nothing in them steers a terminal."""
        return [
            [column.text(cell.value) for column, cell in zip(self.columns, row, strict=True)]
            for row in self.cells
        ]

    @property
    def whole_width(self) -> int:
        """Return the width from which on no column is left out and none is hard to read."""
        return _room(one.comfortable for one in _widths(self.columns, self.texts))

    def text(self, width: int = WIDTH) -> str:
        """Return the table as plain text.

        Args:
            width: of the screen; see `shown_columns`.
        """
        from rich.console import Console

        screen = Console(file=io.StringIO(), width=width, color_system=None, force_jupyter=False)
        screen.print(self, crop=False, end="")
        assert isinstance(screen.file, io.StringIO)
        return "\n".join(line.rstrip() for line in screen.file.getvalue().splitlines())

    def html(self) -> str:
        """Return the table as an HTML element."""
        heads = "".join(
            f'<th scope="col"{_classes(column, "")}>{escape(column.name)}'
            + (f" <span>{escape(column.unit)}</span></th>" if column.unit else "</th>")
            for column in self.columns
        )
        rows = "".join(
            f"<tr>{''.join(_td(*one) for one in zip(self.columns, row, texts, strict=True))}</tr>\n"
            for row, texts in zip(self.cells, self.texts, strict=True)
        )
        note = f'\n<p class="note">{escape(self.note)}</p>' if self.note else ""
        return (
            f"<table>\n<caption>{escape(self.title)}</caption>\n<thead><tr>{heads}</tr></thead>\n"
            f"<tbody>\n{rows}</tbody>\n</table>{note}"
        )

    def markdown(self) -> str:
        """Return the table as Markdown, without its title."""
        lines = [[column.heading for column in self.columns], *self.texts]
        lines = [[text.replace("|", "\\|") for text in line] for line in lines]
        lines.insert(1, ["---:" if column.format else "---" for column in self.columns])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def frame(self) -> Any:
        """Return a pandas DataFrame of plain numbers in the units that the names of its columns tell.

        An interval becomes two columns, "... low" and "... high".
        """
        import pandas as pd

        content: dict[str, list[Any]] = {}
        for k, column in enumerate(self.columns):
            values = [_scaled(row[k].value, column) for row in self.cells]
            unit = f" [{column.unit}]" if column.unit else ""
            parts = max((len(v) for v in values if isinstance(v, tuple)), default=1)
            for part, name in enumerate({1: ("",), 2: (" low", " high"), 3: ("", " low", " high")}[parts]):
                content[f"{column.name}{name}{unit}"] = [
                    v[part] if isinstance(v, tuple) else v if parts == 1 else None for v in values
                ]
        return pd.DataFrame(content)

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return self.html()

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        """Yield what rich prints: title, table and note."""
        from rich.box import SIMPLE_HEAD
        from rich.cells import cell_len
        from rich.table import Table as Grid
        from rich.text import Text

        shown = shown_columns(self.columns, self.texts, options.max_width)
        grid = Grid(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, GAP - 1, 0, 0))
        for k, width in shown.items():
            column = self.columns[k]
            heading = Text(f"{column.name}\n{column.unit}".strip(), style="bold")
            justify = "right" if column.format else "left"
            grid.add_column(heading, justify=justify, width=width, overflow="fold", vertical="top")
        wraps = [any(cell_len(texts[k]) > width for k, width in shown.items()) for texts in self.texts]
        for n, (row, texts) in enumerate(zip(self.cells, self.texts, strict=True)):
            cells = (Text(texts[k], style=STYLES.get(row[k].mark, "")) for k in shown)
            grid.add_row(*cells, end_section=any(wraps[n : n + 2]))  # a blank line where rows wrap
        yield Text(self.title, style="bold")
        total = sum(shown.values()) + GAP * len(shown)
        yield from console.render(grid, options.update_width(max(total, options.max_width)))
        hidden = [column.name for k, column in enumerate(self.columns) if k not in shown]
        if hidden:
            yield Text(f"Too narrow here for: {', '.join(hidden)}.", style="dim")
        if self.note:
            yield Text(self.note, style="dim")


class Verbatim(str):
    """A line that a person may copy: it is shown whole, at any width."""


class Shown:
    """A result that prints as its tables and sentences, in a terminal and in a notebook."""

    def tables(self) -> list[Table | str]:
        """Return the tables and sentences that terminal, notebook and page show, in this order."""
        raise NotImplementedError

    def __repr__(self) -> str:
        texts = (p.text() + "\n" if isinstance(p, Table) else printable(p) for p in self.tables())
        return "\n".join(texts).rstrip("\n")

    def _repr_html_(self) -> str:
        return "\n".join(
            p.html() if isinstance(p, Table) else f"<p>{escape(printable(p))}</p>" for p in self.tables()
        )


def _scaled(value: Any, column: Column) -> Any:
    if isinstance(value, list | tuple):
        return tuple(_scaled(v, column) for v in value) if column.format else column.text(value)
    scales = column.scale != 1.0 and isinstance(value, int | float)
    return column.scale * value if scales else value


def _td(column: Column, cell: Cell, text: str) -> str:
    # A long name such as effect:target may break where its target begins.
    shown = re.sub(r":(?=\w)", ":<wbr>", escape(text))
    return f"<td{_classes(column, cell.mark)}>{shown}</td>"


def _classes(column: Column, mark: str) -> str:
    names = ["number"] * bool(column.format) + [mark.replace(" ", "-")] * (mark in STYLES)
    return f' class="{" ".join(names)}"' if names else ""
