"""Correlations of an estimate's parameters (eq. 15), by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, NamedTuple, overload

import numpy as np

from tulip_testbed.base.arguments import expect
from tulip_testbed.base.column import Column
from tulip_testbed.base.errors import InputError, UnknownNameError, choices, listed, shortened
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.identification.statistics import HIGH_CORRELATION


class Pair(NamedTuple):
    """Two parameters by name and their correlation."""

    a: str
    b: str
    rho: float


@dataclass(frozen=True, repr=False)
class Pairs(Shown, Sequence[Pair]):
    """High correlations; shown as a table.

    Attributes:
        level: that all of them exceed in size.
    """

    pairs: tuple[Pair, ...]
    level: float

    @overload
    def __getitem__(self, index: int) -> Pair: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Pair, ...]: ...

    def __getitem__(self, index: int | slice) -> Pair | tuple[Pair, ...]:
        return self.pairs[index]

    def __len__(self) -> int:
        return len(self.pairs)

    def table(self) -> Table:
        """Return one row per pair."""
        columns = (Column("parameter"), Column("and"), Column("correlation", format="+.4f"))
        return Table(f"Correlations above {self.level:g} in size (eq. 15)", columns, self.pairs)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per pair."""
        return self.table().frame()

    def parts(self) -> list[Table | str]:
        """Return the pairs, or a sentence where there are none."""
        return [self.table()] if self.pairs else [f"No correlation above {self.level:g}."]


def parameter_index(name: str | int, numbers: np.ndarray, names: tuple[str, ...]) -> int:
    """Return the place of a parameter, given by name or number, among those of an estimate.

    Args:
        numbers, names: of the estimate's parameters, (p,).
    """
    if name in names:
        return names.index(str(name))
    if isinstance(name, Integral) and name in numbers:
        return numbers.tolist().index(name)
    raise UnknownNameError(
        f"unknown parameter {shortened(repr(name))}; {choices(name, names)}, or their numbers "
        f"{listed(numbers)}"
    )


@dataclass(frozen=True, repr=False)
class Correlations(Shown):
    """Correlations of p parameters.

    Attributes:
        numbers, names: of the parameters, (p,).
        matrix: eq. 15, (p, p).
    """

    numbers: np.ndarray
    names: tuple[str, ...]
    matrix: np.ndarray

    def __getitem__(self, pair: tuple[str | int, str | int]) -> float:
        """Return the correlation of two parameters, given by name or number.

        Raises:
            UnknownNameError: there is none; lists the names that are close and those that are valid.
        """
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise UnknownNameError(
                f"found {shortened(repr(pair))}, expected two parameters: "
                f'correlations["{self.names[0]}", "{self.names[-1]}"]'
            )
        a, b = (parameter_index(name, self.numbers, self.names) for name in pair)
        return float(self.matrix[a, b])

    def above(self, level: float = HIGH_CORRELATION) -> Pairs:
        """Return the pairs whose correlation exceeds a level in size.

        Raises:
            InputError: a level below 0 or above 1.
        """
        expect("level", level, float)
        if not 0 <= level <= 1:
            raise InputError(f"level: found {level:g}, expected 0 to 1")
        found = np.argwhere(np.triu(np.abs(self.matrix) > level, k=1))
        pairs = (Pair(self.names[a], self.names[b], float(self.matrix[a, b])) for a, b in found)
        return Pairs(tuple(pairs), level)

    def to_frame(self) -> Any:
        """Return the matrix as a pandas DataFrame with the names as its index and columns, (p, p)."""
        import pandas as pd

        return pd.DataFrame(self.matrix, index=list(self.names), columns=list(self.names))

    def parts(self) -> list[Table | str]:
        """Return the number of parameters and the high correlations."""
        return [f"Correlations of {len(self.names)} parameters.", *self.above().parts()]
