"""Make a command of a function of the library: its options are the function's parameters.

A command adds --json, progress and, where a result can be kept and the function writes none itself, --out.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from tulip_testbed.cli.signatures import REQUIRED, Argument, PublicFunction
from tulip_testbed.sim.shipped import PLAN_NAMES, TULIP

Corrections = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FOLDER", help="folder of effects that the laboratory is known to have"),
]
SensorsName = Annotated[str, tyro.conf.arg(help="sensors of the laboratory, such as wii or force-plate")]
PlanFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="[PLAN]",
        help=f"plan folder, or the name of a plan shipped for TULip ({', '.join(PLAN_NAMES)}); "
        f"{PLAN_NAMES[0]} if left out",
    ),
]
POOL = "plan folder to choose from, or a shipped plan's name; the measured postures if left out"


def _shown(kind: Any, metavar: str, said: str) -> Any:
    return Annotated[kind, tyro.conf.arg(metavar=metavar, help=said)]


RUN = _shown(Path, "RUN", "run folder or measurement folder")
# By annotation, as the functions of the API have it.
KINDS: dict[str, Any] = {
    "Measured": _shown(Path, "FOLDER", "measurement folder"),
    "Several": _shown(
        tuple[Path, ...], "FOLDER [FOLDER ...]", "measurement folders: experiments with one robot"
    ),
    "Measured | None": _shown(Path | None, "FOLDER", "measurements before the plan"),
    "Viewed": _shown(Path, "FOLDER", "folder of a run, a plan or measurements"),
    "Exportable": RUN,
    "Proposable": RUN,
    "Reported": RUN,
    "Reported | None": _shown(Path | None, "[RUN]", "a second run, to compare"),
    "RunRobot": _shown(Path | None, "FILE", "robot; the run's if left out"),
    "Planned": PlanFolder,
    "PlanSource": _shown(Path, "PLAN", "plan folder that is being measured, or a shipped plan's name"),
    "PlanSource | None": PlanFolder,
    "PosturePlan | str | Path | None": _shown(Path | None, "PLAN", POOL),
}
OUT, JSON, FULL, ROBOT, VALUE, PROGRESS = "out", "json", "full", "robot", "value", "progress"
AS_JSON = Annotated[bool, tyro.conf.arg(help="print one JSON document on stdout instead of tables")]
EVERYTHING = Annotated[bool, tyro.conf.arg(help="show all tables, not the answer alone")]
RUN_FOLDER = Annotated[Path, tyro.conf.arg(help="new run folder")]
SAVED = _shown(Path | None, "PATH", "new folder for the result; none if left out")


def read_robot(
    robot: Annotated[Path, tyro.conf.arg(metavar="FILE", help="description of the robot (TOML)")] = TULIP,
) -> Any:
    from tulip_testbed.experiments.description import described_robot

    return described_robot(robot)


def read_plan_folder(robot: Any, value: PlanFolder = None) -> Any:
    from tulip_testbed.experiments.usable_plan import plan_for

    return plan_for(robot, value)


def read_corrections(robot: Any, value: Corrections = None) -> tuple[Any, ...]:
    from tulip_testbed.experiments.rig_folder import read_rig

    return () if value is None else tuple(read_rig(value, robot))


def read_stated_tolerances(
    value: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(
            metavar="FAMILY=VALUE",
            help="what is usual for a family of imperfections of this laboratory (SI units; 0: exact)",
        ),
    ] = (),
) -> Mapping[str, float]:
    from tulip_testbed.calibration.families import read_tolerances

    return read_tolerances(value)


def read_standard_errors(
    value: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=MM [NAME=MM ...]",
            help="standard errors at which to stop, in mm, by base parameter or all",
        ),
    ] = (),
) -> Mapping[str, float]:
    from tulip_testbed.experiments.watching.watch_day import read_targets

    return read_targets(value)


def read_plain_laboratory(robot: Any, sensors: SensorsName = "wii", corrections: Corrections = None) -> Any:
    """Set up a laboratory without hidden effects."""
    from tulip_testbed.experiments.laboratory import Laboratory

    return Laboratory(robot, sensors).with_known(*read_corrections(robot, corrections))


def read_laboratory(
    robot: Any,
    sensors: SensorsName = "wii",
    effects: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(
            metavar="NAME[:TARGET]=VALUE[,VALUE]", help="physical effects to hide in it (see `tulip atlas`)"
        ),
    ] = (),
    corrections: Corrections = None,
) -> Any:
    return read_plain_laboratory(robot, sensors, corrections).with_effects(*effects)


READERS: dict[str, Callable[..., Any]] = {
    "Robot | None": read_robot,
    "PosturePlan": read_plan_folder,
    "Effects": read_corrections,
    "Mapping[str, float] | None": read_stated_tolerances,
    "Targets | None": read_standard_errors,
    "Laboratory": read_laboratory,
    "PlainLaboratory": read_plain_laboratory,
}


def command_of(
    function: PublicFunction,
    examples: Sequence[str] = (),
    saved: bool | Literal["required"] = False,
    brief: bool = False,
) -> Callable[..., int]:
    """Return the function that tyro calls with a command's options.

    They are the function's, --json, and, as asked for, --out for its result and --full.
    """
    options: dict[str, Parameter] = {}
    for argument in function.arguments:
        for option in _options(argument):
            options.setdefault(option.name, option)
    writes = OUT in options  # itself
    if saved:
        default = Parameter.empty if saved == "required" else None
        kind = RUN_FOLDER if saved == "required" else SAVED
        options[OUT] = Parameter(OUT, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
    if brief:
        options[FULL] = Parameter(FULL, Parameter.KEYWORD_ONLY, default=False, annotation=EVERYTHING)
    options[JSON] = Parameter(JSON, Parameter.KEYWORD_ONLY, default=False, annotation=AS_JSON)

    def command(**given: Any) -> int:
        return _carry_out(function, given, given.pop(OUT) if saved and not writes else None)

    command.__signature__ = Signature(list(options.values()))  # type: ignore[attr-defined]
    command.__annotations__ = {name: option.annotation for name, option in options.items()}
    command.__doc__ = "\n\n".join([function.explanation, *(f"Example: {line}" for line in examples)])
    return command


def _carry_out(function: PublicFunction, given: dict[str, Any], out: Path | None) -> int:
    """Call the library's function and show its result; returns the exit code."""
    import tulip_testbed
    from tulip_testbed.base.files import check_new
    from tulip_testbed.cli.terminal import ERR, print_json, say, show

    as_json, full = given.pop(JSON), given.pop(FULL, False)
    if out is not None:
        check_new(out)
    own_progress = any(argument.name == PROGRESS for argument in function.arguments)
    with nullcontext() if own_progress else ERR.status(function.name.replace("_", " ")):
        result = getattr(tulip_testbed, function.name)(**_arguments(function, given))
    if out is not None:
        result.save(out)
    if isinstance(result, Iterator):
        _follow(result, as_json)
    elif as_json:
        print_json(result.to_json())
    else:
        show(*(result.tables() if full else result.answer()))
    if out is not None:
        say(f"Folder: {out}")
    result.wait()
    return result.exit_code


