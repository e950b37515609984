"""Watch a day: read rows as they arrive, judge each, and keep the state."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tulip_testbed.base.alone import alone_on
from tulip_testbed.base.errors import InputError, listed, look_up, shortened
from tulip_testbed.base.files import read_bytes
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.watching.arriving_rows import (
    TABLE,
    Line,
    Place,
    is_header,
    is_row,
    lines_of,
    new_lines,
    row_of,
)
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.state_file import (
    Kept,
    check_state_file,
    key_of,
    read_state,
    write_state,
)
from tulip_testbed.experiments.watching.watch_row import Verdict, watch_row
from tulip_testbed.experiments.watching.watch_state import WatchState, first_state
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import header_in, read_manifest
from tulip_testbed.sim.plan_folder import check_model
from tulip_testbed.sim.robot import Robot, joint_names

POLL = 0.25  # s, between two looks at a file
EVERY = "all"


@dataclass(frozen=True, eq=False)
class WatchSettings:
    """The subject of a watch.

    Attributes:
        folder: measurement folder; nothing is written into it.
        state: file that keeps the state; None: it is not kept.
        targets: standard errors that are wanted, by base parameter or "all" [m].
        follow: wait for more rows; otherwise judge those that are there.
        rows: lines of a CSV after their header, in place of the folder's table.
    """

    folder: Path
    plan: PosturePlan
    robot: Robot
    state: Path | None = None
    targets: Mapping[str, float] | None = None
    follow: bool = True
    rows: Iterable[bytes] | None = None


@dataclass(frozen=True, eq=False)
class Arrival:
    """The result of a line.

    Attributes:
        line: its number in the table. verdict: None if it could not be read.
        problem: why it could not be read, otherwise "".
        state: after the row.
    """

    line: int
    verdict: Verdict | None
    problem: str = ""
    state: WatchState | None = None


def read_targets(texts: Sequence[str]) -> dict[str, float]:
    """Read targets that are written NAME=MILLIMETRES, by base parameter or "all" [m].

    Raises:
        InputError: with what was found and what is valid.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in found:
            raise InputError(f"target: {name}: found two values, expected one")
        try:
            found[name] = 1e-3 * float(value)
        except ValueError:
            raise InputError(
                f"target: found {shortened(repr(text))}, expected NAME=MILLIMETRES, for instance all=2"
            ) from None
    return found


def targets_of(model: DayModel, given: Mapping[str, float] | None) -> np.ndarray | None:
    """Return the standard error that is wanted of every base parameter, (p,) [m]; None: none is.

    Raises:
        InputError: an unknown parameter, or a target that is not above zero.
    """
    if not given:
        return None
    names = model.nominal.parameters.names
    out = np.full(len(names), np.inf)
    for name, value in sorted(given.items(), key=lambda each: each[0] != EVERY):
        look_up("parameter", name, (EVERY, *names), "target")
        if not 0 < value < np.inf:
            raise InputError(f"target: {name}: found {value:g}, expected a standard error above 0 [m]")
        out[slice(None) if name == EVERY else names.index(name)] = value
    return out


def watch_day(settings: WatchSettings, pause: Callable[[float], None] = time.sleep) -> Iterator[Arrival]:
    """Yield what comes of every row as it arrives, until every posture of the plan is measured.

    The state is written after a row was yielded: a process that is killed between both yields that row again.
    A hidden file in the folder of the state, .NAME.lock, keeps a second watch of the same state out.

    Args:
        pause: called with the time to wait between two looks at the file [s].

    Raises:
        InputError: a folder, plan or state that cannot be used; a table whose header changes or that becomes
            shorter; another watch keeps the same state.
    """
    if settings.state is None:
        yield from _watched(settings, pause)
        return
    check_state_file(settings.state)
    with alone_on(settings.state):
        yield from _watched(settings, pause)


def _watched(settings: WatchSettings, pause: Callable[[float], None]) -> Iterator[Arrival]:
    s, where = settings, Path(settings.folder) / "manifest.json"
    manifest = read_manifest(s.folder)
    model = _model(s, manifest, where)
    targets = targets_of(model, s.targets)
    key, kept = key_of(s.plan, read_bytes(where)), Kept(first_state(model), Place())
    if s.state is not None:
        kept = read_state(s.state, key, model) or kept
    path = Path(s.folder) / TABLE if s.rows is None else Path("standard input")
    stream = None if s.rows is None else lines_of(s.rows, Place(), path)
    skipped = kept.place.lines if stream is not None else 0
    judge = one_blas_thread(watch_row)
    while True:
        lines = list(_taken(stream)) if stream is not None else new_lines(path, kept.place)
        for line in lines:
            if not is_row(line.text):
                kept = Kept(kept.state, _passed(kept.place, line))
                continue
            if is_header(path, line, kept.place):
                kept = Kept(kept.state, kept.place.after(line))
                continue
            try:
                row = row_of(line, kept.place.header, manifest, path, where)
            except InputError as error:
                yield Arrival(line.number, None, str(error), kept.state)
                kept = Kept(kept.state, kept.place.after(line))
                continue
            if skipped and _known(kept.state, row, path):
                continue
            skipped = 0
            state, verdict = judge(model, kept.state, row, targets)
            kept = Kept(state, kept.place.after(line))
            yield Arrival(line.number, verdict, "", state)
            if s.state is not None:
                write_state(s.state, key, kept)
            if verdict.next is None:
                return
        if lines:
            continue
        if stream is not None or not s.follow:
            return
        pause(POLL)


def _taken(stream: Iterator[Line]) -> Iterator[Line]:
    """Yield the next line of a stream, if there is one."""
    line = next(stream, None)
    if line is not None:
        yield line


def _passed(place: Place, line: Line) -> Place:
    """Return the place after a line that holds no values."""
    return Place(line.number, line.end, place.header, line.text)


def _known(state: WatchState, row: Measurements, path: Path) -> bool:
    """Return whether a row was judged before the watch was killed: a stream may bring it again.

    Raises:
        InputError: neither rows nor state have a time, so that nobody can tell.
    """
    if state.row < 0:
        return False
    if not np.isfinite([row.time[0], state.time]).all():
        raise InputError(
            f"{path}: found no 'time' in the rows of a stream that goes on, expected one: without it, rows "
            "that were judged before cannot be told from new ones; give another name of the state"
        )
    return bool(row.time[0] <= state.time)


def _model(settings: WatchSettings, manifest: Manifest, where: Path) -> DayModel:
    """Prepare the day of a folder.

    Raises:
        InputError: another robot's folder or plan, or sensors that are not plates on cells.
    """
    robot = settings.robot
    check_model(where, manifest.robot.model, manifest.robot.sha256, robot)
    if tuple(manifest.joints) != (joints := joint_names(robot.model)):
        found, expected = listed(manifest.joints), listed(joints)
        raise InputError(f"{where}: key 'joints': found {found}, expected {expected}")
    feet = (manifest.robot.stance_foot, manifest.robot.swing_foot)
    if feet != robot.feet:
        raise InputError(
            f"{where}: key 'robot': found the feet {listed(feet)}, expected {listed(robot.feet)}"
        )
    if manifest.plates is None:
        raise InputError(
            f"{where}: key 'contacts': found sensors of wrenches, expected plates on four cells each: a "
            "watch reads no others yet"
        )
    return day_model(settings.plan, robot, header_in(manifest, where))
