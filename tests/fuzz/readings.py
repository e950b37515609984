"""What is compared of a result, and the same read and computed from the files in another way."""

import itertools
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.robot import load_robot


def result(target: str, document: Any) -> dict[str, Any]:
    """Return what is compared of a result."""
    if target == "plan":
        return {name: document[name] for name in ("postures", "placements", "condition_number")}
    if target == "robot":
        masses = {row["link"]: row["mass"] for row in document["standard"]}
        return {"masses": [masses[link] for link in sorted(masses)], "total": document["total_mass"]}
    found = {"postures": document["postures"], "mass": document["mass"][0]}
    return found | {"estimates": document["full"]["value"]}


def reading(target: str, folder: Path) -> dict[str, Any]:
    """Return the same, read and computed another way: the XML's masses, ordinary least squares, ..."""
    if target == "robot":
        return _masses(folder)
    return _planned(folder) if target == "plan" else _identification(folder)


def _masses(folder: Path) -> dict[str, Any]:
    bodies = {str(body.get("name")): body for body in ET.parse(folder / "tulip.xml").iter("body")}
    masses = [float(bodies[link].findall("inertial")[-1].get("mass", "nan")) for link in sorted(bodies)]
    return {"masses": masses, "total": sum(masses)}


def _read_table(folder: Path) -> tuple[pd.DataFrame, dict[str, np.ndarray], np.ndarray]:
    """Return a table of postures, its numbers by column, and the regressor."""
    path, parameters = folder / "postures.parquet", base_parameters(load_robot())
    if path.exists():
        table = pd.read_parquet(path)
    else:
        table = pd.read_csv(path.with_suffix(".csv"), encoding="utf-8-sig")
    numbers = table.filter(regex=r"^(q|cell|plate)\.").astype(float)
    column = {str(name): numbers[name].to_numpy(copy=True) for name in numbers}
    angles = np.column_stack([column[f"q.{j}"] for j in parameters.tree.joints])
    return table, column, stacked_regressor(parameters, angles)


def _planned(folder: Path) -> dict[str, Any]:
    table, _, matrix = _read_table(folder)
    placements = len(set(table["placement"]))
    return {"postures": len(table), "placements": placements, "condition_number": np.linalg.cond(matrix)}


def _identification(folder: Path) -> dict[str, Any]:
    """Solve eq. 8 by least squares."""
    table, column, matrix = _read_table(folder)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8-sig"))
    force, moment = np.zeros(len(table)), np.zeros((len(table), 2))
    for plate, corner in itertools.product(PLATES, CORNERS):
        x, y, yaw = (column[f"plate.{plate}.{axis}"] for axis in ("x", "y", "yaw"))
        (a, b), cell = manifest["plates"][plate]["cells"][corner], column[f"cell.{plate}.{corner}"]
        force += cell
        moment[:, 0] += cell * (x + np.cos(yaw) * a - np.sin(yaw) * b)
        moment[:, 1] += cell * (y + np.sin(yaw) * a + np.cos(yaw) * b)
    estimates = np.linalg.lstsq(matrix, (moment / force[:, None]).ravel(), rcond=None)[0]
    return {"postures": len(table), "estimates": estimates, "mass": np.mean(force / manifest["gravity"])}
