"""Everything that was set for a run, one value a row."""

from __future__ import annotations

from typing import Any

from tulip_testbed.experiments.table import Cell, Column, Table


def settings_table(document: dict[str, Any]) -> Table:
    """Return the values of a run.json."""
    rows = [[name, Cell(value, f"run.{name}")] for name, value in flattened(document).items()]
    return Table("Settings, versions, seed and hashes", (Column("key"), Column("value")), rows)


def flattened(document: Any, name: str = "") -> dict[str, Any]:
    """Return the values of a JSON document by their path with dots."""
    if isinstance(document, dict):
        pairs = document.items()
    elif isinstance(document, list) and any(isinstance(item, dict | list) for item in document):
        pairs = enumerate(document)
    else:
        return {name: document}
    found: dict[str, Any] = {}
    for key, value in pairs:
        found |= flattened(value, f"{name}.{key}" if name else str(key))
    return found
