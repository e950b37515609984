"""`tulip model`."""

from __future__ import annotations

import dataclasses
from typing import Literal

from tulip_testbed.cli.options import Json, RobotFile
from tulip_testbed.sim.shipped import TULIP


def model_command(
    *,
    support: Literal["double", "right", "left"] = "double",
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Show a model's standard parameters and its base parameters.

    Every base parameter is listed with its largest term and what it sums; --json holds the whole sums. If the
    robot lacks something for the laboratory, it is listed below.

    Example: tulip model --support double
    """
    from tulip_testbed.cli.terminal import print_json, show
    from tulip_testbed.experiments.base_parameter_words import base_parameter_words
    from tulip_testbed.experiments.description import described_robot
    from tulip_testbed.experiments.parameter_tables import (
        nominal_base_table,
        nominal_link_table,
        robot_finding_table,
    )
    from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
    from tulip_testbed.sim.robot_check import robot_findings

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
                **base_parameter_words(parameters, k - 1, standard),
            }
            for k, (name, value, group) in enumerate(
                zip(parameters.names, values, parameters.groups, strict=True), 1
            )
        ],
        "findings": [dataclasses.asdict(finding) for finding in robot_findings(described)],
    }
    if as_json:
        print_json(document)
        return 0
    show(
        f"{described.model_file.name}: {counts['standard']} standard parameters -> {counts['columns']} "
        f"columns -> {counts['joined']} -> {counts['base']} base parameters in {support} support",
        "",
        nominal_link_table(document["standard"]),
        nominal_base_table(document["base"], document["total_mass"]),
        *([robot_finding_table(document["findings"])] if document["findings"] else []),
    )
    return 0
