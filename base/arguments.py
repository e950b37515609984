"""Refuse arguments of another type than their annotations say, before any work begins."""

from collections.abc import Callable, Sequence
from functools import cache, reduce, wraps
from inspect import Parameter, signature
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import AfterValidator, BeforeValidator, InstanceOf, Strict, TypeAdapter, ValidationError

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import check_path
from tulip_testbed.base.validation_message import argument_message

P = ParamSpec("P")
R = TypeVar("R")


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function behind a door that checks its arguments against its annotations.

    NumPy's numbers become Python's, which documents can hold.
    """
    shape = signature(function)
    hints = cache(lambda: get_type_hints(function))  # names that stand further down exist by the first call

    @wraps(function)
    def door(*args: P.args, **kwargs: P.kwargs) -> R:
        given = shape.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            hint = hints().get(name, Any)
            many = shape.parameters[name].kind is Parameter.VAR_POSITIONAL
            given.arguments[name] = (
                tuple(expect(name, one, hint) for one in value) if many else expect(name, value, hint)
            )
        return function(*given.args, **given.kwargs)

    return door


def expect(name: str, value: Any, hint: Any) -> Any:
    """Return a value that is what an annotation says, with NumPy's numbers as Python's."""
    try:
        return _adapter(hint).validate_python(value)
    except ValidationError as error:
        for problem in error.errors():
            if problem["type"] == "value_error":  # a path that cannot be one
                raise problem["ctx"]["error"] from None
        raise InputError(argument_message(name, error)) from None


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    return TypeAdapter(_strict(hint))


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.number) else value


def _checked_path(value: Any) -> Any:
    if isinstance(value, str | Path):
        check_path(value)
    return value


STRICT: dict[Any, Any] = {
    Any: Any,
    str: Annotated[str, Strict()],
    bool: Annotated[bool, Strict()],
    int: Annotated[int, Strict(), BeforeValidator(_plain)],
    float: Annotated[float, Strict(), BeforeValidator(_plain)],
    Path: Annotated[InstanceOf[Path], AfterValidator(_checked_path)],
}
GENERIC: tuple[Any, ...] = (Sequence, tuple, list)


def _strict(hint: Any) -> Any:
    """Return the type that accepts instances alone: no text for a number, no dictionary for a dataclass."""
    origin: Any = get_origin(hint)
    arguments = get_args(hint)
    if origin in (Union, UnionType):
        either = reduce(or_, map(_strict, arguments))
        return Annotated[either, AfterValidator(_checked_path)] if Path in arguments else either
    if origin in GENERIC:
        return origin[tuple(one if one is ... else _strict(one) for one in arguments)]
    return hint if origin is Literal else STRICT.get(hint) or InstanceOf[origin or hint]
