"""manifest.json of a measurement folder: its keys and their bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict

from tulip_testbed.sim.measurements.data import Measurements
from tulip_testbed.sim.measurements.table_files import software
from tulip_testbed.sim.robot import CORNERS, PLATES

# Bounds beyond any laboratory: narrow enough that nothing overflows later, wide enough that the preflight
# can still recognise degrees instead of radians and millimetres instead of metres.
MOST_ANGLE = 1e3  # rad
MOST_LENGTH = 1e4  # m, from the base frame to a plate and from a plate to a cell
MOST_FORCE = 1e5  # N, on a cell
MOST_GAIN = 1e6  # Nm/rad, of a servo
LEAST_GRAVITY, MOST_GRAVITY = 0.1, 100.0  # m/s2
LEAST_MASS = 1e-3  # kg
LEAST_DEVIATION = 1e-12  # rad, N, m, kg: smaller ones vanish when squared or make a quotient overflow


def _not_tiny(deviation: float) -> float:
    if 0 < deviation < LEAST_DEVIATION:
        raise ValueError(f"expected 0 or at least {LEAST_DEVIATION:g}")
    return deviation


Length = Annotated[float, Strict(), Field(ge=-MOST_LENGTH, le=MOST_LENGTH, allow_inf_nan=False)]
Point = tuple[Length, Length]
Gravity = Annotated[float, Strict(), Field(ge=LEAST_GRAVITY, le=MOST_GRAVITY, allow_inf_nan=False)]
Mass = Annotated[float, Strict(), Field(ge=LEAST_MASS, le=MOST_FORCE, allow_inf_nan=False)]
NotNegative = Field(ge=0, le=MOST_FORCE, allow_inf_nan=False)
Deviation = Annotated[float, Strict(), NotNegative, AfterValidator(_not_tiny)]
Gain = Annotated[float, Strict(), Field(gt=0, le=MOST_GAIN, allow_inf_nan=False)]
Version = Annotated[int, Strict(), Field(ge=1, le=1)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="allow")


class RobotEntry(_Strict):
    model: str
    sha256: str | None = None
    stance_foot: str
    swing_foot: str


class CellEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    front_left: Point
    front_right: Point
    rear_right: Point
    rear_left: Point


class PlateEntry(_Strict):
    cells: CellEntry
    top_height: Length


class PlatesEntry(_Strict):
    right: PlateEntry
    left: PlateEntry


class MassEntry(_Strict):
    value: Mass
    sd: Deviation


class SensorsEntry(_Strict):
    encoder_sd: Deviation | None
    encoder_resolution: Deviation | None
    cell_sd: Deviation | None
    cell_resolution: Deviation | None
    placement_sd: tuple[Deviation, Deviation, Deviation] | None


class Manifest(_Strict):
    """Content of manifest.json; entries that only software knows are optional."""

    format: Literal["tulip-measurements"]
    version: Version
    robot: RobotEntry
    joints: list[str] = Field(min_length=1)
    plates: PlatesEntry
    weighed_mass: MassEntry | None
    gravity: Gravity
    sensors: SensorsEntry
    gains: dict[str, Gain] | None = None
    tolerances: dict[str, Deviation] | None = None
    created: str | None = None
    software: dict[str, str] | None = None
    tables: dict[str, str | None] | None = None


def _plain(value: Any) -> Any:
    """Return NumPy's numbers as Python's."""
    if isinstance(value, tuple | list):
        return tuple(map(_plain, value))
    return value.item() if isinstance(value, np.generic) else value


def manifest_of(measurements: Measurements, tables: dict[str, str]) -> Manifest:
    """Return the manifest of measurements whose tables have these hashes.

    Raises:
        ValidationError: a figure is out of bounds.
    """
    m = measurements
    plates = {
        plate: {
            "cells": dict(zip(CORNERS, m.cells[p].tolist(), strict=True)),
            "top_height": float(m.top_height[p]),
        }
        for p, plate in enumerate(PLATES)
    }
    weighed = m.weighed_mass
    two = isinstance(weighed, Sequence) and len(weighed) == 2
    mass = {"value": _plain(weighed[0]), "sd": _plain(weighed[1])} if two else weighed
    return Manifest.model_validate(
        {
            "format": "tulip-measurements",
            "version": 1,
            "robot": m.robot,
            "joints": list(m.joints),
            "plates": plates,
            "weighed_mass": mass,
            "gravity": _plain(m.gravity),
            "sensors": {key: _plain(value) for key, value in dataclasses.asdict(m.sensors).items()},
            "gains": dict(m.gains) if isinstance(m.gains, Mapping) else m.gains,
            "tolerances": dict(m.tolerances) if isinstance(m.tolerances, Mapping) else m.tolerances,
            "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "software": software(),
            "tables": tables,
        }
    )
