"""Everything that was set for a run, one value per row."""

from __future__ import annotations

from typing import Any

from tulip_testbed.experiments.document import flattened
from tulip_testbed.sim.column import Column
from tulip_testbed.sim.table import Cell, Table


def settings_table(document: dict[str, Any]) -> Table:
    """Return the values of a run.json."""
    rows = [[name, Cell(value, f"run.{name}")] for name, value in flattened(document).items()]
    return Table("Settings, versions, seed and hashes", (Column("key"), Column("value")), rows)
