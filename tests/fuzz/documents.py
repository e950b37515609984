"""The manifest: keys, values and text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.fuzz.cases import Expected, Rng, manifest_of, measurements_only, mutation, pick, refused, same

STRANGE: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1e300,
    -1e300,
    1e-300,
    10**250,
    "",
    "9.81",
    "nan",
    "x" * 100_000,
    "\x1b[31m",
    "\x00",
    "../../etc/passwd",
    [],
    {},
    [[]],
    [None],
    {"a": 1},
    [1, 2, 3, 4, 5],
)


def _paths(content: Any, trail: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [trail] if trail else []
    if isinstance(content, list):
        content = dict(enumerate(content))
    if isinstance(content, dict):
        for key, value in content.items():
            found += _paths(value, (*trail, key))
    return found


def _at(content: Any, trail: tuple[Any, ...]) -> Any:
    for key in trail:
        content = content[key]
    return content


@mutation
def drop_a_json_key(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    *trail, key = pick(rng, [p for p in _paths(content) if isinstance(_at(content, p[:-1]), dict)])
    del _at(content, tuple(trail))[key]
    path.write_text(json.dumps(content))
    # What `made` and `software` hold is free; without its hash, either of two tables is in doubt.
    return Expected("either", ("postures",) if "tables" in (*trail, key) else (path.name,))


@mutation
def strange_json_values(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    *trail, key = pick(rng, _paths(content))
    _at(content, tuple(trail))[key] = pick(rng, STRANGE)
    path.write_text(json.dumps(content))
    return Expected("either", (folder.name,))


@mutation
def strange_json_text(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    text = path.read_text()
    key = pick(rng, ('"version": 1', '"format"'))
    deep = int(rng.choice([40, 500, 5_000, 1_000_000]))
    made = pick(
        rng,
        [
            text.replace(key, f'"format": "x", {key}' if key == '"format"' else f"{key}, {key}", 1),
            text.replace('"version": 1', '"version": NaN'),
            text.replace('"version": 1', '"version": 1, "x": -Infinity'),
            text.replace('"version": 1', '"version": 1, "x": 1e400'),
            text.replace('"version": 1', f'"version": 1, "x": 1{"0" * 400}'),
            text.replace('"version": 1', f'"version": 1, "x": 1{"0" * 5000}'),
            text.replace('"version": 1', '"version": 1.0'),
            text.replace('"version": 1', '"version": 2'),
            text.replace('"version": 1', '"version": true'),
            text.replace('"version": 1', '"version": 1, "x": "\\ud800"'),
            text.replace('"version": 1', '"version": 1, "\\udfff": 1'),
            text.replace('"version": 1', f'"version": 1, "x": {"[" * deep}{"]" * deep}'),
            text.replace('"version": 1', '"version": 1, "x": ' + '{"a":' * deep + "1" + "}" * deep),
            "[" * deep,
            text[: int(rng.integers(0, len(text) - 2))],
            text + "}",
            text + text,
            "",
            "null",
            "[]",
            '"manifest"',
            text.replace("\n", "\x00"),
            text.encode("utf-16"),
            text.encode().replace(b'"version"', b'"\xff\xfe": 1, "version"'),
            "{" + " " * 5_000_000 + text[1:],
        ],
    )
    path.write_bytes(made.encode() if isinstance(made, str) else made)
    return refused(path.name)


@mutation
def harmless_json_text(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    text = path.read_text()
    content = json.loads(text)
    upper = json.dumps(content | {"tables": {k: v.upper() for k, v in content["tables"].items()}})
    made = pick(
        rng,
        [
            "\ufeff" + text,
            text.replace("\n", "\r\n"),
            json.dumps(content, separators=(",", ":")),
            json.dumps(dict(reversed(content.items()))),
            json.dumps(content | {"note": "écrit à la main", "a": [1, 2.5, None, True]}, ensure_ascii=False),
            upper,
        ],
    )
    path.write_bytes(made.encode())
    return same()


@mutation
def another_robot(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    content["robot"]["sha256"] = pick(rng, ("0" * 64, "", "x" * 10_000, "\x1b[2J"))
    path.write_text(json.dumps(content))
    return refused(path.name, "hash mismatch")


@measurements_only
def wrong_joints(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    joints = content["joints"]
    content["joints"] = pick(
        rng,
        [
            joints[::-1],
            joints[:-1],
            [*joints, joints[0]],
            [joints[0]] * 12,
            [*joints[1:], "nose"],
            [""],
            ["\x1b[2J"],
            [f"joint{k}" for k in range(50_000)],
        ],
    )
    path.write_text(json.dumps(content))
    return refused(folder.name)


@measurements_only
def degenerate_plates(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    plate = pick(rng, ("right", "left"))
    made = pick(rng, ("point", "line", "huge", "tiny"))
    for k, (corner, (x, y)) in enumerate(content["plates"][plate]["cells"].items()):
        content["plates"][plate]["cells"][corner] = {
            "point": [0.1, 0.1],
            "line": [0.1 * k, 0.2 * k],
            "huge": [1e200 * x, 1e200 * y],
            "tiny": [1e-200 * x, 1e-200 * y],
        }[made]
    path.write_text(json.dumps(content))
    return refused(path.name, f"plates.{plate}.cells")


@measurements_only
def strange_data_sheets(folder: Path, rng: Rng) -> Expected:
    """Of the same sensors, so that the estimates stay."""
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    key = pick(rng, ("encoder_resolution", "cell_sd", "cell_resolution", "placement_sd", "weighed_mass"))
    if key == "weighed_mass":
        content[key] = pick(rng, (None, {"value": 1e-3, "sd": 0.0}, {"value": 1e5, "sd": 1e-12}))
    else:
        value = pick(rng, (None, 0.0, 0, 1e-12, 1e5, 1))
        content["sensors"][key] = [value] * 3 if key == "placement_sd" and value is not None else value
    path.write_text(json.dumps(content))
    return same()


@measurements_only
def strange_gravity(folder: Path, rng: Rng) -> Expected:
    path = manifest_of(folder)
    content = json.loads(path.read_text())
    content["gravity"] = pick(rng, (-9.81, 0, 1e-300, 1e300, "9.81", None, True, [9.81]))
    path.write_text(json.dumps(content))
    return refused(path.name, "key 'gravity'")
