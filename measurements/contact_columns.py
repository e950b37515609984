"""Columns of the contact sensors of a measurement folder, and how they are read."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.measurements.column_mapping import MappedTable
from tulip_testbed.measurements.contact_entries import CellsEntry, CopEntry, WrenchEntry, contacts_of, pose_of
from tulip_testbed.measurements.contacts import COP, VERTICAL, Contacts, covariance_of_cops, wrenches_of_cops

Entries = Sequence[WrenchEntry | CopEntry | CellsEntry]
POSE_AXES = ("x", "y", "yaw")
NO_CELLS = np.zeros((2, 0, 2))  # places of the cells of plates that have none


def reading_columns(entries: Entries, prefix_end: str = "") -> list[str]:
    """List the columns of readings without plates' poses, or, by "_std", of their s.d.; cops have none."""
    names = []
    for entry in entries:
        if isinstance(entry, WrenchEntry):
            names += [f"wrench{prefix_end}.{entry.name}.{channel}" for channel in entry.channels]
        elif isinstance(entry, CellsEntry):
            names += [f"cell{prefix_end}.{entry.name}.{cell}" for cell in entry.cells]
        elif not prefix_end:
            names += [f"cop.{entry.name}.{axis}" for axis in COP]
    return names


def pose_columns() -> list[str]:
    return [f"plate.{plate}.{axis}" for plate in PLATES for axis in POSE_AXES]


def read_poses(table: MappedTable) -> np.ndarray:
    """Return the recorded poses of both plates, (m, 2, 3) [m, m, rad]."""
    return np.stack([table.matrix(f"plate.{plate}", POSE_AXES) for plate in PLATES], axis=1)


def read_contacts(
    entries: Entries, table: MappedTable, support: np.ndarray, cell_sd: float | None
) -> dict[str, Any]:
    """Read the fields of `Measurements` that the contacts give.

    Args:
        entries: right and left, of one kind.
        support: (m,).
        cell_sd: s.d. of a cell's averaged reading [N]; None: unknown.
    """
    on_ground = entries[0].mount == "ground"
    place = {"top_height": np.array([entry.top_height if on_ground else 0.0 for entry in entries], float)}
    if on_ground:
        place["plate_poses"] = read_poses(table)
    loaded = np.stack([support != other for other in ("left", "right")])  # by the support that lifts it
    wrenches = [entry for entry in entries if isinstance(entry, WrenchEntry)]
    cops = [entry for entry in entries if isinstance(entry, CopEntry)]
    cells = [entry for entry in entries if isinstance(entry, CellsEntry)]
    if wrenches:
        return place | _read_wrenches(wrenches, table, loaded)
    return place | (_read_cops(cops, table, loaded) if cops else _read_cells(cells, table, loaded, cell_sd))


def _read_wrenches(entries: list[WrenchEntry], table: MappedTable, loaded: np.ndarray) -> dict[str, Any]:
    channels = tuple(entries[0].channels)
    readings = [
        _present(table, "wrench", channels, entry.name, stands)
        for entry, stands in zip(entries, loaded, strict=True)
    ]
    optional = {"wrenches_sd": "wrench_std"} | {
        f"{name}s": name
        for name in ("wrench_rate", "wrench_acceleration", "wrench_jerk")
        if table.has(f"{name}.{entries[0].name}.{channels[0]}")
    }
    return {
        "cells": NO_CELLS,
        "contacts": contacts_of(entries),
        "wrenches": np.stack(readings, axis=1),
        **{
            field: np.stack(
                [table.matrix(f"{name}.{entry.name}", channels, True) for entry in entries], axis=1
            )
            for field, name in optional.items()
        },
    }


