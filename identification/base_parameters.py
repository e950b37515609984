"""Base parameters from standard parameters, for any tree of hinges (eqs 4 to 6).

With the stance foot as base, eq. 1 reads p_CoM = sum_f R_f(q) beta_f over the frames f, where
beta_f = (m_f c_f + sum of the masses beyond f times the vector to the next joint) / M. A frame has
three columns. A hinge leaves its axis fixed, R_parent a = R_child a, and so merges two columns; a vector
that stays vertical has no column in x and y. The remaining columns are independent.
"""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from scipy.linalg import solve_triangular

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.kinematics import (
    Tree,
    joint_axes,
    link_rotations,
    moved_frames,
    seen_from,
    tree_of,
    walk,
)
from tulip_testbed.sim.robot import Robot, sole_point

AXES = "xyz"
# Which feet carry the robot. "left" alone takes the left foot as base; the last two take the right one and
# describe rows on either foot with the parameters of double support and the z of the feet that are lifted.
SUPPORTS = ("double", "right", "left", "mixed", "double-left")
ROWS_ON_EITHER = ("mixed", "double-left")


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Base parameter set of a robot in one kind of support.

    Attributes:
        tree: kinematics.
        base, swing: frame numbers of the stance foot and of the other foot.
        names: LINK.AXIS of the p parameters, numbered from 1 as in the paper.
        groups: frame columns that each parameter combines, as text.
        columns: frame columns 3 f + axis that form the regressor, (k,), k >= p.
        combination: weights of these columns in the base regressor, (k, p): +1, or -1 where an axis is
            reported reversed. k > p only if the hinges of one body do not meet: then the massless frame
            between them carries one mass along a fixed vector.
        from_frames: map from frame parameters to base parameters, (p, 3 n_frames).
        from_standard: map from the standard parameters [m, m c_x, m c_y, m c_z] per link to base parameters
            times the total mass, (p, 4 n_links).
        support: argument of `base_parameters`.
        merged_columns: number of columns after merging by hinges, before vertical ones are dropped.
    """

    tree: Tree
    base: int
    swing: int
    names: tuple[str, ...]
    groups: tuple[str, ...]
    columns: np.ndarray
    combination: np.ndarray
    from_frames: np.ndarray
    from_standard: np.ndarray
    merged_columns: int
    support: str

    def rotations(self, joint_angles: np.ndarray, support: np.ndarray | None = None) -> np.ndarray:
        """Compute all frames' rotations in the carrying foot's, (m, n_frames, 3, 3); see `regressor`."""
        rotations = link_rotations(self.tree, self.base, joint_angles)
        return rotations if support is None else seen_from(self.swing, rotations, self.on_swing_foot(support))

    def on_swing_foot(self, support: np.ndarray) -> np.ndarray:
        """Return which rows have the swing foot's frame as base frame, (m,) bool."""
        return (support == "left") & (self.support in ROWS_ON_EITHER)

    def regressor(
        self, joint_angles: np.ndarray, support: np.ndarray | None = None, rotations: np.ndarray | None = None
    ) -> np.ndarray:
        """Compute the base regressor R_b(q) of x_CoM and y_CoM (eq. 6), (m, 2, p) [-].

        In a row on the swing foot alone the CoM is R_L' (sum_f R_f beta_f - p_L) in that foot's frame: the
        same parameters with rotations seen from there. R_L' p_L, the stance sole's place with the other sign,
        is no part of the regressor; see `Nominal.center_of_mass`.

        Args:
            joint_angles: (m, n_joints) [rad].
            support: of every row, (m,) of text; None: no row stands on the swing foot alone.
            rotations: of `rotations` at these angles; computed if None.
        """
        if rotations is None:
            rotations = self.rotations(joint_angles, support)
        frames, axes = np.divmod(self.columns, 3)
        return rotations[:, frames, :2, axes].transpose(1, 2, 0) @ self.combination

    def slope(
        self, joint_angles: np.ndarray, support: np.ndarray | None = None, rotations: np.ndarray | None = None
    ) -> np.ndarray:
        """Compute the derivative of the base regressor by every joint angle, (m, 2, n_joints, p) [1/rad].

        The derivative of a rotated vector is the cross product of the joint's axis and that vector. Arguments
        are those of `regressor`.
        """
        axes, vectors, moved = self._turning(joint_angles, support, rotations)
        turned = np.cross(axes[:, :, None], vectors.mT[:, None])[..., :2] * moved[..., None]  # (m, n, k, 2)
        return np.moveaxis(turned, 3, 1) @ self.combination

    def slope_along(
        self,
        theta: np.ndarray,
        joint_angles: np.ndarray,
        support: np.ndarray | None = None,
        rotations: np.ndarray | None = None,
    ) -> np.ndarray:
        """Differentiate the regressor times theta, (p,) [m], by the angles, (m, 2, n_joints) [m/rad]."""
        axes, vectors, moved = self._turning(joint_angles, support, rotations)
        beyond = (vectors * (self.combination @ theta)) @ moved.mT.astype(float)  # (m, 3, n)
        return np.cross(axes, beyond.mT)[..., :2].mT

    def _turning(
        self, joint_angles: np.ndarray, support: np.ndarray | None, rotations: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return axes of the joints, axes of the frames that parameters combine, which joint turns which.

        Their shapes are (m, n_joints, 3), (m, 3, k) and (m, n_joints, k), see `moved`.
        """
        if rotations is None:
            rotations = self.rotations(joint_angles, support)
        frames, axes = np.divmod(self.columns, 3)
        vectors = rotations[:, frames, :, axes].transpose(1, 2, 0)
        return joint_axes(self.tree, self.base, rotations), vectors, self.moved(support)[..., frames]

    def moved(self, support: np.ndarray | None = None) -> np.ndarray:
        """Return how each joint turns the frames as seen from the base, (m, n_joints, n_frames).

        1: it turns with the joint, 0: it rests; -1: the joint turns the base, the swing foot, instead. m is 1
        if no row stands on the swing foot alone.
        """
        moved = moved_frames(self.tree, self.base)[None]
        if support is None or not (there := self.on_swing_foot(support)).any():
            return moved
        return moved - 1.0 * (there[:, None, None] & moved[:, :, [self.swing]])

    def members(self, index: int) -> list[int]:
        """List the frames whose columns the index-th parameter combines, in MJCF order."""
        return sorted({int(c) // 3 for c in np.flatnonzero(np.abs(self.from_frames[index]) > 1e-9)})

    def terms(self, index: int) -> list[tuple[float, str, str]]:
        """List the standard parameters in the index-th parameter times M: weight [1 or m], quantity, link."""
        return [
            (float(weight), quantity, name)
            for link, name in enumerate(self.tree.links)
            for k, quantity in enumerate(("m", "mx", "my", "mz"))
            if abs(weight := self.from_standard[index, 4 * link + k]) > 1e-12
        ]

    def grouping(self, index: int) -> str:
        """Return M times the index-th parameter as a sum of standard parameters with lengths [m]."""
        text = ""
        for weight, quantity, name in self.terms(index):
            factor = "" if abs(abs(weight) - 1) < 1e-12 else f"{abs(weight):.6g} "
            text += f" {'-' if weight < 0 else '+'} {factor}{quantity}[{name}]"
        return text.removeprefix(" ").removeprefix("+ ")

    def values(self, standard: np.ndarray) -> np.ndarray:
        """Compute base parameters, (p,) [m], from standard parameters (eq. 5), (n_links, 4) [kg, kg m]."""
        return self.from_standard @ standard.ravel() / standard[:, 0].sum()


def standard_parameters(model: mujoco.MjModel) -> np.ndarray:
    """Return the standard parameters of every link in MJCF order (eq. 5), (n_links, 4) [kg, kg m]."""
    mass = model.body_mass[1:]
    return np.column_stack([mass, mass[:, None] * model.body_ipos[1:]])


def common_support(support: np.ndarray) -> str:
    """Return the support whose base parameters suit all of these postures, (m,) of text.

    A foot's z has no effect while the foot is flat but has one where it is lifted: TULip has 25 parameters in
    double support, 26 if the left foot is lifted in some rows, 27 if each foot is lifted in some. All of them
    include the 25.
    """
    if (support == "left").any():
        return "mixed" if (support == "right").any() else "double-left"
    return "right" if (support == "right").any() else "double"


def renumbered(robot: Robot, parameters: BaseParameters, numbers: list[int]) -> list[int]:
    """Convert parameter numbers of the double-support set, as in a robot's description, to this set."""
    if parameters.support == "double":
        return numbers
    names = base_parameters(robot).names
    return [parameters.names.index(names[number - 1]) + 1 for number in numbers]


def simplified_numbers(robot: Robot, parameters: BaseParameters) -> list[int]:
    """List the numbers of the robot's simplified model; all, if its description has none.

    Parameters that only single support makes identifiable are kept: the description lists double support.
    """
    everything = list(range(1, len(parameters.names) + 1))
    if "simplified" not in robot.settings:
        return everything
    if parameters.support == "double":
        return sorted(robot.settings["simplified"])
    kept = renumbered(robot, parameters, robot.settings["simplified"])
    known = renumbered(robot, parameters, list(range(1, len(base_parameters(robot).names) + 1)))
    return sorted({*kept, *(set(everything) - set(known))})


def base_parameters(
    robot: Robot, model: mujoco.MjModel | None = None, support: str = "double"
) -> BaseParameters:
    """Derive the base parameters structurally, without joint angles.

    Args:
        model: the robot alone, which gives the lengths; None means the nominal model.
        support: which feet carry the robot, one of `SUPPORTS`.
    """
    if support not in SUPPORTS:
        raise InputError(f"support: found '{support}', expected one of {', '.join(SUPPORTS)}")
    if model is None:
        return _nominal_base_parameters(robot, support)
    stance, swing = robot.feet if support != "left" else robot.feet[::-1]
    flat = {"double": [stance, swing], "mixed": [], "double-left": [swing]}.get(support, [stance])
    tree = tree_of(model)
    z_down = tuple(robot.settings.get("z_down", ()))
    return _derive(tree, (stance, swing), flat, sole_point(model, stance), z_down, support)


@lru_cache(maxsize=32)
def _nominal_base_parameters(robot: Robot, support: str) -> BaseParameters:
    return base_parameters(robot, robot.model, support)


def _derive(
    tree: Tree,
    feet: tuple[str, str],
    flat: list[str],
    base_point: np.ndarray,
    z_down: tuple[str, ...],
    support: str,
) -> BaseParameters:
    (base, swing), size = map(tree.frame, feet), 3 * len(tree.frames)
    hinges = _hinge_relations(tree)
    vertical = np.zeros((len(flat), size))
    for row, foot in enumerate(flat):
        vertical[row, 3 * tree.frame(foot) + 2] = 1.0
    relations, eliminated = _eliminate(np.vstack([hinges, vertical]))
    kept = [c for c in range(size) if c not in eliminated]
    from_frames = np.eye(size)[kept]
    from_frames[:, eliminated] -= relations[:, kept].T
    from_standard = from_frames @ _frame_matrix(tree, base, base_point)
    rank_in_links = {frame: k for k, frame in enumerate(tree.frame_of_link)}
    order = sorted(
        range(len(kept)), key=lambda i: (kept[i] % 3, rank_in_links.get(kept[i] // 3, kept[i] // 3))
    )
    columns = np.array(kept)[order]
    down = [c % 3 == 2 and tree.frames[c // 3] in z_down for c in columns]
    signs = np.where(down, -1.0, 1.0)
    from_frames, from_standard = signs[:, None] * from_frames[order], signs[:, None] * from_standard[order]
    rows, mix = _independent_rows(from_standard)
    return BaseParameters(
        tree=tree,
        base=base,
        swing=swing,
        names=tuple(f"{tree.frames[c // 3]}.{AXES[c % 3]}" for c in columns[rows]),
        groups=tuple(_group(tree, signs[i] * from_frames[i]) for i in rows),
        columns=columns,
        combination=signs[:, None] * mix,
        from_frames=from_frames[rows],
        from_standard=from_standard[rows],
        merged_columns=size - len(hinges),  # independent: each is the first with its child's columns
        support=support,
    )


def _independent_rows(matrix: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Return the first independent rows, in order, and `mix` with matrix = mix @ matrix[rows]."""
    left, rows = matrix.copy(), []
    for i, row in enumerate(left):
        pivot = abs(row).argmax()
        if abs(row[pivot]) > 1e-9:
            rows.append(i)
            below = i + 1 + left[i + 1 :, pivot].nonzero()[0]
            left[below] -= left[below, pivot, None] / row[pivot] * row
    others = [i for i in range(len(matrix)) if i not in rows]
    mix = np.zeros((len(matrix), len(rows)))
    mix[rows] = np.eye(len(rows))
    orthogonal, triangle = np.linalg.qr(matrix[rows].T)
    mix[others] = np.transpose(solve_triangular(triangle, orthogonal.T @ matrix[others].T))
    return rows, mix


def _hinge_relations(tree: Tree) -> np.ndarray:
    """Return rows n with W(q) n = 0 for all q, W = [R_1 ... R_F], the invariants of the joints."""
    rows = []
    for edge in tree.edges:
        for axis in np.eye(3) if edge.axis is None else [edge.axis]:
            row = np.zeros(3 * len(tree.frames))
            row[3 * edge.parent : 3 * edge.parent + 3] = edge.placement @ axis
            row[3 * edge.child : 3 * edge.child + 3] = -axis
            rows.append(row)
    return np.array(rows).reshape(-1, 3 * len(tree.frames))


def _eliminate(relations: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Solve the relations for their last columns in a fixed order, without pivoting by size.

    The reduced rows, (k, size), have a one at their eliminated column each and zeros at the others'.
    """
    rows, eliminated, done = relations.copy(), [], 0
    for column in reversed(range(rows.shape[1])):
        if done == len(rows):
            break
        candidates = (abs(rows[done:, column]) > 1e-9).nonzero()[0]
        if len(candidates) == 0:
            continue
        pivot = done + candidates[0]
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        others = rows[:, column].nonzero()[0]
        others = others[others != done]
        rows[others] -= rows[others, column, None] * rows[done]
        eliminated.append(column)
        done += 1
    return rows[:done], eliminated


def _frame_matrix(tree: Tree, base: int, base_point: np.ndarray) -> np.ndarray:
    """Return the map from standard parameters to M times the frame parameters, (3 n_frames, 4 n_links)."""
    count, frames = len(tree.frames), np.array(tree.frame_of_link)
    carried = np.zeros((count, count, 3))  # [f, g]: contribution of a unit mass in frame f to beta_g
    carried[base, base] = -base_point
    for step in walk(tree, base):
        carried[step.new] = carried[step.known]
        carried[step.new, step.known] += step.anchor_known
        carried[step.new, step.new] = -step.anchor_new
    matrix = np.zeros((count, 3, len(frames), 4))
    matrix[..., 0] = carried[frames].transpose(1, 2, 0)
    for axis in range(3):
        matrix[frames, axis, np.arange(len(frames)), 1 + axis] = 1.0
    return matrix.reshape(3 * count, -1)


def _group(tree: Tree, row: np.ndarray) -> str:
    terms = []
    for column in np.flatnonzero(np.abs(row) > 1e-9):
        weight = row[column]
        factor = "" if abs(weight - 1) < 1e-9 else "-" if abs(weight + 1) < 1e-9 else f"{weight:.4g} "
        terms.append(f"{factor}{tree.frames[column // 3]}.{AXES[column % 3]}")
    return " + ".join(terms)
