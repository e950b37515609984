"""Refuse arguments of another type than their annotations say, before any work begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_path

P = ParamSpec("P")
R = TypeVar("R")

WORDS = {
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    str: "a text",
    Path: "a path",
    Sequence: "a list of them",
    Mapping: "a dictionary",
    NoneType: "None",
}
NUMBERS: dict[Any, type] = {int: Integral, float: Real}  # NumPy's too


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function behind a door that checks its arguments against its annotations.

    NumPy's whole numbers become Python's, which documents can hold.
    """
    shape = signature(function)
    hints = cache(lambda: get_type_hints(function))  # names that stand further down exist by the first call

    @wraps(function)
    def door(*args: P.args, **kwargs: P.kwargs) -> R:
        given = shape.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            many = shape.parameters[name].kind is Parameter.VAR_POSITIONAL
            for one in value if many else [value]:
                expect(name, one, hints().get(name, object))
            if isinstance(value, np.integer):
                given.arguments[name] = int(value)
        return function(*given.args, **given.kwargs)

    return door


def expect(name: str, value: object, hint: Any) -> None:
    """Refuse a value that is not what an annotation says.

    Args:
        name: of the value, for the message.
        hint: a type, or a union of types and sequences of them.

    Raises:
        InputError: with the type that was found and those that are valid.
    """
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kinds = [get_origin(option) or option for option in options]
    fits = [option for option, kind in zip(options, kinds, strict=True) if _is(value, kind)]
    if not fits:
        raise InputError(
            f"{name}: found {_found(value)}, expected {_either([_words(kind) for kind in kinds])}"
        )
    if Path in kinds and isinstance(value, str | Path):
        check_path(value)
    if get_args(fits[0]) and isinstance(value, Sequence):
        for k, one in enumerate(value):
            expect(f"{name}[{k}]", one, get_args(fits[0])[0])


def _is(value: object, kind: Any) -> bool:
    """Return whether a value is of a kind; a text is no sequence, and neither True nor False a number."""
    if kind is Sequence:
        return isinstance(value, Sequence) and not isinstance(value, str)
    return isinstance(value, NUMBERS.get(kind, kind)) and (kind not in NUMBERS or not isinstance(value, bool))


def _found(value: object) -> str:
    """Name the type of a value, and the value itself if it is short."""
    if value is None:
        return "None"
    name = type(value).__name__
    return f"the {name} {shortened(repr(value), 40)}" if isinstance(value, str | Real) else name


def _words(kind: Any) -> str:
    return WORDS.get(kind) or kind.__name__


def _either(words: list[str]) -> str:
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last
