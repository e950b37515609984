"""Import the log of a moving robot: from samples to rows of measurements in the contract's own columns."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table_files import TableFile
from tulip_testbed.experiments.table_import.column_names import Proposal, propose
from tulip_testbed.experiments.table_import.import_map import ONE, ImportMap, SeriesOfMap
from tulip_testbed.identification.conventions.log_conventions import (
    WrenchConvention,
    contact_frames,
    rewritten,
)
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.column_mapping import MappedTable
from tulip_testbed.measurements.contract import WHOLE
from tulip_testbed.measurements.logs.joined_clocks import in_order
from tulip_testbed.measurements.logs.series_reduction import (
    LIFTED,
    OVERLAP,
    loads,
    reduced,
    supports,
    usual_window,
)
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import rows_in
from tulip_testbed.measurements.motion_table import NOT_OF_SAMPLES
from tulip_testbed.measurements.trajectory import runs

TICK = 0.2  # s: rows that are closer, in a table of LEAST_ROWS or more, are samples
LEAST_ROWS = 200
FEW = 0.2  # of the rows
STILL = 0.02  # rad: without a joint that moves more, nothing moves
# A sensor whose zero is off reads a load in the air. There the other sole is not level with it, and the load,
# below a share of the weight, is the same whatever way the foot points.
LIGHT, SAME = 0.25, 0.01  # of the weight
LEVEL = np.array([0.03, 0.1, 0.1])  # m, rad, rad: height, roll and pitch of a sole against the other
ENOUGH = 500  # samples that show how the soles stand
COMPUTED = (*WHOLE, "speed", "acceleration", *NOT_OF_SAMPLES)  # columns, or their first words


def series_of(table: TableFile, stated: ImportMap) -> SeriesOfMap | None:
    """Return how a table is reduced; None for one of held postures.

    A table is a series if the map says so, or if it is long and its time ticks faster than 5 Hz.
    """
    if stated.series is not None or len(table) < LEAST_ROWS:
        return stated.series
    columns = {name: entry for name, entry in stated.columns.items() if name == "time"}
    found: Proposal = propose(list(table.types), ["time"], [], columns)
    if "time" not in (*found.exact, *found.mapping):
        return None
    steps = np.diff(MappedTable(table, found.mapping, 1.0).numbers("time", True))
    return SeriesOfMap() if 0 < np.nanmedian(steps) < TICK else None


def sampled(names: Sequence[str]) -> tuple[str, ...]:
    """Return those of the contract's columns that samples may have."""
    return tuple(name for name in names if name.partition(".")[0] not in COMPUTED)


def necessary(names: Sequence[str], series: SeriesOfMap) -> tuple[str, ...]:
    """Return which of the contract's necessary columns a series needs, and its time."""
    lifted = {"right": ".left.", "left": ".right."}.get(series.support or "", "none")
    readings = ("wrench.", "cop.", "cell.")
    needed = [name for name in sampled(names) if not (name.startswith(readings) and lifted in name)]
    return (*needed, *(["time"] if series.rate is None else []))


def without_gaps(table: TableFile, sources: Sequence[str]) -> tuple[TableFile, list[str]]:
    """Leave out the samples in which one of these columns has no number, and say how many.

    Such samples are missing: a table without any other is returned as it is.
    """
    values = np.column_stack([table.numbers(source, True) for source in sources])
    gaps: np.ndarray = np.any(np.isnan(values), axis=1)
    if not gaps.any() or gaps.all():
        return table, []
    first = int(gaps.argmax()) + 1
    return table.take(~gaps), [f"left out: {gaps.sum()} samples without a number, the first in row {first}"]


