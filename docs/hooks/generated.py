"""Fill `<!-- generated: NAME -->` of the reference pages from the program itself."""

import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import fields
from inspect import cleandoc
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "disable")

from tulip_testbed.base.numbers import number
from tulip_testbed.cli.commands import COMMANDS
from tulip_testbed.cli.main import command_of
from tulip_testbed.effects.catalogue import catalogue, explanation
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.effect_list import target_names
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PRESETS

ROOT = Path(__file__).resolve().parents[2]
SIGNATURES = ROOT / "docs" / "pictures" / "signatures"  # NAME.svg, drawn where it exists
MARK = re.compile(r"<!-- generated: ([a-z]+) -->")
DEFAULT = re.compile(r"\s*\((default: .*|required|repeatable)\)$", re.DOTALL)
# Joint angles are read in rad, forces in N, moments in Nm, places in m.
UNITS = {
    "encoder": "rad",
    "motor": "rad",
    "cell": "N",
    "changing_time": "s",
    "contact": "s",
    "sample_rate": "Hz",
    "placement_sd": "m, m, rad",
    "mark_sd": "m, m, rad",
    "weighed_mass_sd": "kg",
}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page with its generated parts."""
    folder = os.path.relpath(ROOT / "docs", (ROOT / "docs" / page.file.src_uri).parent)
    return MARK.sub(lambda mark: "\n".join(PARTS[mark[1]](folder)), markdown)


def commands(_: str) -> Iterator[str]:
    """Describe every command: its help, its arguments and its examples."""
    yield "| command | what it does |\n|---|---|"
    for name, command in COMMANDS.items():
        yield f"| [`{name}`](#tulip-{name.replace(' ', '-')}) | {command.summary} |"
    for name in COMMANDS:
        yield from _command(name)


def _command(name: str) -> Iterator[str]:
    import tyro

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(command_of(name), prog=f"tulip {name}")
    text, examples = [], []
    for paragraph in (parser.description or "").split("\n\n"):
        (examples if paragraph.startswith("Example: ") else text).append(paragraph)
    actions = [a for a in parser._actions if a.dest != "help"]
    positional = [str(a.metavar) for a in actions if not a.option_strings]
    yield f"\n## tulip {name}\n"
    yield "\n\n".join(_escaped(paragraph) for paragraph in text)
    yield f"\n```\n{' '.join(['tulip', name, *positional, '[OPTIONS]'])}\n```\n"
    if actions:
        yield "| argument | meaning | default |\n|---|---|---|"
    for action in actions:
        words = [", ".join(action.option_strings), str(action.metavar or "")]
        written = " ".join(filter(None, words)).replace("{", "").replace("}", "")
        if len(written) > 60:  # a choice among many: they go with the meaning
            flag, values = written.split(" ", 1)
            meaning = f"one of {values.replace(',', ', ')}. "
            written = flag
        else:
            meaning = ""
        help_text = action.help or ""
        found = DEFAULT.search(help_text)
        default = found[1].removeprefix("default:").strip() if found else ""
        meaning += DEFAULT.sub("", help_text)
        default = "" if default in ("None", "False") else default.replace(f"{ROOT}/", "")
        yield f"| `{_cell(written)}` | {_cell(_escaped(meaning))} | {_cell(default)} |"
    yield f"\nExample{'s' if len(examples) > 1 else ''}:\n\n```"
    yield "\n".join(example.removeprefix("Example: ") for example in examples) + "\n```\n"


def effects(folder: str) -> Iterator[str]:
    """Describe every effect of the catalogue for the robot TULip."""
    robot = load_robot()
    yield "| effect | what it is |\n|---|---|"
    for effect in catalogue().values():
        yield f"| [`{effect.name}`](#{effect.name}) | {_cell(effect.sentence)} |"
    for effect in catalogue().values():
        yield from _effect(effect, robot, folder)


def _effect(effect: Effect, robot: Robot, folder: str) -> Iterator[str]:
    yield f"\n## {effect.name}\n\n{_escaped(effect.sentence)}\n"
    if (SIGNATURES / f"{effect.name}.svg").exists():
        yield f"![Signature of {effect.name}]({folder}/pictures/signatures/{effect.name}.svg)\n"
    yield f"```\n--effects {effect.usage}\n```\n"
    yield "| parameter | unit | plausible |\n|---|---|---|"
    for p in effect.parameters:
        yield f"| `{p.placeholder}` | {p.unit or '-'} | {_cell(p.plausible)} |"
    if effect.targets is PLACEMENTS:
        yield f"\n`{effect.targets.word}`: one of the experiment's placements."
    elif effect.targets.word:
        names = ", ".join(f"`{name}`" for name in target_names(effect, robot))
        yield f"\n`{effect.targets.word}`, here of TULip: {names}."
    where = "the static laboratory and the full dynamics" if effect.statics else "the full dynamics alone"
    yield f"\nSimulated by {where}.\n"
    yield _escaped(cleandoc(explanation(effect.name))) + "\n"


def presets(_: str) -> Iterator[str]:
    """Tabulate the presets: plates with cells, and wrench sensors."""
    plain = [name for name, sensors in PRESETS.items() if sensors.wrench is None]
    wrenches = {name: sensors.wrench for name, sensors in PRESETS.items() if sensors.wrench is not None}
    every = [f.name for f in fields(PRESETS[plain[0]]) if f.name not in ("wrench", "cell_gain")]
    yield "## Encoders, cells and marks\n"
    yield f"| figure | unit | {' | '.join(f'`{name}`' for name in PRESETS)} |"
    yield f"|---|---|{'---|' * len(PRESETS)}"
    for name in every:
        unit = UNITS.get(name) or UNITS[name.partition("_")[0]]
        values = [_value(getattr(sensors, name)) for sensors in PRESETS.values()]
        yield f"| `{name}` | {unit} | {' | '.join(values)} |"
    yield "\n## Wrench sensors\n"
    yield f"| figure | {' | '.join(f'`{name}`' for name in wrenches)} |\n|---|{'---|' * len(wrenches)}"
    for name in [f.name for f in fields(next(iter(wrenches.values())))]:
        values = [_value(getattr(wrench, name)) for wrench in wrenches.values()]
        yield f"| `{name}` | {' | '.join(values)} |"


def _value(value: Any) -> str:
    if isinstance(value, tuple | list):
        return ", ".join(map(_value, value)) or "-"
    if isinstance(value, float):
        return number(value, ".3g")
    return str(value)


def _escaped(text: str) -> str:
    """Write `<` and `*` outside of code as themselves."""
    parts = text.split("`")
    parts[::2] = [re.sub(r"([<*\[\]$])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


PARTS = {"commands": commands, "effects": effects, "presets": presets}
