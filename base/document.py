"""JSON documents with checked values: the class that writes a document reads it again."""

import json
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.table_files import finite, read_json, write_json
from tulip_testbed.base.validation_message import validation_message

Seed = Annotated[int, Field(ge=0)]


class Document(BaseModel):
    """A JSON object: values of declared keys are checked, other keys are kept as they are."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    @classmethod
    def read(cls, path: Path) -> Self:
        try:
            return cls.model_validate_json(json.dumps(read_json(path)))
        except ValidationError as error:
            raise InputError(f"{path}: {validation_message(error)}") from None

    def write(self, path: Path) -> None:
        """Write a file, which appears whole."""
        write_json(path, self.plain())

    def plain(self) -> dict[str, Any]:
        """Return the document as plain JSON values, without the keys that were not set."""
        return finite(self.model_dump(exclude_unset=True))


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


def first_difference(there: Any, here: Any, name: str = "") -> tuple[str, Any, Any] | None:
    """Find the first value in which two JSON documents differ.

    Returns:
        its path with dots and both values; None: the documents are equal.
    """
    if isinstance(there, dict) and isinstance(here, dict):
        for key in [*here, *(key for key in there if key not in here)]:
            inner = first_difference(there.get(key), here.get(key), f"{name}.{key}" if name else key)
            if inner is not None:
                return inner
        return None
    return None if there == here else (name, there, here)
