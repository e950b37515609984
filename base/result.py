"""The one shape of a result: tables for people, a JSON document for machines, a folder to keep."""

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_type_hints

import numpy as np
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import CoreSchema, core_schema

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.base.table_files import finite, read_json, write_json
from tulip_testbed.base.validation_message import validation_message

RESULT_FILE = "result.json"


def _of(kind: type) -> PlainValidator:
    """Read numbers of a JSON document as an array; null is NaN where numbers need not be whole."""
    allowed = {float: {float, int, type(None)}, int: {int}, bool: {bool}}[kind]

    def array(values: Any) -> np.ndarray:
        try:
            if {type(item) for item in np.array(values, object).ravel().tolist()} <= allowed:
                return np.array(values, kind)
        except (TypeError, ValueError, OverflowError):
            pass
        raise ValueError("expected rows of numbers, all of one length")

    return PlainValidator(array)


Item = TypeVar("Item")
# A number that an experiment may leave undefined: NaN, in JSON null.
Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
# Arrays in a result; shape and unit are in the docstring of the class.
_LISTED = PlainSerializer(lambda values: values.tolist())
Array = Annotated[np.ndarray, _of(float), _LISTED]
Numbers = Annotated[np.ndarray, _of(int), _LISTED]
Flags = Annotated[np.ndarray, _of(bool), _LISTED]


class Outside:
    """The mark of a field that is no part of the JSON document, such as the robot; None in what is read."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_default_schema(core_schema.any_schema(), default=None)


@dataclass(frozen=True)
class Kept(Outside):
    """The mark of a field that a run folder keeps in a file or folder of its own, outside the JSON document.

    Attributes:
        name: of the file or folder.
        write: called with the path and the value.
        read: called with the path and with what `Result.load` was given besides the folder.
    """

    name: str
    write: Callable[[Path, Any], object]
    read: Callable[..., Any]


def _nothing(*_: Any) -> None:
    """Leave a folder as it is."""


# A field that neither the document nor the folder holds: None in a result that was read.
InMemory = Annotated[Item, Outside(), Field(exclude=True)]
# A field that whoever reads the folder gives, such as the robot.
GIVEN = Kept("", _nothing, lambda folder, given: given)
Given = Annotated[Item, GIVEN, Field(exclude=True)]
# The folder itself; None: the result is in memory alone.
Place = Annotated[Path | None, Kept("", _nothing, lambda folder, *context: folder), Field(exclude=True)]


class Documented:
    """A frozen dataclass that is a JSON document: its fields, but those kept next to it, are the keys."""

    __pydantic_config__ = ConfigDict(strict=True, arbitrary_types_allowed=True)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document; NaN is null."""
        adapter, outside = _adapter(type(self)), set(_outside(type(self)))
        return finite(adapter.dump_python(self, mode="json", by_alias=True, exclude=outside))

    @classmethod
    def from_json(cls, document: Mapping[str, Any], where: str = "document") -> Self:
        """Read a JSON document; what is kept next to it is None."""
        try:
            return _adapter(cls).validate_json(json.dumps(document))
        except ValidationError as error:
            raise InputError(f"{where}: {validation_message(error)}") from None

    @classmethod
    def read(cls, path: Path) -> Self:
        return cls.from_json(read_json(path), str(path))

    def write(self, path: Path) -> None:
        """Write a file, which appears whole."""
        write_json(path, self.to_json())


class Result(Documented, Shown):
    """The result of a workflow: a frozen dataclass whose fields are the JSON document.

    `--json` prints the document, and a run folder holds it. Fields marked as `Kept` are no part of it; the
    folder holds them next to it.
    """

    exit_codes: ClassVar[Mapping[str, int]] = {}  # of the command, by the verdict; of others 0

    def answer(self) -> list[Table | str]:
        """Return what the command line shows without --full."""
        return self.tables()

    @property
    def exit_code(self) -> int:
        """Return the exit code of the command that has this result."""
        return self.exit_codes.get(getattr(self, "verdict", ""), 0)

    def wait(self) -> None:
        """Wait until a window that shows the result is closed."""

    def save(self, folder: str | Path) -> None:
        """Write a new folder, which appears whole or not at all.

        Raises:
            InputError: the folder exists or cannot be written.
        """
        with new_folder(Path(folder)) as working:
            self.write_into(working)

    def write_into(self, folder: Path) -> None:
        """Write the document and all that is kept next to it into a folder."""
        self.write(folder / RESULT_FILE)
        for field, kept in _kept(type(self)).items():
            if (value := getattr(self, field)) is not None:
                kept.write(folder / kept.name, value)

    @classmethod
    def load(cls, folder: str | Path, *context: Any) -> Self:
        """Read a folder.

        Args:
            context: passed on to the readers of what is kept next to the document, such as the robot.

        Raises:
            InputError: a file that is missing or not what was written.
        """
        folder = Path(folder)
        result = cls.read(folder / RESULT_FILE)
        if wanted := [field for field, kept in _kept(cls).items() if kept is GIVEN and not context]:
            raise InputError(
                f"{wanted[0]}: found none, expected it behind the folder: load(folder, {wanted[0]})"
            )
        parts = {field: kept.read(folder / kept.name, *context) for field, kept in _kept(cls).items()}
        return dataclasses.replace(result, **parts).placed_in(folder)  # pyrefly: ignore[bad-specialization]

    def placed_in(self, folder: Path) -> Self:
        """Return the result as it was read from a folder, with its parts checked against each other."""
        return self


def flattened(value: Any, name: str = "") -> dict[str, Any]:
    """Return the values of a JSON document by their path with dots."""
    if isinstance(value, dict):
        pairs = value.items()
    elif isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        pairs = enumerate(value)
    else:
        return {name: value}
    found: dict[str, Any] = {}
    for key, inner in pairs:
        found |= flattened(inner, f"{name}.{key}" if name else str(key))
    return found


@cache
def _adapter(kind: type[Documented]) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


@cache
def _outside(kind: type[Documented]) -> dict[str, Outside]:
    """Return the marks of the fields that are no part of the document, by field."""
    hints = get_type_hints(kind, include_extras=True)
    fields = [field.name for field in dataclasses.fields(kind)]  # pyrefly: ignore[bad-argument-type]
    marks = {name: getattr(hints[name], "__metadata__", ()) for name in fields}
    return {name: mark for name, of_field in marks.items() for mark in of_field if isinstance(mark, Outside)}


def _kept(kind: type[Documented]) -> dict[str, Kept]:
    return {name: mark for name, mark in _outside(kind).items() if isinstance(mark, Kept)}
