"""High correlations (eq. 15) as a person reads them: with the joints that tell the parameters apart."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tulip_testbed.experiments.terminal import print_table
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.kinematics import walk

MOST_JOINTS = 3  # to name as what tells two parameters apart


def correlation_table(
    pairs: list[dict[str, Any]], parameters: BaseParameters, joint_angles: np.ndarray
) -> Table:
    """Every high correlation with its reason: which joints tell the two parameters apart."""
    table = Table(
        title="Correlations above 0.85 in size (eq. 15, by the estimator): sum or difference is better known",
        title_justify="left",
        header_style="bold",
    )
    for header in ("pair", "correlation"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("parameters")
    table.add_column("told apart by (range of the joint in these postures)")
    for pair in pairs:
        names = [meaning(parameters, pair[key]) for key in "ab"]
        ranges = []
        for joint in joints_between(parameters, pair["a"] - 1, pair["b"] - 1):
            angles = np.rad2deg(joint_angles[:, parameters.tree.joints.index(joint)])
            ranges.append(f"{joint} ({angles.min():.0f} to {angles.max():.0f} deg)")
        if len(ranges) > MOST_JOINTS:
            ranges = [f"{len(ranges)} joints, all that lie between them"]
        table.add_row(
            f"{pair['a']}, {pair['b']}",
            f"{pair['rho']:+.4f}",
            escape(" and ".join(names)),
            escape(", ".join(ranges) or "columns of one link"),
        )
    return table


def print_correlations(
    screen: Console, pairs: list[dict[str, Any]], parameters: BaseParameters, joint_angles: np.ndarray
) -> None:
    if pairs:
        print_table(screen, correlation_table(pairs, parameters, joint_angles))
    else:
        screen.print("No correlation above 0.85.")


def joints_between(parameters: BaseParameters, first: int, second: int) -> list[str]:
    """Joints on the shortest way between the links of two base parameters."""
    tree, best = parameters.tree, None
    for start in parameters.members(first):
        way: dict[int, list[str]] = {start: []}
        for step in walk(tree, start):
            joint = [tree.joints[step.edge.joint]] if step.edge.joint >= 0 else []
            way[step.new] = way[step.known] + joint
        for end in parameters.members(second):
            if best is None or len(way[end]) < len(best):
                best = way[end]
    return best or []


def meaning(parameters: BaseParameters, number: int) -> str:
    """torso z; right_hip ... right_ankle y."""
    members = parameters.members(number - 1)
    axis = parameters.names[number - 1].rsplit(".", 1)[1]
    names = [parameters.tree.frames[frame] for frame in members]
    text = " + ".join(names) if len(names) < 3 else f"{names[0]} ... {names[-1]}"
    return f"{text} {axis}"
