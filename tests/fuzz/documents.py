"""Edit JSON documents: other values, types, lengths and names, more keys or fewer."""

import json
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import assume
from hypothesis import strategies as st

from tests.fuzz.changes import Draw, Make, one
from tulip_testbed.base.errors import InputError

STRANGE = (
    *(None, True, False, 0, -1, 1e300, -1e300, 1e-300, 10**250, [], {}, [[]], [None], {"a": 1}),
    *("", "9.81", "nan", "x" * 100_000, "\x1b[31m", "\x00", "../../etc/passwd", [1, 2, 3, 4, 5]),
)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def fine_json(text: str, draw: Draw) -> list:
    document = json.loads(text)
    capitals = {"tables": {name: found.upper() for name, found in document["tables"].items()}}
    unknown = {"note": "écrit à la main", "a": [1, 2.5, None, True]}
    others = dict(reversed(document.items())), document | capitals, document | unknown
    return [json.dumps(document, separators=(",", ":")), *(json.dumps(d, ensure_ascii=False) for d in others)]


def wrong_json(text: str, draw: Draw) -> list:
    deep = one(draw, (40, 500, 5_000, 1_000_000))
    values = ("NaN", "1.0", "2", "true", '1, "version": 1', '1, "format": "x"', '1, "\\udfff": 1')
    nested = '"\\ud800"', "[" * deep + "]" * deep, '{"a":' * deep + "1" + "}" * deep
    more = (f'1, "x": {x}' for x in ("-Infinity", "1e400", "1" + "0" * 400, "1" + "0" * 5000, *nested))
    changed = [text.replace('"version": 1', f'"version": {value}') for value in (*values, *more)]
    return [*changed, "null", "[]", '"manifest"', "[" * deep, text + "}"]


def edited(edit: Callable[[dict, Draw], Any]) -> Make:
    """Edit a JSON document."""

    def make(text: str, draw: Draw) -> list:
        document = json.loads(text)
        edit(document, draw)
        assume(document != json.loads(text))
        return [json.dumps(document)]

    return make


def put(trail: str, *values: Any, make: Callable[[Any], Any] = lambda old: ()) -> Make:
    """Give a key, some levels down, another value or one that is made of its own."""

    def edit(document: dict, draw: Draw) -> None:
        place: Any = document
        *above, key = [int(name) if name.isdigit() else name for name in trail.split(".")]
        for name in above:
            place = place[name]
        old = place[key] if isinstance(key, int) else place.get(key)
        place[key] = one(draw, [*values, *make(old)])

    return edited(edit)


def places(document: Any) -> Iterator[tuple[Any, Any]]:
    """Return every container inside a document with each of its keys."""
    for key in document if isinstance(document, dict) else range(len(document)):
        yield document, key
        if isinstance(document[key], dict | list):
            yield from places(document[key])


def changed_anywhere(document: Any, draw: Draw) -> None:
    """Lose a key, or give one any value."""
    inside, key = one(draw, places(document))
    if isinstance(inside, dict) and draw(st.booleans()):
        del inside[key]
    else:
        inside[key] = draw(st.sampled_from(STRANGE) | json_values)


def read_or_refused(read: Callable[[], Any]) -> Any:
    """Return what is read, or nothing if it is refused in one line."""
    try:
        return read()
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    return None


HOSTILE = (
    *("[bold red]x[/]", "[/]", "[link=file:///etc/passwd]x[/link]", "<script>alert(1)</script>", "</td>&lt;"),
    *("\x1b[2J\x1b[31mx", "\x9b31m", "\u202eabc\u202c", "\u2066x", "a\nb", "a\rb", "a\tb", "\x00"),
    *("\x7f\x08", "knee[left]", "a|b", "\ud800"),
    *("\"'`", "{{ 7 * 7 }}", "%s{0}", "${HOME}", "\u200b", "\ufeffx", "e\u0301", "x" * 5_000, " ", ""),
)
