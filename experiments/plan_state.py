"""The file of an interrupted search for a plan."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from tulip_testbed.base.document import Document
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import MOST_BYTES, present, write_text
from tulip_testbed.base.table_files import read_json
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.identification.planning.search import ARRAYS, SearchState

Number = Annotated[float, Field(ge=-100, le=100)]  # m or rad: beyond any posture
Design = list[Annotated[list[Number], Field(min_length=9, max_length=9)]]
Angles = list[list[Number]]


class _State(Document):
    rounds: Annotated[int, Field(ge=0)]
    design: Design
    angles: Angles
    best_design: Design
    best_angles: Angles
    value: float
    initial: float
    initial_condition: float


class _StateFile(Document):
    key: list[Any]
    state: _State


def state_file(out: Path) -> Path:
    """Return where an interrupted run leaves its state, next to its plan."""
    return out.with_name(f".{out.name}.state.json")


def read_state(path: Path, key: list[Any]) -> SearchState | None:
    """Read what an interrupted run left; None where there is nothing.

    Args:
        key: what the run has to share with the interrupted one.

    Raises:
        InputError: it is of another run, or broken.
    """
    if not present(path):
        return None
    try:
        found = _StateFile.model_validate(read_json(path, MOST_BYTES))
        if found.key != key:
            raise InputError(f"{path}: left by another run; remove it or give another name")
        state = found.state
        arrays = {name: np.array(getattr(state, name)) for name in ARRAYS}
    except ValidationError as error:
        raise no_state(path, validation_message(error)) from None
    except ValueError as error:  # rows of several lengths
        if isinstance(error, InputError):
            raise
        raise no_state(path, "found rows of several lengths") from None
    return SearchState(
        **arrays,
        rounds=state.rounds,
        value=state.value,
        initial=state.initial,
        initial_condition=state.initial_condition,
    )


def no_state(path: Path, why: object) -> InputError:
    """Word the refusal of a file that no interrupted run left."""
    return InputError(f"{path}: found no state of an interrupted run ({why}); remove it")


def write_state(path: Path, key: list[Any], state: SearchState) -> None:
    """Write a state; floats as Python writes them come back in the same bits."""
    document = {k: v.tolist() if k in ARRAYS else v for k, v in vars(state).items()}
    write_text(path, json.dumps({"key": key, "state": document}))
