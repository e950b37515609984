"""Everything that can be wrong with a robot's description, said before any work is done with it."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.experiments.parameter_tables import read_reported
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters
from tulip_testbed.identification.planning_ranges import planning_margins, planning_ranges
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PRESETS

Number = Annotated[int, Strict(), Field(ge=1)]
Text = Annotated[str, Strict()]
Millimetres = Annotated[float, Strict(), Field(ge=0, le=1e6)]


class Correlated(BaseModel):
    model_config = ConfigDict(extra="forbid")
    pair: tuple[Number, Number]
    joint: Text


class Paper(BaseModel):
    model_config = ConfigDict(extra="forbid")
    table: Text | None = None
    postures_used: Number
    postures_planned: Number
    residual_full_mm: tuple[Millimetres, Millimetres, Millimetres] | None = None
    residual_simplified_mm: tuple[Millimetres, Millimetres, Millimetres] | None = None
    sigma_mm: Millimetres | None = None


class Tables(BaseModel):
    """The optional parts; `load_robot` has observed the others."""

    name: Text | None = None
    z_down: list[Text] = []
    simplified: list[Number] | None = Field(default=None, min_length=1)
    correlated: list[Correlated] = []
    residual_sigma_mm: dict[str, tuple[Millimetres, Millimetres]] = {}
    planning: dict[str, Any] | None = None
    paper: Paper | None = None


def described_robot(path: Path) -> Robot:
    """Load a robot and check its description and its model against each other."""
    robot = load_robot(path)
    try:
        tables = Tables.model_validate(robot.settings)
    except ValidationError as error:
        raise InputError(f"{path}: {validation_message(error)}") from None
    if robot.stance_foot == robot.swing_foot:
        raise InputError(f"{path}: key 'swing_foot': found '{robot.swing_foot}', which is the stance foot")
    if tables.planning is not None:
        planning_ranges(robot)
        planning_margins(robot)
    model = robot.model
    try:
        parameters = base_parameters(robot, model)
    except InputError as error:
        raise InputError(f"{robot.model_file}: {error}") from None
    _check_names(path, tables, parameters)
    read_reported(robot)
    return robot


def _check_names(path: Path, tables: Tables, parameters: BaseParameters) -> None:
    """Numbers of parameters, links and joints that the model does not have."""
    count, joints, links = len(parameters.names), parameters.tree.joints, parameters.tree.links
    for key, numbers in (
        ("simplified", tables.simplified or []),
        *(("correlated.pair", entry.pair) for entry in tables.correlated),
    ):
        if wrong := [number for number in numbers if number > count or list(numbers).count(number) > 1]:
            raise InputError(
                f"{path}: key '{key}': found {wrong[0]}, expected different numbers from 1 to {count}"
            )
    for key, names, valid in (
        ("correlated.joint", [entry.joint for entry in tables.correlated], joints),
        ("z_down", tables.z_down, links),
        ("residual_sigma_mm", tables.residual_sigma_mm, PRESETS),
    ):
        if unknown := [name for name in names if name not in valid]:
            raise InputError(f"{path}: key '{key}': found '{unknown[0]}', expected one of {listed(valid)}")
