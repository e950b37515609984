"""Frames of all links from joint angles, batched, with the stance foot as base.

The kinematics are in closed form on purpose: MuJoCo generates the data and must not also explain them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, look_up


@dataclass(frozen=True)
class Edge:
    """A joint between two frames as in MJCF: child = parent * placement * turn(axis, angle).

    Attributes:
        parent, child: frame numbers.
        placement: fixed rotation, (3, 3).
        axis: hinge axis in the child's frame, (3,); None for a rigid connection.
        joint: column of the joint angle; -1 for a rigid connection.
        zero: joint angle at which `turn` is the identity [rad].
        anchor: point on the axis, in the parent's and in the child's frame, (2, 3) [m].
    """

    parent: int
    child: int
    placement: np.ndarray
    axis: np.ndarray | None
    joint: int
    zero: float
    anchor: np.ndarray


@dataclass(frozen=True)
class Tree:
    """Kinematics of a tree of hinge joints, without masses.

    Attributes:
        links: body names in MJCF order.
        frame_of_link: frame number of each link; a body with several hinges has massless frames between.
        frames: names of all frames.
        edges: one per frame but the first.
        joints: joint names, the columns of joint angles.
        joint_range: limits, (n_joints, 2) [rad].
    """

    links: tuple[str, ...]
    frame_of_link: tuple[int, ...]
    frames: tuple[str, ...]
    edges: tuple[Edge, ...]
    joints: tuple[str, ...]
    joint_range: np.ndarray

    @cached_property
    def walks(self) -> dict[int, list[Step]]:
        """Return the cache of `walk`, by base frame."""
        return {}

    @cached_property
    def turns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return Rodrigues' formula of every edge, by its child frame: constant, sine and 1 - cosine terms.

        The terms have shape (n_frames, 3, 3) each; then follow the column of the joint angle (0 if there is
        none) and the angle at zero, (n_frames,) each.
        """
        count = len(self.frames)
        terms, column, zero = np.zeros((3, count, 3, 3)), np.zeros(count, int), np.zeros(count)
        for edge in self.edges:
            terms[0, edge.child] = edge.placement
            if edge.axis is not None:
                x, y, z = edge.axis
                cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                terms[1:, edge.child] = edge.placement @ cross, edge.placement @ cross @ cross
                column[edge.child], zero[edge.child] = edge.joint, edge.zero
        return terms[0], terms[1], terms[2], column, zero

    def with_lengths(self, edges: tuple[Edge, ...]) -> Tree:
        """Return the tree with edges of other lengths, which leave its turns as they are."""
        other = replace(self, edges=edges)
        other.__dict__["turns"] = self.turns
        return other

    def frame(self, link: str) -> int:
        look_up("link", link, self.links, "kinematic tree")
        return self.frame_of_link[self.links.index(link)]


def tree_of(model: mujoco.MjModel) -> Tree:
    """Read the kinematic tree of a model that holds one robot and nothing else."""
    links, frame_of_link, frames, edges, joints, ranges = [], [], [], [], [], []
    for body in range(1, model.nbody):
        name, parent = model.body(body).name, int(model.body_parentid[body])
        links.append(name)
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        hinges = [j for j in range(first, first + count) if _is_hinge(model, j, root=parent == 0)]
        if parent == 0:
            if frame_of_link or hinges:
                raise InputError(f"body '{name}': expected one root body on a free joint")
            frame_of_link.append(len(frames))
            frames.append(name)
            continue
        placement, position = _rotation(model.body_quat[body]), model.body_pos[body]
        at = frame_of_link[parent - 1]
        for k, joint in enumerate(hinges or [-1]):
            turns = joint >= 0
            pivot = model.jnt_pos[joint] if turns else np.zeros(3)
            outer = position + placement @ pivot if k == 0 else pivot
            edges.append(
                Edge(
                    parent=at,
                    child=len(frames),
                    placement=placement if k == 0 else np.eye(3),
                    axis=model.jnt_axis[joint].copy() if turns else None,
                    joint=len(joints) if turns else -1,
                    zero=float(model.qpos0[model.jnt_qposadr[joint]]) if turns else 0.0,
                    anchor=np.array([outer, pivot]),
                )
            )
            at = len(frames)
            last = k == max(len(hinges), 1) - 1
            frames.append(name if last else f"{name}'{k + 1}")
            if turns:
                joints.append(model.joint(joint).name)
                limited = model.jnt_limited[joint]
                ranges.append(model.jnt_range[joint] if limited else [-np.inf, np.inf])
        frame_of_link.append(at)
    return Tree(
        tuple(links),
        tuple(frame_of_link),
        tuple(frames),
        tuple(edges),
        tuple(joints),
        np.array(ranges).reshape(-1, 2),
    )


@dataclass(frozen=True)
class Step:
    """A step outward from the base: from a known frame over an edge to the next frame.

    The point on the edge's axis is given in both frames, (3,) [m] each.
    """

    known: int
    new: int
    edge: Edge
    forward: bool
    anchor_known: np.ndarray
    anchor_new: np.ndarray


def walk(tree: Tree, base: int) -> list[Step]:
    """List the steps that visit every frame from the base frame, nearest first."""
    if base in tree.walks:
        return tree.walks[base]
    away: list[list[Step]] = [[] for _ in tree.frames]
    for edge in tree.edges:
        outer, inner = edge.anchor
        away[edge.parent].append(Step(edge.parent, edge.child, edge, True, outer, inner))
        away[edge.child].append(Step(edge.child, edge.parent, edge, False, inner, outer))
    steps, queue = [], [base]
    for known in queue:  # the loop appends to it
        new = [step for step in away[known] if step.new not in queue]
        steps += new
        queue += [step.new for step in new]
    tree.walks[base] = steps
    return steps


