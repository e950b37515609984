"""High correlations (eq. 15) with their reason: the joints that distinguish the two parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.kinematics import walk
from tulip_testbed.identification.statistics import HIGH_CORRELATION

NO_CORRELATION = f"No correlation above {HIGH_CORRELATION}."
MOST_JOINTS = 3  # to name


def correlation_table(
    model: str,
    pairs: Sequence[tuple[int, int, float]],
    parameters: BaseParameters,
    joint_angles: np.ndarray | None = None,
    where: str = "",
) -> Table:
    """Return every high correlation with the joints that distinguish the two parameters.

    Args:
        model: "full" or "simplified". pairs: numbers of both parameters and their correlation.
        joint_angles: of the postures, (m, n_joints) [rad], whose ranges are shown; None: they are not.
        where: path of the pairs in the run's JSON.
    """
    columns = (
        Column("no.", format="d"),
        Column("and", format="d"),
        Column("correlation", format="+.4f"),
        Column("parameters"),
        Column(
            "distinguished by (range in these postures)" if joint_angles is not None else "distinguished by"
        ),
    )
    rows = []
    for k, pair in enumerate(pairs):
        joints = joints_between(parameters, pair[0] - 1, pair[1] - 1)
        names = [_with_range(joint, parameters, joint_angles) for joint in joints]
        if len(names) > MOST_JOINTS:
            names = [f"the {len(names)} joints between them"]
        rows.append(
            [
                *(Cell(value, where and f"{where}.{k}.{place}") for place, value in enumerate(pair)),
                " and ".join(meaning(parameters, number) for number in pair[:2]),
                ", ".join(names) or "no joint: both are of one link",
            ]
        )
    title = f"Correlations above {HIGH_CORRELATION} in size (eq. 15), {model} model"
    note = "The sum or the difference of two such parameters is known better than either of them."
    return Table(title, columns, rows, note)


def _with_range(joint: str, parameters: BaseParameters, joint_angles: np.ndarray | None) -> str:
    if joint_angles is None:
        return joint
    angles = np.rad2deg(joint_angles[:, parameters.tree.joints.index(joint)])
    return f"{joint} ({angles.min():.0f} to {angles.max():.0f} deg)"


def joints_between(parameters: BaseParameters, first: int, second: int) -> list[str]:
    """Return the joints on the shortest way between the links of two base parameters."""
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


def united_links(parameters: BaseParameters, number: int) -> str:
    """Return the links that a base parameter unites: torso; right_hip ... right_ankle."""
    names = [parameters.tree.frames[frame] for frame in parameters.members(number - 1)]
    return " + ".join(names) if len(names) < 3 else f"{names[0]} ... {names[-1]}"


def meaning(parameters: BaseParameters, number: int) -> str:
    """Return what a base parameter is of: torso z; right_hip ... right_ankle y."""
    axis = parameters.names[number - 1].rsplit(".", 1)[1]
    return f"{united_links(parameters, number)} {axis}"
