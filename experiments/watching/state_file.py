"""The file in which a watch keeps its state, so that it goes on after it was killed."""

from __future__ import annotations

import io
import json
import struct
import tokenize
import zipfile
import zlib
from dataclasses import asdict, dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import check_new, check_outside, present, read_bytes, write_bytes
from tulip_testbed.experiments.watching.arriving_rows import Place
from tulip_testbed.experiments.watching.change_detection import Changes
from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.design_information import DesignInformation
from tulip_testbed.experiments.watching.recursive_estimate import Belief
from tulip_testbed.experiments.watching.watch_state import Before, Earlier, Fault, WatchState, first_state
from tulip_testbed.measurements import PosturePlan

# What numpy and zipfile raise of files that are none of theirs.
BROKEN = (
    *(ValueError, LookupError, TypeError, OSError, EOFError, RuntimeError, SyntaxError, MemoryError),
    *(OverflowError, zipfile.BadZipFile, tokenize.TokenError, zlib.error, struct.error),
)
FORMAT, VERSION = "tulip-watch", 2
HASH = 32  # bytes at the beginning of the file: the sha256 of all that follow
PLAIN = (
    "gaps",
    "taken",
    "count",
    "seen",
    "row",
    "placement",
    "stance",
    "support",
    "time",
    "odd",
    "odd_posture",
)
OF_BEFORE = ("mean", "covariance", "settled", "own", "across", "within")


@dataclass(frozen=True)
class Kept:
    """The state of a watch between two runs."""

    state: WatchState
    place: Place


def key_of(plan: PosturePlan, manifest: bytes) -> str:
    """Return what a state belongs to: a hash of the plan's postures and the manifest."""
    whole = sha256(manifest)
    for values in (plan.posture, plan.placement, plan.joint_angles, plan.swing_pose):
        whole.update(np.ascontiguousarray(values).tobytes())
    return whole.hexdigest()


def check_state_file(path: Path) -> None:
    """Refuse, before the first row, a place inside a measurement folder or one that cannot be written.

    Raises:
        InputError: it lies there.
    """
    if present(path):
        check_outside(path.resolve())
    else:
        check_new(path)


def write_state(path: Path, key: str, kept: Kept) -> None:
    """Write the state; a file of the same name is replaced as a whole.

    Raises:
        InputError: it cannot be written.
    """
    state, place = kept.state, kept.place
    arrays: dict[str, np.ndarray] = {
        "done": state.done,
        "spreads": state.spreads,
        "odd_pull": state.odd_pull,
        "odd_information": state.odd_information,
    }
    for name in ("belief", "changes", "information", "earlier"):
        part = getattr(state, name)
        arrays |= {f"{name}.{one.name}": getattr(part, one.name) for one in fields(part)}
    for k, name in enumerate(OF_BEFORE):
        each = [(_of_before(one))[k] for one in state.history]
        arrays[f"history.{name}"] = np.array(each) if each else np.zeros(0)
    head = {
        "format": FORMAT,
        "version": VERSION,
        "key": key,
        "state": {name: getattr(state, name) for name in PLAIN},
        "fault": None if state.fault is None else asdict(state.fault),
        "history": [[one.count, one.placement, one.stance] for one in state.history],
        "place": {"lines": place.lines, "size": place.size},
    }
    arrays["header"] = np.frombuffer(place.header, np.uint8)
    arrays["last"] = np.frombuffer(place.last, np.uint8)
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    sink = io.BytesIO()
    np.savez(sink, **arrays)  # pyrefly: ignore[bad-argument-type]
    content = sink.getvalue()
    write_bytes(path, sha256(content).digest() + content)


def _of_before(one: Before) -> tuple[np.ndarray, ...]:
    i = one.information
    return one.belief.mean, one.belief.covariance, i.settled, i.own, i.across, i.within


def read_state(path: Path, key: str, model: DayModel) -> Kept | None:
    """Read the state; None: there is no such file.

    Args:
        key: see `key_of`.

    Raises:
        InputError: the file is no state, or that of another plan or manifest.
    """
    if not present(path):
        return None
    try:
        whole = read_bytes(path)
        if sha256(content := whole[HASH:]).digest() != whole[:HASH]:
            raise ValueError("its hash is not that of its content")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(arrays["head"].tobytes())
        if (head["format"], head["version"]) != (FORMAT, VERSION):
            raise ValueError("another format")
        if head["key"] != key:
            raise InputError(
                f"{path}: found the state of another plan, manifest or robot, expected that of this day; "
                "give another name for a new one"
            )
        return _kept(arrays, head, first_state(model))
    except InputError:
        raise
    except BROKEN as error:
        raise InputError(f"{path}: found no state of a watch ({error}); give another name") from None


def _kept(arrays: dict[str, np.ndarray], head: dict[str, Any], empty: WatchState) -> Kept:
    parts: dict[str, Any] = {}
    for name, kind in (
        ("belief", Belief),
        ("changes", Changes),
        ("information", DesignInformation),
        ("earlier", Earlier),
    ):
        own = getattr(empty, name)
        values = {one.name: arrays[f"{name}.{one.name}"] for one in fields(kind)}
        for field, value in values.items():
            if value.shape != getattr(own, field).shape:
                raise ValueError(f"{name}.{field} has the shape {value.shape}")
        parts[name] = kind(**values)
    history = tuple(
        Before(
            count,
            placement,
            stance,
            Belief(arrays["history.mean"][k], arrays["history.covariance"][k]),
            DesignInformation(*(arrays[f"history.{name}"][k] for name in OF_BEFORE[2:])),
        )
        for k, (count, placement, stance) in enumerate(head["history"])
    )
    plain = {name: head["state"][name] for name in PLAIN}
    plain |= {"gaps": tuple(plain["gaps"]), "taken": tuple(plain["taken"])}
    state = WatchState(
        **parts,
        **plain,
        done=arrays["done"],
        spreads=arrays["spreads"],
        odd_pull=arrays["odd_pull"],
        odd_information=arrays["odd_information"],
        history=history,
        fault=None if head["fault"] is None else Fault(**head["fault"]),
    )
    place = Place(**head["place"], header=arrays["header"].tobytes(), last=arrays["last"].tobytes())
    return Kept(state, place)