def _read_cells(
    entries: list[CellsEntry], table: MappedTable, loaded: np.ndarray, cell_sd: float | None
) -> dict[str, Any]:
    """Read four cells in the corners of each board as version 1 does, any others as vertical wrenches.

    So are boards of four of which a lifted one was not recorded. The twist of the boards is lost.
    """
    forces = [
        _present(table, "cell", tuple(entry.cells), entry.name, stands)
        for entry, stands in zip(entries, loaded, strict=True)
    ]
    if all(entry.at_corners for entry in entries) and not np.isnan(np.hstack(forces)).any():
        return _corner_cells(entries, table)
    levers = [_levers(np.array(list(entry.cells.values()), float)) for entry in entries]
    wrenches = np.stack([force @ lever.T for force, lever in zip(forces, levers, strict=True)], axis=1)
    covariance = (
        None if cell_sd is None else np.mean([cell_sd**2 * lever @ lever.T for lever in levers], axis=0)
    )
    return _vertical(wrenches, covariance, "ground", np.zeros((2, 6)), depth=entries[0].top_height)


def _read_cops(entries: list[CopEntry], table: MappedTable, loaded: np.ndarray) -> dict[str, Any]:
    both = zip(entries, loaded, strict=True)
    cops = np.stack([_present(table, "cop", COP, entry.name, stands, True) for entry, stands in both], axis=1)
    sd = np.array([np.full(3, np.nan) if entry.sd is None else entry.sd for entry in entries], float)
    covariance = covariance_of_cops(cops, sd, loaded.T)
    return _vertical(wrenches_of_cops(cops), covariance, entries[0].mount, pose_of(entries), sd)


def _levers(places: np.ndarray) -> np.ndarray:
    """Return fz, mx and my of a unit force at each of k places, (3, k)."""
    return np.array([np.ones(len(places)), places[:, 1], -places[:, 0]])


def _vertical(
    readings: np.ndarray,
    covariance: np.ndarray | None,
    mount: str,
    pose: np.ndarray,
    cop_sd: np.ndarray | None = None,
    depth: float = 0.0,
) -> dict[str, Any]:
    """Return tared sensors of vertical wrenches, whose readings fz, mx, my are (m, 2, 3)."""
    contacts = Contacts(
        mount=mount,
        channels=VERTICAL,
        pose=pose,
        covariance=covariance,
        zero_sd=np.zeros((2, len(VERTICAL))),
        below=np.zeros((2, 4)),
        below_sd=np.zeros((2, 4)),
        cop_sd=cop_sd,
        depth=depth,
    )
    return {"cells": NO_CELLS, "contacts": contacts, "wrenches": readings}


def _present(
    table: MappedTable,
    prefix: str,
    names: tuple[str, ...],
    side: str,
    stands: np.ndarray,
    any_gap: bool = False,
) -> np.ndarray:
    """Return a contact's readings, (m, c); NaN in all of them for a foot in the air that was not recorded.

    Args:
        stands: whether the foot is on the ground, (m,).
        any_gap: whether a single gap, in the air, makes the contact absent, rather than be refused.
    """
    values = table.matrix(f"{prefix}.{side}", names, True)
    gaps = np.isnan(values)
    absent: np.ndarray = np.any(gaps, axis=1) if any_gap else np.all(gaps, axis=1)
    wrong = gaps & (stands | ~absent)[:, None]
    if wrong.any():
        row, k = (int(index[0]) for index in np.nonzero(wrong))
        expected = (
            "a number, since this foot stands" if stands[row] else "all of the contact's readings, or none"
        )
        name = f"{prefix}.{side}.{names[k]}"
        raise InputError(f"{table.path}: column '{name}', row {row + 1}: found nothing, expected {expected}")
    return np.where(np.expand_dims(absent, 1), np.nan, values)


def _corner_cells(entries: list[CellsEntry], table: MappedTable) -> dict[str, np.ndarray]:
    cells = [[entry.cells[corner] for corner in CORNERS] for entry in entries]
    return {
        "cell_forces": table.matrix("cell", CELLS),
        "cell_forces_sd": table.matrix("cell_std", CELLS, True),
        "cells": np.array(cells, float),
    }
