"""The layout of a table of text: which of its columns a width has room for, and how wide each is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import wrap

from tulip_testbed.base.column import Column

GAP = 2  # blanks between two columns
COMFORTABLE = 32  # characters of a column of text that wraps without being hard to read
SHORT_TEXT = 12  # characters of a text that does not wrap
SHORT_HEADING = 9  # characters of a heading that does not wrap unless it must
LONGEST_WORD = 48  # characters; longer ones, such as hashes, are broken

Texts = Sequence[Sequence[str]]


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


def whole_width(columns: Sequence[Column], texts: Texts) -> int:
    """Return the width from which on no column is left out and none is hard to read."""
    return _room(one.comfortable for one in _widths(columns, texts))


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
