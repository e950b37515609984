"""Mutated inputs for the command line; importing this registers all mutations."""

from tests.fuzz import (
    columns,
    contents,
    documents,
    places,
    robot_descriptions,
    robot_files,
    robot_mjcf,
    robot_physics,
    values,
)

__all__ = [
    "columns",
    "contents",
    "documents",
    "places",
    "robot_descriptions",
    "robot_files",
    "robot_mjcf",
    "robot_physics",
    "values",
]
