"""Make a command of a function of the library: its options are the function's parameters.

A command adds --json, progress and, where a result can be kept and the function writes none itself, --out.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

import tyro

from tulip_testbed.base.files import check_new, check_path
from tulip_testbed.base.progress import Progress
from tulip_testbed.base.result import Result
from tulip_testbed.cli.readers import READERS, read_robot
from tulip_testbed.cli.terminal import print_json, progress, say, show
from tulip_testbed.sim.robot import Robot

OUT, JSON, ROBOT, VALUE = "out", "json", "robot", "value"
AS_JSON = Parameter(
    JSON,
    Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[bool, tyro.conf.arg(help="print one JSON document on stdout instead of tables")],
)
SAVED = Parameter(
    OUT,
    Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[Path | None, tyro.conf.arg(help="new folder for the result; none if left out")],
)


def command_of(
    function: Callable[..., Result], examples: Sequence[str] = (), saved: bool = False
) -> Callable[..., int]:
    """Return the function that tyro calls with a command's options.

    Args:
        function: of the library.
        examples: command lines for the help.
        saved: whether the command has an option --out, for a result that the function does not write itself.
    """
    hints, help_of = get_type_hints(function, include_extras=True), _argument_help(function)
    options: dict[str, Parameter] = {}
    for parameter in signature_of(function):
        for option in _options(parameter, hints[parameter.name], help_of):
            options.setdefault(option.name, option)
    if saved:
        options[OUT] = SAVED
    options[JSON] = AS_JSON

    def command(*positional: Any, **given: Any) -> int:
        given |= dict(zip(options, positional, strict=False))
        as_json, out = given.pop(JSON), given.pop(OUT) if saved else None
        for value in given.values():
            for path in value if isinstance(value, tuple | list) else (value,):
                if isinstance(path, Path):
                    check_path(path)
        if out is not None:
            check_new(out)
        result = function(**_arguments(function, hints, given))
        if out is not None:
            result.save(out)
        if as_json:
            print_json(result.to_json())
        else:
            show(*result.tables())
        if out is not None:
            say(f"Folder: {out}")
        return result.exit_code

    command.__signature__ = Signature(sorted(options.values(), key=lambda option: option.kind))  # type: ignore
    command.__annotations__ = {name: option.annotation for name, option in options.items()}
    command.__doc__ = "\n\n".join([_explanation(function), *(f"Example: {line}" for line in examples)])
    return command


def signature_of(function: Callable[..., Any]) -> list[Parameter]:
    """Return the parameters of a function that the command line gives; it shows progress itself."""
    parameters = inspect.signature(function).parameters.values()
    return [one for one in parameters if one.name != "progress"]


def _options(parameter: Parameter, hint: Any, help_of: dict[str, str]) -> Iterator[Parameter]:
    """Yield the options of one parameter; one that may be given by its place needs no flag."""
    reader, first = _reader(hint), parameter.kind is Parameter.POSITIONAL_OR_KEYWORD
    if reader is None:
        yield _option(parameter.name, hint, parameter.default, help_of.get(parameter.name, ""), first)
        return
    hints = get_type_hints(reader, include_extras=True)
    for one in inspect.signature(reader).parameters.values():
        if hints[one.name] is Robot:
            yield from _options(Parameter(ROBOT, Parameter.KEYWORD_ONLY), Robot | None, {})
            continue
        name = parameter.name if one.name == VALUE else one.name
        yield _option(name, hints[one.name], one.default, help_of.get(name, ""), first and one.name == VALUE)


def _option(name: str, hint: Any, default: Any, text: str, first: bool) -> Parameter:
    if get_origin(hint) is not Annotated and text:
        hint = Annotated[hint, tyro.conf.arg(help=text)]
    if first:
        hint = Annotated[hint, tyro.conf.Positional]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _reader(hint: Any) -> Callable[..., Any] | None:
    return next((reader for kind, reader in READERS.items() if kind == hint), None)


def _arguments(function: Callable[..., Any], hints: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Return what a function is called with, of the options that were given."""
    robot = read_robot(given[ROBOT]) if ROBOT in given else None
    arguments: dict[str, Any] = {}
    for parameter in inspect.signature(function).parameters.values():
        name, reader = parameter.name, _reader(hints[parameter.name])
        if hints[name] == Progress:
            arguments[name] = progress
        elif reader is None:
            arguments[name] = given[name]
        elif reader is read_robot:
            arguments[name] = robot
        else:
            wanted = inspect.signature(reader).parameters
            of = {one: given[name if one == VALUE else one] for one in wanted if one != ROBOT}
            arguments[name] = reader(**of, **({ROBOT: robot} if ROBOT in wanted else {}))
    return arguments


def _explanation(function: Callable[..., Any]) -> str:
    """Return the docstring of a function up to its sections."""
    return re.split(r"\n\s*(?:Args|Returns|Raises|Yields):\n", inspect.getdoc(function) or "")[0].strip()


def _argument_help(function: Callable[..., Any]) -> dict[str, str]:
    """Return what the docstring of a function says of each parameter."""
    section = re.search(r"\nArgs:\n((?:    .*\n?|\n)+)", inspect.getdoc(function) or "")
    texts: dict[str, str] = {}
    for entry in re.split(r"\n(?=    \S)", section[1].rstrip()) if section else ():
        names, _, text = entry.strip().partition(": ")
        texts |= dict.fromkeys(names.split(", "), " ".join(text.split()).rstrip("."))
    return texts
