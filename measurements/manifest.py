"""manifest.json of a measurement folder: its keys and their bounds, in both versions."""

import dataclasses
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict

from tulip_testbed.base.table_files import software
from tulip_testbed.measurements.bounds import Angle, Deviation, Gain, Gravity, Length, Mass, Point
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.column_mapping import MappingEntry
from tulip_testbed.measurements.contact_entries import Pair, entries_of
from tulip_testbed.measurements.data import Measurements
from tulip_testbed.measurements.motion_table import LEAST_RATE, MOST_RATE

MOST_WINDOW = 10.0  # s, to which samples of a motion are reduced
OPTIONAL = (
    "gains",
    "tolerances",
    "constant_joints",
    "conventions",
)  # keys that are written only if they hold something


class _Strict(BaseModel):
    model_config = ConfigDict(extra="allow")


class MotionEntry(BaseModel):
    """How a robot that moves was sampled [Hz], and the windows to which the samples are reduced [s]."""

    model_config = ConfigDict(extra="forbid")
    window: Annotated[float, Strict(), Field(gt=0, le=MOST_WINDOW, allow_inf_nan=False)]
    rate: Annotated[float, Strict(), Field(ge=LEAST_RATE, le=MOST_RATE, allow_inf_nan=False)]


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


class ConstantEntry(_Strict):
    value: Angle
    sd: Deviation


class ConventionEntry(_Strict):
    """A convention of the log, see `StatedConvention`."""

    what: str
    hypothesis: str
    log_likelihood: float
    applied: bool


def _of_version_two(value: Any) -> None:
    raise ValueError("expected no such key in version 1, which has 'plates'; set 'version' to 2")


class Manifest(_Strict):
    """Content of manifest.json; entries that only software knows are optional."""

    format: Literal["tulip-measurements"]
    version: Annotated[int, Strict(), Field(ge=1, le=2)]
    robot: RobotEntry
    joints: list[str] = Field(min_length=1)
    plates: PlatesEntry | None = None
    contacts: Pair | None = None
    weighed_mass: MassEntry | None
    gravity: Gravity
    sensors: SensorsEntry
    gains: dict[str, Gain] | None = None
    tolerances: dict[str, Deviation] | None = None
    constant_joints: dict[str, ConstantEntry] | None = None
    conventions: list[ConventionEntry] | None = None
    mapping: dict[str, MappingEntry] | None = None
    motion: MotionEntry | None = None
    session: str | None = None
    manipulations: list[str] | None = None
    created: str | None = None
    software: dict[str, str] | None = None
    tables: dict[str, str | None] | None = None


class ManifestOne(Manifest):
    """Version 1: four cells under each foot, on plates."""

    plates: PlatesEntry  # pyrefly: ignore[bad-override-mutable-attribute]
    contacts: Annotated[Any, BeforeValidator(_of_version_two)] = None


class ManifestTwo(Manifest):
    """Version 2: contact sensors of any kind."""

    contacts: Pair  # pyrefly: ignore[bad-override-mutable-attribute]


def manifest_from(content: Mapping[str, Any]) -> Manifest:
    """Return a manifest of either version from the content of its file.

    Raises:
        ValidationError: a key is missing or a figure is out of bounds.
    """
    version = ManifestTwo if content.get("version") == 2 else ManifestOne
    return version.model_validate(content)


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
    weighed = m.weighed_mass
    two = isinstance(weighed, Sequence) and len(weighed) == 2
    mass = {"value": _plain(weighed[0]), "sd": _plain(weighed[1])} if two else weighed
    content = {
        "format": "tulip-measurements",
        "version": 1 if m.contacts is None else 2,
        "robot": m.robot,
        "joints": list(m.joints),
        **_contact_keys(m),
        "weighed_mass": mass,
        "gravity": _plain(m.gravity),
        "sensors": {key: _plain(value) for key, value in dataclasses.asdict(m.sensors).items()},
        "gains": dict(m.gains) if isinstance(m.gains, Mapping) else m.gains,
        "tolerances": dict(m.tolerances) if isinstance(m.tolerances, Mapping) else m.tolerances,
        "constant_joints": _constants(m),
        "conventions": [dataclasses.asdict(one) for one in m.conventions],
        **_experiment_keys(m),
        "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "software": software(),
        "tables": tables,
    }
    return manifest_from(content)


def _experiment_keys(m: Measurements) -> dict[str, Any]:
    """Return session and manipulations; those of several experiments are in folders of their own."""
    if len(m.experiments) != 1:
        return {}
    (one,) = m.experiments
    return {"session": one.session or None, "manipulations": list(one.manipulations) or None}


def _contact_keys(m: Measurements) -> dict[str, Any]:
    if m.contacts is not None:
        return {"contacts": entries_of(m.contacts, m.top_height)}
    plates = {
        plate: {
            "cells": dict(zip(CORNERS, m.cells[p].tolist(), strict=True)),
            "top_height": float(m.top_height[p]),
        }
        for p, plate in enumerate(PLATES)
    }
    return {"plates": plates}


def _constants(m: Measurements) -> Any:
    if not isinstance(m.constant_joints, Mapping):
        return m.constant_joints
    return {
        joint: {"value": float(m.joint_angles[0, m.joints.index(joint)]), "sd": _plain(sd)}
        for joint, sd in m.constant_joints.items()
    }


def unset_keys(measurements: Measurements) -> set[str]:
    """Name the keys of a manifest that measurements do not need."""
    empty = {name for name in OPTIONAL if not getattr(measurements, name)}
    empty |= {name for name in ("session", "manipulations") if not _experiment_keys(measurements).get(name)}
    return empty | {"mapping", "motion", "contacts" if measurements.contacts is None else "plates"}