def series_rows(
    table: MappedTable,
    manifest: Manifest,
    nominal: Nominal,
    series: SeriesOfMap,
    stated: ImportMap,
    convention: WrenchConvention | None = None,
) -> tuple[Measurements, list[str], list[str]]:
    """Read the samples of a series and reduce them to rows.

    Args:
        table: with all columns that `necessary` names, and those of `added_columns`.
        convention: of the samples' wrenches; None: the contract's.

    Returns:
        the rows, what was assumed for them, and what the user has to look at.
    """
    if stated.placement not in (None, ONE):
        raise InputError(
            f"map: key 'placement': found '{stated.placement}' with a series, expected '{ONE}' or nothing: "
            "placements of a series are blocks of time"
        )
    samples = rows_in(manifest, table, Path("map"))
    samples = samples.take(in_order(str(table.path), samples.time))
    samples = dataclasses.replace(samples, time=samples.time - samples.time[0])
    weight = nominal.mass * manifest.gravity
    by_load = not table.has("support")
    if by_load:
        samples = dataclasses.replace(samples, support=_support(samples, nominal, weight))
    if convention is not None:
        samples = rewritten(samples, contact_frames(nominal, samples), convention)
    window = series.window or usual_window(manifest.sensors.encoder_resolution)
    out = reduced(samples, weight, window, series.step or window / OVERLAP)
    rows = out.measurements
    dropped = dict(out.dropped)
    if by_load and (touching := _touching(rows, weight)).any():
        rows = rows.take(~touching)
        dropped["in which the foot in the air still carries a part of the weight"] = int(touching.sum())
    causes = [f"{count} window{'' if count == 1 else 's'} {cause}" for cause, count in dropped.items()]
    left_out = f"left out: {listed(causes)}" if causes else ""
    if not len(rows):
        raise InputError(
            f"{table.path}: found no window of {window:g} s that gives a row; "
            f"{left_out or 'the log is shorter'}{_moments_first(samples, weight)}"
        )
    both = rows.support == "double"
    closed = ""
    if by_load and 0 < both.mean() < FEW:
        rows = rows.take(~both)
        closed = f"; left out: {int(both.sum())} windows on both feet, too few to settle the closed legs"
    assumed = [
        f"a series: {len(samples)} samples in {number(np.ptp(samples.time), '.4g')} s are reduced to "
        f"{len(rows)} rows of {window:g} s with rates and accelerations"
        + (left_out and f"; {left_out}")
        + closed
    ]
    if by_load:
        kinds = [f"{int((rows.support == kind).sum())} {kind}" for kind in dict.fromkeys(rows.support)]
        assumed.append(
            f"in the air is a foot with less than {100 * LIFTED:.0f} % of the weight, or raised or tilted "
            f"with a constant load below {100 * LIGHT:.0f} %: support {listed(kinds)}"
        )
    moved = np.ptp(rows.joint_angles, axis=0).max()
    still = f"nothing moves: no joint by more than {STILL:g} rad, expected a log of a robot that moves"
    return rows, assumed, [still] if moved < STILL else []


def _support(samples: Measurements, nominal: Nominal, weight: float) -> np.ndarray:
    """Return on which feet the robot stands, (n,); "" where it is on none, or while a foot lands or lifts."""
    support, share = supports(samples, weight), loads(samples) / weight
    light = (support == "double") & (share < LIGHT).any(axis=1)
    both = (support == "double") & ~light
    if not both.any() or not light.any():
        return support
    some = np.flatnonzero(both)[:: max(1, both.sum() // ENOUGH)]
    level, pose = (nominal.swing_sole(samples.joint_angles[rows])[:, 2:5] for rows in (some, light))
    off = np.zeros(len(samples), bool)
    off[light] = (np.abs(pose - np.median(level, axis=0)) > LEVEL).any(axis=1)
    least = share.min(axis=1)
    for run in runs(light):
        if off[run].any():
            same = off[run] & (np.abs(least[run] - np.median(least[run][off[run]])) < SAME)
            air = np.where(share[run, 0] < share[run, 1], "left", "right")
            support[run] = np.where(same, air, "")
    return support


def _touching(rows: Measurements, weight: float) -> np.ndarray:
    """Return in which rows the foot in the air reads another load than in most others, (m,) bool.

    A foot that is put down carries part of the weight before it counts as one that stands.
    """
    found, read = np.zeros(len(rows), bool), loads(rows) / weight
    for foot, support in enumerate(("left", "right")):  # right foot in the air on the left, and reversed
        alone = rows.support == support
        if alone.any():
            found |= alone & (np.abs(read[:, foot] - np.median(read[alone, foot])) > SAME)
    return found


def added_columns(count: int, series: SeriesOfMap) -> dict[str, np.ndarray]:
    columns = {"posture": np.ones(count, int), "placement": np.ones(count, int)}
    if series.rate is not None:
        columns["time"] = np.arange(count) / series.rate
    if series.support is not None:
        columns["support"] = np.full(count, series.support)
    return columns


def _moments_first(samples: Measurements, weight: float) -> str:
    """Ask for the order of the channels where moments as they are named are a weight."""
    if samples.contacts is None or samples.wrenches is None:
        return ""
    moments = [k for k, channel in enumerate(samples.contacts.channels) if channel.startswith("m")]
    size = np.linalg.norm(np.nan_to_num(samples.wrenches[..., moments]), axis=2).sum(axis=1)
    most = float(np.median(size))
    if most < weight / 2:
        return ""
    return (
        f"; channels named as moments read {most:.0f}, the robot weighs {weight:.0f} N: are they the forces?"
    )
