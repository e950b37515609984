"""`tulip model`."""

from __future__ import annotations

from typing import Literal

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.terminal import console, print_json
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.sim.robot import TULIP


def model_command(
    *,
    support: Literal["double", "right", "left"] = "double",
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Show a model's standard parameters and how they group into base parameters.

    Example: tulip model --support double
    """
    described = described_robot(robot)
    model = described.model
    parameters = base_parameters(described, model, support)
    standard = standard_parameters(model)
    values = parameters.values(standard)
    counts = {
        "standard": standard.size,
        "columns": 3 * len(parameters.tree.frames),
        "joined": parameters.merged_columns,
        "base": len(parameters.names),
    }
    document = {
        "model": described.model_file.name,
        "support": support,
        "total_mass": float(standard[:, 0].sum()),
        "counts": counts,
        "standard": [
            {"link": link, "mass": m, "mcx": x, "mcy": y, "mcz": z}
            for link, (m, x, y, z) in zip(parameters.tree.links, standard.tolist(), strict=True)
        ],
        "base": [
            {
                "number": k,
                "name": name,
                "value": float(value),
                "columns": group,
                "standard": parameters.grouping(k - 1),
            }
            for k, (name, value, group) in enumerate(
                zip(parameters.names, values, parameters.groups, strict=True), 1
            )
        ],
    }
    if as_json:
        print_json(document)
        return 0
    screen = console()
    steps = (counts["columns"], counts["joined"], counts["base"])
    grouping = f"{steps[0]} columns -> {steps[1]} -> {steps[2]} base parameters in {support} support"
    screen.print(
        f"{described.model_file.name}: {counts['standard']} standard parameters -> {grouping}", soft_wrap=True
    )
    screen.print("Standard parameters m, m c_x, m c_y, m c_z (kg, kg m):")
    for row in document["standard"]:
        screen.print(
            f"  {row['link']:18s} {row['mass']:8.3f} {row['mcx']:9.4f} {row['mcy']:9.4f} {row['mcz']:9.4f}",
            highlight=False,
        )
    screen.print(f"Base parameters in mm; M = {document['total_mass']:.3f} kg:")
    for row in document["base"]:
        screen.print(
            f"  {row['number']:2d} {row['name']:20s} {1e3 * row['value']:9.2f}  times M: {row['standard']}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    return 0
