"""Measurements, plans and series with other values in some of their rows."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

Make = Callable[[np.ndarray], Any]


def changed(rows: Any, **fields: Make) -> Any:
    """Replace fields by what functions make of copies of them."""
    values = {name: make(getattr(rows, name).copy()) for name, make in fields.items()}
    return dataclasses.replace(rows, **values)


def put(*place: Any, value: Any) -> Make:
    """Return a function that puts a value into a place of an array."""

    def make(values: np.ndarray) -> np.ndarray:
        values[place] = value
        return values

    return make


def plus(change: Any, *place: Any) -> Make:
    """Return a function that adds to the values in a place of an array."""
    return lambda values: put(*place, value=values[place] + change)(values)


def within(part: str, m: Any, **fields: Any) -> Any:
    """Replace fields of a part of measurements, such as their `sensors` or `contacts`."""
    return dataclasses.replace(m, **{part: dataclasses.replace(getattr(m, part), **fields)})
