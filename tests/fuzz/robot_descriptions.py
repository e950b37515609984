"""A robot's description (TOML) and the table that it names."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from tests.fuzz.cases import Expected, Rng, pick, refused, same
from tests.fuzz.robot_cases import PLATE, ROBOT, SCENE, TOML, replaced, robot_mutation

WHOLE_LINE = re.compile(r"[\w-]+ = [^\[]*$|[\w-]+ = \[.*\]\s*(#.*)?$")  # a key with its value
STRANGE_TOML = (
    "true",
    "-1",
    "0",
    "1e300",
    "nan",
    "-inf",
    "99999999999999999999999999",
    '"x"',
    '""',
    '"\\u0000"',
    "[]",
    "[[]]",
    "{}",
    "{ pair = [1, 1] }",
    "1979-05-27",
    "[1, 2, 3]",
    '["x", 1]',
    "[nan, 1]",
    "[-1e308, 1e308]",
    '"../../../etc/passwd"',
    '"' + "x" * 300 + '"',
)


@robot_mutation
def drop_a_toml_key(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    lines = path.read_text().splitlines()
    keys = [k for k, line in enumerate(lines) if WHOLE_LINE.match(line)]
    del lines[pick(rng, keys)]
    path.write_text("\n".join(lines))
    return Expected("either", (TOML,))


@robot_mutation
def strange_toml_values(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    lines = path.read_text().splitlines()
    keys = [k for k, line in enumerate(lines) if WHOLE_LINE.match(line)]
    at = pick(rng, keys)
    lines[at] = f"{lines[at].split(' = ')[0]} = {pick(rng, STRANGE_TOML)}"
    path.write_text("\n".join(lines))
    return Expected("either", ())


@robot_mutation
def strange_toml_text(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    content = path.read_bytes()
    made = pick(
        rng,
        [
            b"",
            content[: int(rng.integers(1, 300))],
            content.replace(b"name", b"n\xff\xfeme", 1),
            content + b"\nx = " + b"[" * 100_000,
            content + b"\nx = " + b"{a=" * 100_000,
            content + b"#" * 2_000_000,
            content + b"\nname = 1\n",
            content.decode().encode("utf-16"),
            content + b"\x00",
            b"unknown = 1\n" + content,
            content.replace(b"swing_x =", b"swing_q ="),
            content.replace(b"[planning]", b"[planing]"),
            content.replace(b"[planning]", b"[planning]\nswing_z = [0, 1]"),
            content.replace(b"[-0.12, 0.12]", b"[0.12, -0.12]"),
            content.replace(b"[paper]", b"[paper]\nyear = 2013"),
        ],
    )
    path.write_bytes(made)
    return refused(TOML)


@robot_mutation
def harmless_toml_text(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    content = path.read_bytes()
    made = pick(rng, [b"\xef\xbb\xbf" + content, content.replace(b"\n", b"\r\n"), content + b"\n# \xc3\xa4"])
    path.write_bytes(made)
    return same()


@robot_mutation
def paths_that_lead_elsewhere(folder: Path, rng: Rng) -> Expected:
    key, name = pick(rng, (("model", ROBOT), ("scene", SCENE), ("plate", PLATE)))
    if key == "plate":
        replaced(folder / TOML, f'scene = "{SCENE}"', f'plate = "{PLATE}"')
    outside = folder.parent / "outside"
    shutil.copytree(folder, outside)
    file = folder / name
    kind = pick(rng, ("climb", "absolute", "link", "folder", "pipe", "device", "missing", "nul", "long"))
    path = {
        "climb": f"../outside/{name}",
        "absolute": str(outside / name),
        "device": "/dev/zero",
        "missing": "gone.xml",
        "nul": "a\\u0000b",
        "long": "x" * 300,
    }.get(kind, name)
    if kind == "link":
        file.unlink()
        file.symlink_to(outside / name)
    elif kind in ("folder", "pipe"):
        file.unlink()
        file.mkdir() if kind == "folder" else os.mkfifo(file)
    replaced(folder / TOML, f'{key} = "{name}"', f'{key} = "{path}"')
    return refused()


@robot_mutation
def scenes_that_are_built(folder: Path, rng: Rng) -> Expected:
    """From the robot and a plate, its own or the one that is shipped."""
    made = pick(rng, ("", f'plate = "{PLATE}"'))
    replaced(folder / TOML, f'scene = "{SCENE}"', made)
    return same()


@robot_mutation
def strange_drives(folder: Path, rng: Rng) -> Expected:
    value = pick(rng, (*STRANGE_TOML, "0.0", "0.02", "1e-300", "1e-3"))
    keys = ("[drives]\nwind_up", "[drives]\nbacklash", "[compliance]\nsole", "[compliance]\nsole_tilt")
    table = pick(rng, keys)
    path = folder / TOML
    path.write_text(f"{path.read_text()}\n{table} = {value}\n")
    return Expected("either", ())


@robot_mutation
def parameters_that_are_not_there(folder: Path, rng: Rng) -> Expected:
    path = folder / TOML
    old, new = pick(
        rng,
        [
            ("[1, 5, 9,", "[26, 5, 9,"),
            ("[1, 5, 9,", "[0, 5, 9,"),
            ("[1, 5, 9,", "[5, 5, 9,"),
            ("[1, 5, 9,", "[1.0, 5, 9,"),
            ("pair = [12, 13]", "pair = [12, 99]"),
            ("pair = [12, 13]", "pair = [12, 12]"),
            ("pair = [12, 13]", "pair = [12, 13, 14]"),
            ('joint = "right_ankle_roll"', 'joint = "nose"'),
            ('"right_hip", "right_upper_leg"', '"nose", "right_upper_leg"'),
            ("postures_planned = 150", "postures_planned = 0"),
            ("wii = [4.2, 0.7]", "wii = [4.2]"),
            ("wii = [4.2, 0.7]", "wii = 4.2"),
            ("wii = [4.2, 0.7]", "wij = [4.2, 0.7]"),
            (f'scene = "{SCENE}"', f'scene = "{SCENE}"\nplate = "{PLATE}"'),
            ("[4.2, 3.6, 10.7]", "[4.2, 3.6]"),
            ("[4.2, 3.6, 10.7]", '["4.2", 3.6, 1]'),
            ('stance_foot = "right_foot"', 'stance_foot = "left_foot"'),
            ('stance_foot = "right_foot"', 'stance_foot = "nose"'),
            ('swing_foot = "left_foot"', 'swing_foot = "torso"'),
        ],
    )
    replaced(path, old, new)
    return refused(TOML if "foot" not in old or "left" in new else ROBOT)


@robot_mutation
def a_broken_paper_table(folder: Path, rng: Rng) -> Expected:
    path = folder / "table2.csv"
    content = path.read_bytes()
    made = pick(
        rng,
        [
            None,
            content.replace(b"number", b"nr"),
            content.replace(b"-10.96", b"nan"),
            content.replace(b"-10.96", b"many"),
            content.replace(b"1,-10.96", b"one,-10.96"),
            content.replace(b"1,-10.96", b"1"),
            b"\xff\xfe" + content,
            content.replace(b"-10.96", b'"' + b"x" * 200_000),
            b"pipe",
            b"outside",
        ],
    )
    if made is None or made == b"pipe":
        path.unlink()
    if made == b"pipe":
        os.mkfifo(path)
    elif made == b"outside":
        path.rename(folder.parent / "table2.csv")
        replaced(folder / TOML, '"table2.csv"', '"../table2.csv"')
    elif made is not None:
        path.write_bytes(made)
    return refused("table2.csv")
