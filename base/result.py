"""The one shape of a result: tables for people, a JSON document for machines, a folder to keep."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Annotated, Any, Self, get_type_hints

import numpy as np
from pydantic import (
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import CoreSchema, core_schema

from tulip_testbed.base.column import printable
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import finite, read_json, write_json
from tulip_testbed.base.validation_message import validation_message

RESULT_FILE = "result.json"


def _array(values: Any) -> np.ndarray:
    """Return numbers of a JSON document as an array; null is not a number."""
    return np.array(values, float)


# A number that an experiment may leave undefined: NaN, in JSON null.
Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
# An array in a result; its shape and unit are in the docstring of the class.
Array = Annotated[np.ndarray, PlainValidator(_array), PlainSerializer(lambda values: values.tolist())]


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


class Result:
    """What a workflow returns: a frozen dataclass whose fields are the JSON document.

    Fields marked as `Outside` are no part of the document; those marked as `Kept` lie beside it in a folder.
    """

    __pydantic_config__ = ConfigDict(strict=True, arbitrary_types_allowed=True)

    def tables(self) -> list[Table | str]:
        """Return the tables and sentences that terminal, notebook and page show, in this order."""
        raise NotImplementedError

    @property
    def exit_code(self) -> int:
        """Return the exit code of the command that has this result."""
        return 0

    def wait(self) -> None:
        """Wait until a window that shows the result is closed."""

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, which `--json` prints and a run folder holds; NaN is null."""
        return finite(_adapter(type(self)).dump_python(self, mode="json", exclude=set(_outside(type(self)))))

    @classmethod
    def from_json(cls, document: Mapping[str, Any], where: str = "document") -> Self:
        """Read a JSON document; `Outside` fields are None.

        Raises:
            InputError: names the key, what was found and what was expected.
        """
        try:
            return _adapter(cls).validate_json(json.dumps(document))
        except ValidationError as error:
            raise InputError(f"{where}: {validation_message(error)}") from None

    def save(self, folder: str | Path) -> None:
        """Write a new folder, which appears whole or not at all.

        Raises:
            InputError: the folder exists or cannot be written.
        """
        with new_folder(Path(folder)) as working:
            self.write_into(working)

    def write_into(self, folder: Path) -> None:
        """Write the document and all that is kept beside it into a folder."""
        write_json(folder / RESULT_FILE, self.to_json())
        for field, kept in _kept(type(self)).items():
            if (value := getattr(self, field)) is not None:
                kept.write(folder / kept.name, value)

    @classmethod
    def load(cls, folder: str | Path, *context: Any) -> Self:
        """Read a folder.

        Args:
            context: passed on to the readers of what is kept beside the document, such as the robot.

        Raises:
            InputError: a file that is missing or not what was written.
        """
        place = Path(folder) / RESULT_FILE
        result = cls.from_json(read_json(place), str(place))
        parts = {
            field: kept.read(place.parent / kept.name, *context)
            for field, kept in _kept(cls).items()
            if (place.parent / kept.name).exists()
        }
        return dataclasses.replace(result, **parts)  # pyrefly: ignore[bad-specialization]

    def __repr__(self) -> str:
        texts = (p.text() + "\n" if isinstance(p, Table) else printable(p) for p in self.tables())
        return "\n".join(texts).rstrip("\n")

    def _repr_html_(self) -> str:
        return "\n".join(
            p.html() if isinstance(p, Table) else f"<p>{escape(printable(p))}</p>" for p in self.tables()
        )


@cache
def _adapter(kind: type[Result]) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


@cache
def _outside(kind: type[Result]) -> dict[str, Outside]:
    """Return the marks of the fields that are no part of the document, by field."""
    hints = get_type_hints(kind, include_extras=True)
    fields = [field.name for field in dataclasses.fields(kind)]  # pyrefly: ignore[bad-argument-type]
    marks = {name: getattr(hints[name], "__metadata__", ()) for name in fields}
    return {name: mark for name, of in marks.items() for mark in of if isinstance(mark, Outside)}


def _kept(kind: type[Result]) -> dict[str, Kept]:
    return {name: mark for name, mark in _outside(kind).items() if isinstance(mark, Kept)}
