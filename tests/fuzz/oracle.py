"""What an accepted input has to give, read and computed another way."""

from __future__ import annotations

import csv
import io
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet

from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.sim.robot import CORNERS, load_robot

TOLERANCE = 1e-6


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """The table as Python values, row by row."""
    path = folder / "postures.parquet"
    if path.exists():
        file = pyarrow.parquet.ParquetFile(path)
        names = [n for n in file.schema_arrow.names if n != "note"]
        table = file.read(columns=names)
        return [
            dict(zip(table.column_names, row, strict=True))
            for row in zip(*table.to_pydict().values(), strict=True)
        ]
    text = (folder / "postures.csv").read_text(encoding="utf-8-sig")
    return list(csv.DictReader(io.StringIO(text)))


def expected_identification(folder: Path) -> dict[str, Any]:
    """Ordinary least squares and total mass, posture by posture."""
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8-sig"))
    parameters = base_parameters(load_robot())
    angles, output, weights = [], [], []
    for row in rows_of(folder):
        angles.append([float(row[f"q.{joint}"]) for joint in parameters.tree.joints])
        force, moment = 0.0, np.zeros(2)
        for plate in ("right", "left"):
            yaw = float(row[f"plate.{plate}.yaw"])
            for corner in CORNERS:
                x, y = manifest["plates"][plate]["cells"][corner]
                place = [
                    float(row[f"plate.{plate}.x"]) + np.cos(yaw) * x - np.sin(yaw) * y,
                    float(row[f"plate.{plate}.y"]) + np.sin(yaw) * x + np.cos(yaw) * y,
                ]
                reading = float(row[f"cell.{plate}.{corner}"])
                force += reading
                moment += reading * np.array(place)
        output += list(moment / force)
        weights.append(force / manifest["gravity"])
    matrix = stacked_regressor(parameters, np.array(angles))
    return {
        "postures": len(weights),
        "estimates": np.linalg.lstsq(matrix, np.array(output), rcond=None)[0],
        "mass": np.mean(weights),
    }


def found_identification(document: dict[str, Any]) -> dict[str, Any]:
    return {
        "postures": document["postures"],
        "estimates": np.array([row["estimate"] for row in document["full"]["parameters"]], float),
        "mass": document["total_mass"]["estimate"],
    }


def expected_plan(folder: Path) -> dict[str, Any]:
    parameters = base_parameters(load_robot())
    rows = rows_of(folder)
    angles = np.array([[float(row[f"q.{joint}"]) for joint in parameters.tree.joints] for row in rows])
    return {
        "postures": len(rows),
        "placements": len({float(row["placement"]) for row in rows}),
        "condition": np.linalg.cond(stacked_regressor(parameters, angles)),
    }


def found_plan(document: dict[str, Any]) -> dict[str, Any]:
    return {
        "postures": document["postures"],
        "placements": document["placements"],
        "condition": document["condition_number"],
    }


def expected_robot(folder: Path) -> dict[str, Any]:
    """Every <inertial>'s mass, by body."""
    masses: dict[str, float] = {}
    for body in ET.parse(folder / "tulip.xml").iter("body"):
        inertial = [child for child in body if child.tag == "inertial"]
        masses[body.get("name", "")] = float(inertial[-1].get("mass", "nan")) if inertial else np.nan
    return {"masses": masses, "total": sum(masses.values())}


def found_robot(document: dict[str, Any]) -> dict[str, Any]:
    masses = {row["link"]: row["mass"] for row in document["standard"]}
    return {"masses": masses, "total": document["total_mass"]}


def difference(expected: Any, found: Any) -> str:
    """Where two results differ by more than rounding; "" where they do not."""
    if isinstance(expected, dict):
        if expected.keys() != found.keys():
            return f"keys {sorted(expected)} against {sorted(found)}"
        return next((text for key in expected if (text := difference(expected[key], found[key]))), "")
    first, second = np.asarray(expected, float), np.asarray(found, float)
    if first.shape != second.shape:
        return f"{first.shape} against {second.shape}"
    scale = max(np.abs(first).max(initial=0.0), 1e-9)
    return "" if np.abs(first - second).max(initial=0.0) <= TOLERANCE * scale else f"{first} against {second}"


OPTIONAL = (  # null: unknown, without a rig, relative to zero
    *("truth", "made", "rig"),
    *("relative_standard_error", "predicted_relative_standard_error_percent"),
)


def not_finite(value: Any) -> bool:
    """Whether a JSON document holds a null where a number was computed."""
    if isinstance(value, dict):
        return any(not_finite(v) for k, v in value.items() if k not in OPTIONAL)
    if isinstance(value, list):
        return any(not_finite(item) for item in value)
    return value is None
