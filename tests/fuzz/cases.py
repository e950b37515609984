"""Mutations of a folder: a name, what it does with it, and what has to come of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

Rng = np.random.Generator


@dataclass(frozen=True)
class Expected:
    """What has to come of a mutated input.

    Attributes:
        outcome: "refused", "accepted" or "either".
        words: what a refusal's message has to hold.
        as_before: an accepted input has to give what the intact one gave; else what an
            independent reading of the mutated one gives.
    """

    outcome: str
    words: tuple[str, ...] = ()
    as_before: bool = False


def refused(*words: str) -> Expected:
    return Expected("refused", words)


def same(*words: str) -> Expected:
    return Expected("accepted", as_before=True)


Mutation = Callable[[Path, Rng], Expected]
MUTATIONS: dict[str, Mutation] = {}
MEASUREMENTS_ONLY: set[str] = set()


def mutation(function: Mutation) -> Mutation:
    MUTATIONS[function.__name__] = function
    return function


def measurements_only(function: Mutation) -> Mutation:
    MEASUREMENTS_ONLY.add(function.__name__)
    return mutation(function)


def manifest_of(folder: Path) -> Path:
    path = folder / "manifest.json"
    return path if path.exists() else folder / "plan.json"


def is_plan(folder: Path) -> bool:
    return (folder / "plan.json").exists()


def pick(rng: Rng, items: Any) -> Any:
    items = list(items)
    return items[int(rng.integers(len(items)))]


def rehash(folder: Path) -> None:
    """Let the manifest list the tables as they are."""
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    tables = [p for p in folder.iterdir() if p.suffix in (".csv", ".parquet")]
    content["tables"] = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in tables}
    path.write_text(json.dumps(content, indent=1))


def load_table(folder: Path) -> pa.Table:
    return pyarrow.parquet.read_table(folder / "postures.parquet")


def store(folder: Path, table: pa.Table, rng: Rng, suffix: str | None = None) -> Path:
    """Write the table in one format, drop the other, keep the manifest honest."""
    suffix = suffix or pick(rng, ("parquet", "csv"))
    for other in ("parquet", "csv"):
        (folder / f"postures.{other}").unlink(missing_ok=True)
    path = folder / f"postures.{suffix}"
    if suffix == "parquet":
        pyarrow.parquet.write_table(table, path)
    else:
        pyarrow.csv.write_csv(table, path)
    rehash(folder)
    return path


def columns_of(table: pa.Table, kind: str) -> list[str]:
    """Column names by what the contract says of them."""
    names = [n for n in table.column_names if n not in ("posture", "placement", "support")]
    optional = [n for n in names if n.startswith(("q_command.", "motor."))]
    may_miss = [
        n for n in names if n.startswith(("q_std.", "cell_std.")) or n in ("time", "window", "samples")
    ]
    needed = [n for n in names if n not in optional and n not in may_miss]
    return {"needed": needed, "may_miss": may_miss, "optional": optional}[kind]


def values_of(table: pa.Table, name: str) -> list[Any]:
    return table.column(name).to_pylist()


def with_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    array = values if isinstance(values, pa.Array | pa.ChunkedArray) else pa.array(values)
    return table.set_column(table.column_names.index(name), name, array)


def set_all(table: pa.Table, prefix: str, change: Callable[[np.ndarray], np.ndarray]) -> pa.Table:
    for name in [n for n in table.column_names if n.startswith(prefix)]:
        table = with_column(table, name, change(np.array(values_of(table, name), float)))
    return table
