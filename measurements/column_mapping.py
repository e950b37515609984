"""Read a laboratory's own table: its names, units and signs are mapped to those of the contract."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from tulip_testbed.base.errors import InputError, choices, listed, look_up, shortened
from tulip_testbed.base.table_files import TableFile

# Factor to the contract's unit, by quantity; None: of mass, to be weighed.
UNITS: dict[str, dict[str, float | None]] = {
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665, "kg": None},
    "moment": {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "speed": {"rad/s": 1.0, "deg/s": np.pi / 180},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3},
    "angular acceleration": {"rad/s2": 1.0, "deg/s2": np.pi / 180},
}
QUANTITIES = {
    **dict.fromkeys(("q", "q_std", "q_command", "motor"), "angle"),
    **dict.fromkeys(("cell", "cell_std"), "force"),
    **dict.fromkeys(("time", "window"), "time"),
    **dict.fromkeys(("speed", "q_rate"), "speed"),
    "q_acceleration": "angular acceleration",
    "acceleration": "acceleration",
}
BY_LAST_WORD = {
    **dict.fromkeys(("fx", "fy", "fz"), "force"),
    **dict.fromkeys(("mx", "my", "mz"), "moment"),
    **dict.fromkeys(("x", "y"), "length"),
    "yaw": "angle",
}
SPREADS = ("q_std", "cell_std", "wrench_std", "window", "speed", "acceleration")  # without a sign


class MappingEntry(BaseModel):
    """A column of the table that stands for one of the contract."""

    model_config = ConfigDict(extra="forbid")
    column: str
    unit: str | None = None
    sign: Literal[1, -1] = 1


class SourceColumn(NamedTuple):
    """A column of a table and its factor to the contract's unit."""

    column: str
    factor: float


def quantity_of(name: str) -> str | None:
    """Return what a column of the contract measures, a key of `UNITS`; None for numbers and texts."""
    first, _, rest = name.partition(".")
    return QUANTITIES.get(first) or BY_LAST_WORD.get(rest.rpartition(".")[2])


def check_mapping(
    mapping: Mapping[str, MappingEntry], known: Iterable[str], where: str, key: str = "mapping"
) -> None:
    """Refuse a mapping of unknown columns, of one column to two readings, or with units that do not fit.

    Args:
        known: names of the contract's columns. where, key: file and key of the mapping, for messages.
    """
    readings: dict[str, str] = {}
    for name, entry in mapping.items():
        look_up("column", name, known, f"{where}: key '{key}'")
        quantity = quantity_of(name)
        if quantity and (first := readings.setdefault(entry.column, name)) != name:
            raise InputError(
                f"{where}: key '{key}.{name}': found column '{shortened(entry.column)}', which is {first} "
                "already; expected another column"
            )
        units = UNITS[quantity] if quantity else {}
        if entry.unit not in units and (units or entry.unit is not None):
            found = "nothing" if entry.unit is None else shortened(repr(entry.unit))
            expected = f"a unit of {quantity}; {choices(entry.unit, units)}" if units else "no unit"
            raise InputError(f"{where}: key '{key}.{name}.unit': found {found}; expected {expected}")
        if entry.sign < 0 and (quantity is None or name.partition(".")[0] in SPREADS):
            raise InputError(f"{where}: key '{key}.{name}.sign': found -1; expected 1: it has no sign")


class MappedTable:
    """A table that is read by the contract's names, in its units and signs.

    Attributes:
        path: the file.
        types: the contract's names of its columns, and those that are not mapped.
    """

    def __init__(self, table: TableFile, mapping: Mapping[str, MappingEntry], gravity: float) -> None:
        self.path, self._table = table.path, table
        self._sources = {name: _source(name, entry, gravity) for name, entry in mapping.items()}
        hidden = {source.column for source in self._sources.values()}
        for name, source in self._sources.items():
            if name not in hidden and table.has(name):
                raise InputError(
                    f"{table.path}: found column '{name}' and, by the manifest's mapping, "
                    f"'{shortened(source.column)}' for it; expected one of them"
                )
        self.types = {name: kind for name, kind in table.types.items() if name not in hidden}
        self.types |= {
            name: table.types[source.column]
            for name, source in self._sources.items()
            if table.has(source.column)
        }

    def __len__(self) -> int:
        return len(self._table)

    def has(self, name: str) -> bool:
        return name in self.types

    def require(self, names: Sequence[str], others: Sequence[str] = ()) -> None:
        """Refuse a table that lacks columns, see `Table.require`."""
        absent = [
            f"'{shortened(source.column)}' (mapped to {name})"
            for name, source in self._sources.items()
            if not self._table.has(source.column)
        ]
        if absent:
            raise InputError(f"{self.path}: found no column {listed(absent)}, expected it by the mapping")
        self._table.require([name for name in names if name not in self._sources], others)

    def numbers(self, name: str, missing_allowed: bool = False) -> np.ndarray:
        """Return a column of finite numbers in the contract's unit, (m,); NaN for allowed missing values."""
        if name not in self._sources:
            return self._table.numbers(name, missing_allowed)
        column, factor = self._sources[name]
        return factor * self._table.numbers(column, missing_allowed)

    def integers(self, name: str) -> np.ndarray:
        """Return a column of integers, (m,)."""
        return self._table.integers(self._column(name))

    def texts(self, name: str, valid: tuple[str, ...]) -> np.ndarray:
        """Return a column of texts, all of them in `valid`, (m,)."""
        return self._table.texts(self._column(name), valid)

    def matrix(self, prefix: str, names: Sequence[str], missing_allowed: bool = False) -> np.ndarray:
        """Return the columns PREFIX.NAME side by side, (m, len(names))."""
        columns = [self.numbers(f"{prefix}.{name}", missing_allowed) for name in names]
        return np.column_stack(columns) if columns else np.zeros((len(self), 0))

    def _column(self, name: str) -> str:
        return self._sources[name].column if name in self._sources else name


def _source(name: str, entry: MappingEntry, gravity: float) -> SourceColumn:
    quantity = quantity_of(name)
    factor = 1.0 if quantity is None or entry.unit is None else UNITS[quantity][entry.unit]
    return SourceColumn(entry.column, entry.sign * (gravity if factor is None else factor))


def mapped_table(
    table: TableFile,
    mapping: Mapping[str, MappingEntry],
    known: Iterable[str],
    gravity: float,
    manifest: Path,
) -> MappedTable:
    """Return a table as it is read through a manifest's mapping."""
    check_mapping(mapping, known, str(manifest))
    return MappedTable(table, mapping, gravity)
