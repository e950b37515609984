"""A column of a table: its name, its unit, and how its values are shown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tulip_testbed.base.numbers import number


def printable(text: str) -> str:
    """Escape every character that would steer a terminal or cannot be encoded, line ends included."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        name: heading.
        unit: of the numbers as they are shown; "": none.
        format: of numbers, as of `format`; such columns are aligned to the right. "": a column of text.
        scale: factor from the values in the rows to the unit.
        extra: whether the column may be left out where the width does not suffice.
    """

    name: str
    unit: str = ""
    format: str = ""
    scale: float = 1.0
    extra: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", printable(self.name))
        object.__setattr__(self, "unit", printable(self.unit))

    @property
    def heading(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def text(self, value: Any) -> str:
        """Return a value as it is shown.

        Args:
            value: a number, a text, yes or no, None for a blank; in a column of numbers also an interval
                (low, high), of which one end may be infinite, or an estimate with its interval
                (value, low, high); in a column of text also a list.
        """
        if value is None:
            return ""
        if isinstance(value, str):
            return printable(value)
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, list | tuple):
            return self._interval(value) if self.format else ", ".join(map(self.text, value))
        if not self.format:
            return str(value) if isinstance(value, int) else number(value)
        return number(value if self.scale == 1.0 else self.scale * value, self.format)

    def _interval(self, values: Sequence[float]) -> str:
        if None in values:  # too few runs for one
            return ""
        *estimate, low, high = values
        first, last = self.text(low), self.text(high)
        if estimate:
            known = math.isfinite(low) and math.isfinite(high)
            return f"{self.text(estimate[0])} ({f'{first} to {last}' if known else 'no interval'})"
        if math.isnan(low):
            return ""
        if math.isinf(low):
            return f"at most {last}"
        return f"at least {first}" if math.isinf(high) else f"{first} to {last}"
