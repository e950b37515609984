"""The state of a watch between two rows, and the file in which it is kept.

Its size depends on the plan, not on the number of rows. A watch that was killed goes on with the file.
"""

from __future__ import annotations

import io
import json
import struct
import tokenize
import zipfile
import zlib
from dataclasses import dataclass, field, fields, is_dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import check_new, check_outside, present, read_bytes, write_bytes
from tulip_testbed.experiments.watching.arriving_rows import BEGINNING, Place
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.recursive_estimate import (
    APART,
    EARLIER,
    RECENT,
    Belief,
    Changes,
    DesignInformation,
    is_onset,
)
from tulip_testbed.identification.residual_channels import SIZE
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.cells import CELLS

OPEN, MEASURED, AGAIN = 0, 1, 2  # of a plan's rows
GAPS = 20  # times between postures that are remembered
REACH = RECENT + APART * EARLIER + APART  # rows back to the earliest onset
# What numpy, zipfile and pydantic raise of files that are none of theirs.
BROKEN = (
    *(ValueError, LookupError, TypeError, OSError, EOFError, RuntimeError, SyntaxError, MemoryError),
    *(OverflowError, zipfile.BadZipFile, tokenize.TokenError, zlib.error, struct.error),
)
FORMAT, VERSION = "tulip-watch", 4
HASH = 32  # bytes at the beginning of the file: the sha256 of all that follow


@dataclass(frozen=True, eq=False)
class Fault:
    """A change that was noticed and is there.

    Attributes:
        direction: its number among the model's. onset: count of the row at which it began.
        posture: that row's. size: in plausible sizes.
        gone: evidence that it has gone, ln of a likelihood ratio.
    """

    direction: int
    onset: int
    posture: int
    size: float
    gone: float = 0.0


@dataclass(frozen=True, eq=False)
class Before:
    """The state before a row, to which a watch returns if a change began there.

    Attributes:
        count: of the row. placement: its number. stance: its number.
    """

    count: int
    placement: int
    stance: int
    belief: Belief
    information: DesignInformation


@dataclass(frozen=True, eq=False)
class Earlier:
    """The result of a posture when it was measured last, by the plan's rows.

    Attributes:
        there: whether it was measured, (m,) bool. stance: in which stance, (m,). residual: (m, 11).
        state: derivative by the state, (m, 11, n) of float32. used: (m, 11) bool.
        noise: covariance of what postures do not share, (m, 11, 11).
    """

    there: np.ndarray
    stance: np.ndarray
    residual: np.ndarray
    state: np.ndarray
    noise: np.ndarray
    used: np.ndarray

    def changed(self, row: int, **values: Any) -> Earlier:
        """Return the results with those of one row of the plan replaced."""
        parts = {name: whole.copy() for name, whole in vars(self).items()}
        for name, value in values.items():
            parts[name][row] = value
        return Earlier(**parts)


@dataclass(frozen=True, eq=False)
class WatchState:
    """State of a watch.

    Attributes:
        belief: about the day's state. changes: evidence for faults. information: about the base parameters.
        earlier: what the plan's postures showed.
        done: of the plan's rows, one of OPEN, MEASURED and AGAIN, (m,).
        odd: count of rows in succession that did not fit. odd_pull, odd_information: evidence of these rows
            for every fault, (c,). odd_posture: the first one's posture.
        history: what was known before the rows at which a change may have begun.
        taken: plan's rows of the last rows that were taken in.
        spreads: s.d. within the last windows, (k, n_joints + 9).
        gaps: between the last postures of a placement [s].
        count: rows that were taken in.
        row: of the plan, that was measured last; -1: none. placement: its number. stance: count of the
            placements and stances so far. support: its support. time: of the last row [s].
        fault: that is there; None: none.
        place: how far the table was read.
    """

    __pydantic_config__ = ConfigDict(arbitrary_types_allowed=True)

    belief: Belief
    changes: Changes
    information: DesignInformation
    earlier: Earlier
    done: np.ndarray
    odd_pull: np.ndarray
    odd_information: np.ndarray
    history: tuple[Before, ...] = ()
    taken: tuple[int, ...] = ()
    spreads: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gaps: tuple[float, ...] = ()
    count: int = 0
    row: int = -1
    placement: int = -1
    stance: int = 0
    support: str = ""
    time: float = float("nan")
    odd: int = 0
    odd_posture: int = -1
    fault: Fault | None = None
    place: Place = BEGINNING

    def marked(self, rows: int | list[int], mark: int) -> WatchState:
        """Return the state with rows of the plan open, measured or to be measured again."""
        done = self.done.copy()
        done[rows] = mark
        return replace(self, done=done)

    def remembered(self, planned: int) -> WatchState:
        """Return the state that also remembers what is known before the row that comes now."""
        now = Before(self.count, self.placement, self.stance, self.belief, self.information)
        kept = tuple(before for before in self.history if is_onset(before.count, self.count))
        return replace(self, history=(*kept, now), taken=(*self.taken, planned)[-REACH:])


