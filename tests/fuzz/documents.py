"""Edit JSON documents: other values, types, lengths and names, more keys or fewer."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import assume
from hypothesis import strategies as st

from tests.fuzz.changes import Draw, Make, one

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


def drop_a_key(document: dict, draw: Draw) -> None:
    inside, key = one(draw, [(inside, key) for inside, key in places(document) if isinstance(inside, dict)])
    del inside[key]


def strange_value(document: dict, draw: Draw) -> None:
    inside, key = one(draw, places(document))
    inside[key] = draw(st.sampled_from(STRANGE) | json_values)


# --- edits that any document bears -------------------------------------------------------------

HOSTILE = (
    *("[bold red]x[/]", "[/]", "[link=file:///etc/passwd]x[/link]", "<script>alert(1)</script>", "</td>&lt;"),
    *("\x1b[2J\x1b[31mx", "\x9b31m", "\u202eabc\u202c", "\u2066x", "a\nb", "a\rb", "a\tb", "\x00"),
    "\x7f\x08",
    *("\"'`", "{{ 7 * 7 }}", "%s{0}", "${HOME}", "\u200b", "\ufeffx", "e\u0301", "x" * 5_000, " ", ""),
)
ODD = (0, -1, -0.0, 1e-300, -1e300, 1e300, 1e150, 2**53 + 1, 10**250, 10.0**10, -(10**12), 10**13, 0.5, True)
NO_NUMBERS = ("NaN", "Infinity", "-Infinity", "1e400", "-1e999", "1" + "0" * 400)
FACTORS = (0.5, 0.9, 1.001, 1.1, 2.0, 10.0, -1.0)
MARK = 123456789.125  # stands where a text goes that is no JSON


def leaves(document: Any, *kinds: type) -> list[tuple[Any, Any]]:
    """Return the containers and keys of the values of these types."""
    return [(inside, key) for inside, key in places(document) if type(inside[key]) in kinds]


def another_type(document: Any, draw: Draw) -> None:
    inside, key = one(draw, places(document))
    others = [v for v in STRANGE if type(v) is not type(inside[key])]
    inside[key] = one(draw, others)


def a_key_more(document: Any, draw: Draw) -> None:
    inside, key = one(draw, [(inside, key) for inside, key in places(document) if isinstance(inside, dict)])
    inside[one(draw, ("note", key.upper(), f" {key}", f"{key}.x", *HOSTILE))] = one(
        draw, (inside[key], *STRANGE)
    )


def another_length(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, list))
    old = inside[key]
    inside[key] = one(
        draw, ([], old[:-1], old[1:], [*old, *old[-1:]], [*old, None], [*old, []], old * 40, [old])
    )


def another_order(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, list))
    inside[key] = draw(st.permutations(inside[key]))


def an_odd_number(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, int, float))
    inside[key] = one(draw, ODD)


def another_number(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, int, float))
    old, factor = inside[key], one(draw, FACTORS)
    inside[key] = old + round(factor) if type(old) is int else (old or 1e-3) * factor


def another_text(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, str))
    texts = [inner[at] for inner, at in leaves(document, str)]
    inside[key] = one(draw, ["nose", inside[key].upper(), inside[key] + " ", *dict.fromkeys(texts)])


def a_hostile_text(document: Any, draw: Draw) -> None:
    inside, key = one(draw, leaves(document, str))
    inside[key] = one(draw, HOSTILE)


def a_hostile_key(document: Any, draw: Draw) -> None:
    inside, key = one(draw, [(inside, key) for inside, key in places(document) if isinstance(inside, dict)])
    inside[one(draw, HOSTILE)] = inside.pop(key)


def no_number(text: str, draw: Draw) -> list:
    """Put what JSON does not call a finite number in the place of one."""
    document = json.loads(text)
    inside, key = one(draw, leaves(document, int, float))
    inside[key] = MARK
    return [json.dumps(document).replace(repr(MARK), no) for no in NO_NUMBERS]


EDITS: dict[str, Callable[[Any, Draw], None]] = {
    "another type": another_type,
    "a strange value": strange_value,
    "a key less": drop_a_key,
    "a key more": a_key_more,
    "a list of another length": another_length,
    "a list in another order": another_order,
    "an odd number": an_odd_number,
    "another number": another_number,
    "another text": another_text,
    "a hostile text": a_hostile_text,
    "a hostile key": a_hostile_key,
}
