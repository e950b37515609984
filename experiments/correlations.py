"""Correlations of an estimate's parameters (eq. 15), by name."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np

from tulip_testbed.base.arguments import expect
from tulip_testbed.base.errors import InputError, UnknownNameError, choices, listed, shortened
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.identification.base_parameters import BaseParameters
from tulip_testbed.identification.kinematics import walk
from tulip_testbed.identification.statistics import HIGH_CORRELATION

NO_CORRELATION = f"No correlation above {HIGH_CORRELATION}."
MOST_JOINTS = 3  # to name


class Pair(NamedTuple):
    """Two parameters by name and their correlation."""

    a: str
    b: str
    rho: float


class Pairs(Shown, tuple[Pair, ...]):
    """Correlations that exceed a `level` in size; shown as a table."""

    level: float = HIGH_CORRELATION

    def table(self) -> Table:
        heads = ("parameter", "and", ("correlation", "", "+.4f"))
        return Table(f"Correlations above {self.level:g} in size (eq. 15)", heads, self)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per pair."""
        return self.table().frame()

    def tables(self) -> list[Table | str]:
        return [self.table()] if self else [f"No correlation above {self.level:g}."]


def parameter_index(name: str | int, numbers: np.ndarray, names: tuple[str, ...]) -> int:
    """Return the place of a parameter, given by name or number, among the p of an estimate."""
    if name in names:
        return names.index(str(name))
    if isinstance(name, Integral) and name in numbers:
        return numbers.tolist().index(name)
    raise UnknownNameError(
        f"unknown parameter {shortened(repr(name))}; {choices(name, names)}, or their numbers "
        f"{listed(numbers)}"
    )


@dataclass(frozen=True, repr=False)
class Correlations(Shown):
    """Correlations (eq. 15) of p parameters: their numbers and names, (p,), and the matrix, (p, p)."""

    numbers: np.ndarray
    names: tuple[str, ...]
    matrix: np.ndarray

    def __getitem__(self, pair: tuple[str | int, str | int]) -> float:
        """Return the correlation of two parameters, given by name or number.

        Raises:
            UnknownNameError: there is none; lists the names that are close and those that are valid.
        """
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise UnknownNameError(
                f"found {shortened(repr(pair))}, expected two parameters: "
                f'correlations["{self.names[0]}", "{self.names[-1]}"]'
            )
        a, b = (parameter_index(name, self.numbers, self.names) for name in pair)
        return float(self.matrix[a, b])

    def above(self, level: float = HIGH_CORRELATION) -> Pairs:
        """Return the pairs whose correlation exceeds a level in size.

        Raises:
            InputError: a level below 0 or above 1.
        """
        expect("level", level, float)
        if not 0 <= level <= 1:
            raise InputError(f"level: found {level:g}, expected 0 to 1")
        found = np.argwhere(np.triu(np.abs(self.matrix) > level, k=1))
        pairs = Pairs(Pair(self.names[a], self.names[b], float(self.matrix[a, b])) for a, b in found)
        pairs.level = level
        return pairs

    def to_frame(self) -> Any:
        """Return the matrix as a pandas DataFrame with the names as its index and columns, (p, p)."""
        import pandas as pd

        return pd.DataFrame(self.matrix, index=list(self.names), columns=list(self.names))

    def tables(self) -> list[Table | str]:
        return [f"Correlations of {len(self.names)} parameters.", *self.above().tables()]


def correlation_table(
    model: str,
    pairs: Sequence[tuple[int, int, float]],
    parameters: BaseParameters,
    joint_angles: np.ndarray | None = None,
) -> Table | str:
    """Return every high correlation with the joints that distinguish both parameters, or that there is none.

    Args:
        model: "full" or "simplified". pairs: numbers of both parameters and their correlation.
        joint_angles: of the postures, (m, n_joints) [rad], whose ranges are shown; None: they are not.
    """
    if not pairs:
        return NO_CORRELATION
    by = "distinguished by (range in these postures)" if joint_angles is not None else "distinguished by"
    heads = (("no.", "", "d"), ("and", "", "d"), ("correlation", "", "+.4f"), "parameters", by)
    rows = []
    for pair in pairs:
        joints = joints_between(parameters, pair[0] - 1, pair[1] - 1)
        names = joints
        if joint_angles is not None:
            turned = np.rad2deg(joint_angles[:, [parameters.tree.joints.index(joint) for joint in joints]])
            ends = zip(joints, turned.min(axis=0), turned.max(axis=0), strict=True)
            names = [f"{joint} ({low:.0f} to {high:.0f} deg)" for joint, low, high in ends]
        if len(names) > MOST_JOINTS:
            names = [f"the {len(names)} joints between them"]
        rows.append(
            [
                *pair,
                " and ".join(meaning(parameters, number) for number in pair[:2]),
                ", ".join(names) or "no joint: both are of one link",
            ]
        )
    title = f"Correlations above {HIGH_CORRELATION} in size (eq. 15), {model} model"
    note = "The sum or the difference of two such parameters is known better than either of them."
    return Table(title, heads, rows, note)


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
