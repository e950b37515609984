"""Everything that was set for a run, one value per row."""

from __future__ import annotations

from typing import Any

from tulip_testbed.base.column import Column
from tulip_testbed.base.document import flattened
from tulip_testbed.base.table import Cell, Table

RUN = "Run"  # title of the values that no other table holds


def settings_tables(document: dict[str, Any]) -> list[Table]:
    """Return the values of a run.json, a table for each of its parts."""
    parts: dict[str, list[list[Any]]] = {RUN: []}
    for name, value in flattened(document).items():
        part, _, rest = name.partition(".")
        title, shown = (part.capitalize(), rest) if rest else (RUN, name)
        parts.setdefault(title, []).append([shown, Cell(value, f"run.{name}")])
    columns = (Column("key"), Column("value"))
    return [Table(title, columns, rows) for title, rows in parts.items() if rows]