def alike_in_turns(one: Tree, other: Tree) -> bool:
    """Whether two trees of the same links differ in their lengths only."""
    return one.turns is other.turns or all(map(np.array_equal, one.turns, other.turns))


def link_rotations(tree: Tree, base: int, joint_angles: np.ndarray) -> np.ndarray:
    """Compute the rotations of all frames in the base frame at joint angles [rad], (m, n_frames, 3, 3)."""
    joint_angles = np.atleast_2d(joint_angles)
    rotations = np.empty((len(joint_angles), len(tree.frames), 3, 3))
    rotations[:, base] = np.eye(3)
    fixed, by_sine, by_cosine, column, zero = tree.turns
    angle = (joint_angles[:, column] - zero)[..., None, None] if len(tree.joints) else np.zeros((1, 1, 1, 1))
    turns = fixed + np.sin(angle) * by_sine + (1 - np.cos(angle)) * by_cosine
    for step in walk(tree, base):
        turn = turns[:, step.edge.child]
        rotations[:, step.new] = rotations[:, step.known] @ (turn if step.forward else turn.mT)
    return rotations


def seen_from(frame: int, rotations: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the rotations, (m, n_frames, 3, 3), as seen from another frame in some rows, (m,) bool."""
    if not rows.any():
        return rotations
    out = rotations.copy()
    out[rows] = rotations[rows, None, frame].mT @ rotations[rows]
    return out


def joint_axes(tree: Tree, base: int, rotations: np.ndarray) -> np.ndarray:
    """Return the axes about which joints turn everything beyond them, in the base frame, (m, n_joints, 3).

    An axis is reversed where the walk from the base goes against the direction of the tree.
    """
    axes = np.zeros((len(rotations), len(tree.joints), 3))
    for step in walk(tree, base):
        if step.edge.axis is not None:
            axis = step.edge.axis if step.forward else -step.edge.axis
            axes[:, step.edge.joint] = rotations[:, step.edge.child] @ axis
    return axes


def joint_pivots(tree: Tree, base: int, rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return a point on the axis of each joint in the base frame, (m, n_joints, 3) [m]."""
    pivots = np.zeros((len(rotations), len(tree.joints), 3))
    for step in walk(tree, base):
        if step.edge.joint >= 0:
            turned = (rotations[:, step.new] @ step.anchor_new[:, None])[..., 0]
            pivots[:, step.edge.joint] = positions[:, step.new] + turned
    return pivots


def moved_frames(tree: Tree, base: int) -> np.ndarray:
    """Return which frames each joint moves relative to the base, (n_joints, n_frames) bool."""
    moved = np.zeros((len(tree.joints), len(tree.frames)), dtype=bool)
    for step in walk(tree, base):
        moved[:, step.new] = moved[:, step.known]
        if step.edge.joint >= 0:
            moved[step.edge.joint, step.new] = True
    return moved


def frame_positions(tree: Tree, base: int, rotations: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Compute the origins of all frames in the base frame, (m, n_frames, 3) [m].

    The base link's own origin is there at `origin`, (3,) [m].
    """
    steps = walk(tree, base)
    before, after = ([step.known for step in steps], [step.new for step in steps])
    ends = np.array([[step.anchor_known, step.anchor_new] for step in steps]).reshape(-1, 2, 3)
    way = np.einsum("msij,sj->msi", rotations[:, before], ends[:, 0])
    way -= np.einsum("msij,sj->msi", rotations[:, after], ends[:, 1])
    positions = np.empty(rotations.shape[:3])
    positions[:, base] = origin
    for k, (known, new) in enumerate(zip(before, after, strict=True)):
        positions[:, new] = positions[:, known] + way[:, k]
    return positions


def frame_shifts(tree: Tree, like: Tree, base: int, rotations: np.ndarray) -> np.ndarray:
    """Compute how far the origins of all frames lie from where other lengths have them, (m, n_frames, 3) [m].

    The tree `like` has these lengths and the same rotations, see `link_rotations`.
    """
    shift = np.zeros(rotations.shape[:3])
    for step, other in zip(walk(tree, base), walk(like, base), strict=True):
        shift[:, step.new] = shift[:, step.known]
        if step.edge is not other.edge:
            shift[:, step.new] += rotations[:, step.known] @ (step.anchor_known - other.anchor_known)
            shift[:, step.new] -= rotations[:, step.new] @ (step.anchor_new - other.anchor_new)
    return shift


def roll_pitch_yaw(rotations: np.ndarray) -> np.ndarray:
    """Return the angles about x, y and z, in this order, of rotations (m, 3, 3), (m, 3) [rad]."""
    return np.column_stack(
        [
            np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2]),
            -np.arcsin(np.clip(rotations[:, 2, 0], -1.0, 1.0)),
            np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]),
        ]
    )


def turned_about(angles: np.ndarray) -> np.ndarray:
    """Return the rotation by roll, pitch and yaw about fixed axes, (3,) [rad] -> (3, 3)."""
    (a, b, c), (d, e, f) = np.cos(angles), np.sin(angles)
    roll = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    pitch = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    yaw = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return yaw @ pitch @ roll


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _is_hinge(model: mujoco.MjModel, joint: int, root: bool) -> bool:
    kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        return True
    if kind == mujoco.mjtJoint.mjJNT_FREE and root:
        return False
    raise InputError(
        f"joint '{model.joint(joint).name}': found type {kind.name.removeprefix('mjJNT_').lower()}, "
        "expected hinge (free at the root only)"
    )
