"""The functions of the API as their source has them, read without loading the library."""

import ast
import re
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from typing import Any

API = Path(__file__).parent.parent / "api"
REQUIRED = object()  # the default of a parameter that has none


@dataclass(frozen=True)
class Argument:
    """A parameter of a function: annotation as text, default or `REQUIRED`, what the docstring says of it."""

    name: str
    annotation: str
    default: Any
    by_place: bool
    text: str


@dataclass(frozen=True)
class PublicFunction:
    """A function of the API, explained by its docstring up to the sections."""

    name: str
    arguments: tuple[Argument, ...]
    explanation: str


@cache
def _sources() -> dict[str, tuple[ast.FunctionDef, dict[str, tuple[str, str]]]]:
    """Return every function of `tulip_testbed.api`, and where its module has its names from, by name."""
    found = {}
    for path in sorted(API.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = {
            alias.asname or alias.name: (str(node.module), alias.name)
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        found |= {node.name: (node, imported) for node in tree.body if isinstance(node, ast.FunctionDef)}
    return found


def summary_of(name: str) -> str:
    """Return the first line of a function's docstring."""
    return (ast.get_docstring(_sources()[name][0]) or "").partition("\n")[0]


def public_function(name: str) -> PublicFunction:
    node, imported = _sources()[name]
    said = cleandoc(ast.get_docstring(node) or "")
    texts, placed = _argument_texts(said), node.args.args
    missing = [None] * (len(placed) - len(node.args.defaults))
    pairs = [
        *((one, default, True) for one, default in zip(placed, [*missing, *node.args.defaults], strict=True)),
        *((o, d, False) for o, d in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)),
    ]
    return PublicFunction(
        name,
        tuple(
            Argument(
                name=one.arg,
                annotation=ast.unparse(one.annotation) if one.annotation else "str",
                default=REQUIRED if default is None else _value(default, imported),
                by_place=by_place,
                text=texts.get(one.arg, ""),
            )
            for one, default, by_place in pairs
        ),
        re.split(r"\n\s*(?:Args|Returns|Raises|Yields):\n", said)[0].strip(),
    )


def _value(node: ast.expr, imported: dict[str, tuple[str, str]]) -> Any:
    """Return a default: a literal, or a constant of the module that it is imported from."""
    if isinstance(node, ast.Name):
        module, name = imported[node.id]
        return getattr(import_module(module), name)
    if isinstance(node, ast.Subscript):
        return _value(node.value, imported)[ast.literal_eval(node.slice)]
    return ast.literal_eval(node)


def _argument_texts(said: str) -> dict[str, str]:
    section = re.search(r"\nArgs:\n((?:    .*\n?|\n)+)", said)
    texts: dict[str, str] = {}
    for entry in re.split(r"\n(?=    \S)", section[1].rstrip()) if section else ():
        names, _, text = entry.strip().partition(": ")
        texts |= dict.fromkeys(names.split(", "), " ".join(text.split()).rstrip("."))
    return texts