def first_state(model: DayModel) -> WatchState:
    """Return the state before the first row."""
    n, c, m = len(model.covariance), len(model.directions), len(model.plan)
    return WatchState(
        belief=Belief(np.zeros(n), model.covariance),
        changes=Changes.none(n, c),
        information=DesignInformation.none(model.parameters),
        earlier=Earlier(
            there=np.zeros(m, bool),
            stance=np.full(m, -1),
            residual=np.zeros((m, SIZE)),
            state=np.zeros((m, SIZE, n), np.float32),
            noise=np.zeros((m, SIZE, SIZE)),
            used=np.zeros((m, SIZE), bool),
        ),
        done=np.full(m, OPEN, np.int8),
        odd_pull=np.zeros(c),
        odd_information=np.zeros(c),
    )


def key_of(plan: PosturePlan, manifest: bytes) -> str:
    """Return what a state belongs to: a hash of the plan's postures and the manifest."""
    whole = sha256(manifest)
    for values in (plan.posture, plan.placement, plan.joint_angles, plan.swing_pose):
        whole.update(np.ascontiguousarray(values).tobytes())
    return whole.hexdigest()


def check_state_file(path: Path) -> None:
    """Refuse, before the first row, a place inside a measurement folder or one that cannot be written."""
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, which the state would replace; expected a file")
    if present(path):
        check_outside(path.resolve())
    else:
        check_new(path)


def write_state(path: Path, key: str, state: WatchState) -> None:
    """Write the state; a file of the same name is replaced as a whole."""
    arrays: dict[str, np.ndarray] = {}

    def plain(value: Any) -> Any:
        """Return a value for JSON, in which an array or bytes are a name in the archive."""
        if isinstance(value, np.ndarray | bytes):
            name = f"{'array' if isinstance(value, np.ndarray) else 'bytes'}{len(arrays)}"
            arrays[name] = value if isinstance(value, np.ndarray) else np.frombuffer(value, np.uint8)
            return {"in": name}
        if is_dataclass(value):
            return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
        return [plain(item) for item in value] if isinstance(value, tuple) else value

    head = {"format": FORMAT, "version": VERSION, "key": key, "state": plain(state)}
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    sink = io.BytesIO()
    np.savez(sink, **arrays)  # pyrefly: ignore[bad-argument-type]
    content = sink.getvalue()
    write_bytes(path, sha256(content).digest() + content)


def read_state(path: Path, key: str, model: DayModel) -> WatchState | None:
    """Read the state; None: there is no such file."""
    if not present(path):
        return None
    try:
        whole = read_bytes(path)
        if sha256(content := whole[HASH:]).digest() != whole[:HASH]:
            raise ValueError("its hash is not that of its content")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}

        def restored(part: dict[str, Any]) -> Any:
            if part.keys() != {"in"}:
                return part
            values = arrays[part["in"]]
            return values.tobytes() if part["in"].startswith("bytes") else values

        head = json.loads(arrays["head"].tobytes(), object_hook=restored)
        if (head["format"], head["version"]) != (FORMAT, VERSION):
            raise ValueError("another format")
        if head["key"] != key:
            raise InputError(
                f"{path}: found the state of another plan, manifest or robot, expected that of this day; "
                "give another name for a new one"
            )
        state = TypeAdapter(WatchState).validate_python(head["state"])
        _check_shapes(state, first_state(model))
        _check_numbers(state, model)
        return state
    except InputError:
        raise
    except BROKEN as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: found no state of a watch ({reason}); give another name") from None


def _check_shapes(state: Any, empty: Any, where: str = "state") -> None:
    """Refuse arrays of another number of parameters or faults, as another release may have them."""
    for name, value in vars(empty).items():
        if is_dataclass(value):
            _check_shapes(getattr(state, name), value, name)
        elif isinstance(value, np.ndarray) and name != "spreads":
            found = getattr(state, name)
            if (found.shape, found.dtype) != (value.shape, value.dtype):
                raise ValueError(f"{where}.{name} is {found.dtype} of the shape {found.shape}")


def _check_numbers(state: WatchState, model: DayModel) -> None:
    """Refuse numbers that point nowhere."""
    width, fault = len(model.plan.joints) + len(CELLS) + 1, state.fault
    usable = {
        "spreads": state.spreads.ndim == 2 and (not len(state.spreads) or state.spreads.shape[1] == width),
        "done": bool(np.isin(state.done, (OPEN, MEASURED, AGAIN)).all()),
        "fault": fault is None or 0 <= fault.direction < len(model.directions),
        "place": min(state.place.size, state.place.lines) >= 0,
    }
    for name in [name for name, well in usable.items() if not well]:
        raise ValueError(f"state.{name} does not fit the plan")
