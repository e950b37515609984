"""Measurement folders of version 2 by hand: contacts, and readings that carry what cells do."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.contacts import WRENCH, Contacts

EXAMPLE = Path(__file__).parent.parent / "docs" / "how-to" / "your-data"
POSE = {"x": 0.01, "y": 0.0, "z": -0.03, "roll": 0.0, "pitch": 0.0, "yaw": 0.5}
FOOT = {"kind": "wrench", "mount": "foot", "channels": list(WRENCH), "covariance": None, "zero": "tared"}
GROUND = {"mount": "ground", "pose": "absent", "below": "absent", "top_height": 0.05}


def contacts_of(**changes: Any) -> list[dict[str, Any]]:
    """Return two six-axis sensors in the feet with other keys; those that are "absent" are left out."""
    entry = FOOT | {"pose": POSE, "below": None} | changes
    entry = {key: value for key, value in entry.items() if value != "absent"}
    return [{"name": side, **entry} for side in ("right", "left")]


def readings(m: Measurements) -> dict[str, np.ndarray]:
    """Return columns of six-axis sensors under each foot that carry what the cells do."""
    columns = {}
    for p, side in enumerate(("right", "left")):
        forces, cells = m.cell_forces[:, 4 * p : 4 * p + 4], m.cells[p]
        channels = (0 * forces[:, 0], 0 * forces[:, 0], forces.sum(axis=1), forces @ cells[:, 1])
        for channel, values in zip(WRENCH, (*channels, -forces @ cells[:, 0], 0 * forces[:, 0]), strict=True):
            columns[f"wrench.{side}.{channel}"] = values
    return columns


def write_contacts(
    folder: Path, plates: Measurements, contacts: Any, columns: Any = None, drop=(), poses=True, **keys: Any
) -> Path:
    """Write the example with other contacts, and with columns more than those of `readings`."""
    folder.mkdir(exist_ok=True)
    manifest = json.loads((EXAMPLE / "manifest.json").read_text())
    manifest |= {"version": 2, "contacts": contacts} | keys
    del manifest["plates"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    left_out = ("cell", "q_std") if poses else ("cell", "q_std", "plate.")
    table = {k: v for k, v in plates.columns().items() if not k.startswith(left_out)}
    table |= readings(plates) | (columns or {})
    pd.DataFrame(table).drop(columns=list(drop)).to_csv(folder / "postures.csv", index=False)
    return folder


def assert_same(one: Any, other: Any) -> None:
    """Compare measurements field by field, to the last bit."""
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, Contacts):
            assert_same(a, b)
        elif isinstance(a, np.ndarray):
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), field.name
        else:
            assert a == b, field.name