def _follow(watch: Any, as_json: bool) -> None:
    """Show what arrives while it arrives."""
    from tulip_testbed.cli.terminal import print_json, say, show, show_whole

    arrived = False
    for arrival in watch:
        arrived, verdict = True, arrival.verdict
        if verdict is None:
            say(f"tulip: {arrival.problem}")
        elif not as_json:
            show_whole([str(verdict)])
        else:
            print_json(verdict.to_json(), indent=None)
            if verdict.verdict != "ok" or verdict.stop:
                say(str(verdict))
    if not arrived:
        say(str(watch))
    elif not as_json:
        show(*watch.tables())


def _options(argument: Argument) -> Iterator[Parameter]:
    """Yield the options of one parameter of the library; the command line shows progress itself."""
    if argument.name == PROGRESS:
        return
    reader = READERS.get(argument.annotation)
    if reader is None:
        yield _option(argument.name, _kind(argument), argument.default, argument.by_place)
        return
    for name, option in inspect.signature(reader).parameters.items():
        if name == ROBOT and reader is not read_robot:
            yield from _options(Argument(ROBOT, "Robot | None", None, False, ""))
            continue
        default = REQUIRED if option.default is Parameter.empty else option.default
        by_place = argument.by_place and name == VALUE
        yield _option(argument.name if name == VALUE else name, option.annotation, default, by_place)


def _kind(argument: Argument) -> Any:
    """Return the type that tyro reads for a parameter without a reader, with its help."""
    if argument.annotation in KINDS:
        return KINDS[argument.annotation]
    plain = argument.annotation.replace("str | Path", "Path").replace("Sequence[str]", "tuple[str, ...]")
    kind = eval(plain, {"Path": Path})
    if kind == tuple[str, ...]:
        kind = Annotated[kind, tyro.conf.UseAppendAction]
    said = {"help": argument.text} if argument.text else {}
    if plain.endswith("| None"):  # tyro would show `{None}|PATH`
        said["metavar"] = " ".join(re.findall(r"Path|float|int|str", plain)).upper()
    return Annotated[kind, tyro.conf.arg(**said)]


def _option(name: str, kind: Any, default: Any, by_place: bool) -> Parameter:
    if by_place and name not in (OUT, ROBOT):
        kind = Annotated[kind, tyro.conf.Positional]
    default = Parameter.empty if default is REQUIRED else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def _arguments(function: PublicFunction, given: dict[str, Any]) -> dict[str, Any]:
    from tulip_testbed.cli.terminal import progress

    robot = read_robot(given[ROBOT]) if given.get(ROBOT) else None
    arguments: dict[str, Any] = {}
    for argument in function.arguments:
        name, reader = argument.name, READERS.get(argument.annotation)
        if name == PROGRESS:
            arguments[name] = progress
        elif reader is None:
            arguments[name] = robot if name == ROBOT else given[name]
        elif reader is read_robot:
            arguments[name] = robot
        else:
            wanted = inspect.signature(reader).parameters
            values = {part: given[name if part == VALUE else part] for part in wanted if part != ROBOT}
            arguments[name] = reader(**values, **({ROBOT: robot} if ROBOT in wanted else {}))
    return arguments
