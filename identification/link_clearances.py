"""Distances between the links of a robot that may collide, and between its links and the ground."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import mujoco
import numpy as np

from tulip_testbed.identification.kinematics import (
    frame_positions,
    joint_pivots,
    link_rotations,
    moved_frames,
)
from tulip_testbed.identification.link_shapes import GROUND, LinkShapes, link_shapes
from tulip_testbed.identification.planning_ranges import leg_length
from tulip_testbed.sim.robot import Robot, joint_names, standing

COMPOUND = 0.05  # of the leg's length: joints that lie nearer together act as one, as in a hip
REFERENCE = 0.5  # of their distance in the reference posture is enough for links that are near there
FAR = 1e3  # m


def segment_distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Compute the distances between segments (m, 2, 3) by Ericson (2005), (m,) [m].

    Digits below 1e-8 m are lost.
    """
    u, v, w = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], first[:, 0] - second[:, 0]
    uu, uv, vv, uw, vw, ww = (_dot(x, y) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w), (w, w)))
    cross, long, other = np.maximum(uu * vv - uv**2, 1e-12), np.maximum(uu, 1e-18), np.maximum(vv, 1e-18)
    s = np.minimum(np.maximum((uv * vw - other * uw) / cross, 0), 1)  # fractions of their lengths
    t = np.minimum(np.maximum((uv * s + vw) / other, 0), 1)
    s = np.minimum(np.maximum((uv * t - uw) / long, 0), 1)
    square = ww + s * (s * uu + 2 * uw - 2 * t * uv) + t * (t * vv - 2 * vw)
    return np.sqrt(np.maximum(square, 0.0))


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the inner products of vectors (m, 3), (m,), in a fifth of the time of `(x * y).sum(axis=1)`."""
    return x[:, 0] * y[:, 0] + x[:, 1] * y[:, 1] + x[:, 2] * y[:, 2]


@dataclass(frozen=True)
class LinkPairs:
    """Pairs of links that must keep a distance; p pairs of links, k pairs of shapes.

    Attributes:
        shapes: shapes of the links.
        names: names of both links of each pair, (p,); the second may be the ground.
        frames: frames of both links, (p, 2); that of the ground is the stance foot's.
        grounded: whether the second is the ground, (p,) bool.
        center, reach: ball around the shapes of each frame, (f, 3) and (f,) [m].
        between: pairs of shapes, in the order of the pairs of links, (k, 2).
        begin: first pair of shapes of each pair of links, (p + 1,).
        needed: distance that each pair must keep, (p,) [m].
    """

    shapes: LinkShapes
    names: tuple[tuple[str, str], ...]
    frames: np.ndarray
    grounded: np.ndarray
    center: np.ndarray
    reach: np.ndarray
    between: np.ndarray
    begin: np.ndarray
    needed: np.ndarray

    def take(self, chosen: np.ndarray) -> Self:
        """Return some of the pairs, (p,) bool."""
        kept = np.flatnonzero(chosen)
        parts = [self.between[self.begin[k] : self.begin[k + 1]] for k in kept]
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            frames=self.frames[kept],
            grounded=self.grounded[kept],
            between=np.concatenate([np.zeros((0, 2), int), *parts]),
            begin=np.cumsum([0, *map(len, parts)]),
            needed=self.needed[kept],
        )


@dataclass(frozen=True)
class Clearances:
    """Distances of p pairs of links in m postures; c of them are within reach.

    Attributes:
        distance: distances, negative where links penetrate each other, at most the reach, (m, p) [m].
        posture, pair: posture and pair of each distance within reach, (c,).
        points: nearest points of both links in the base frame, (c, 2, 3) [m].
        normal: direction from the first link to the second, (c, 3).
    """

    distance: np.ndarray
    posture: np.ndarray
    pair: np.ndarray
    points: np.ndarray
    normal: np.ndarray


@lru_cache(maxsize=2)
def link_pairs(robot: Robot, margin: float) -> LinkPairs:
    """Select the pairs of links that must keep a distance: all that do not overlap in the reference posture.

    It is `margin` [m], or half of the distance in the reference posture if that is less.
    """
    pairs, at_reference = unjoined_pairs(robot), _at_reference(robot)
    pairs = replace(pairs, needed=np.minimum(margin, REFERENCE * at_reference))
    return pairs.take(at_reference > 0)


def overlaps_at_reference(robot: Robot) -> dict[tuple[str, str], float]:
    """Return the overlap of the pairs that `link_pairs` leaves out for it, the deepest first [m]."""
    found = dict(zip(unjoined_pairs(robot).names, (-_at_reference(robot)).tolist(), strict=True))
    return {names: found[names] for names in sorted(found, key=lambda n: -found[n]) if found[names] >= 0}


def _at_reference(robot: Robot) -> np.ndarray:
    return clearances_at(unjoined_pairs(robot), reference_posture(robot)[None], FAR).distance[0]


@lru_cache(maxsize=2)
def unjoined_pairs(robot: Robot) -> LinkPairs:
    """List the pairs of links that should not touch.

    Links that one joint, or several at one place, connect are neighbours and may touch. So may pairs that the
    MJCF excludes. All links but the feet must stay off the ground.
    """
    shapes = link_shapes(robot)
    tree, owners = shapes.tree, {int(f): np.flatnonzero(shapes.frame[:-1] == f) for f in shapes.frame[:-1]}
    moved = moved_frames(tree, shapes.base)
    link = dict(zip(tree.frame_of_link, tree.links, strict=True))
    excluded = {frozenset((pair.bodyname1, pair.bodyname2)) for pair in robot.spec.excludes}
    adjacent = _adjacent(robot, shapes)
    found = [
        (a, b)
        for a, b in itertools.combinations(sorted(owners), 2)
        if frozenset((link[a], link[b])) not in excluded and not adjacent(moved[:, a] ^ moved[:, b])
    ]
    feet = moved[:, [tree.frame(foot) for foot in robot.feet]]
    lifted = [f for f in sorted(owners) if not (moved[:, f, None] == feet).all(axis=0).any()]
    ground = len(shapes.geoms) - 1
    parts = [np.array(list(itertools.product(owners[a], owners[b]))) for a, b in found]
    parts += [np.column_stack([owners[f], np.full(len(owners[f]), ground)]) for f in lifted]
    center, reach = _balls(shapes, owners)
    return LinkPairs(
        shapes=shapes,
        names=(*((link[a], link[b]) for a, b in found), *((link[f], GROUND) for f in lifted)),
        frames=np.array([*found, *((f, shapes.base) for f in lifted)]).reshape(-1, 2),
        grounded=np.repeat([False, True], [len(found), len(lifted)]),
        center=center,
        reach=reach,
        between=np.concatenate([np.zeros((0, 2), int), *parts]),
        begin=np.cumsum([0, *map(len, parts)]),
        needed=np.zeros(len(parts)),
    )


def moving_pairs(pairs: LinkPairs, joints: np.ndarray) -> np.ndarray:
    """Return whether some of the joints, (n,) bool, move the links of each pair against each other, (p,)."""
    moved = moved_frames(pairs.shapes.tree, pairs.shapes.base)[joints]
    return (moved[:, pairs.frames[:, 0]] != moved[:, pairs.frames[:, 1]]).any(axis=0)


def clearances_at(pairs: LinkPairs, joint_angles: np.ndarray, within: float) -> Clearances:
    """Compute distances at joint angles (m, n) [rad], see `clearances`."""
    shapes = pairs.shapes
    rotations = link_rotations(shapes.tree, shapes.base, joint_angles)
    positions = frame_positions(shapes.tree, shapes.base, rotations, shapes.origin)
    return clearances(pairs, rotations, positions, within)


def clearances(pairs: LinkPairs, rotations: np.ndarray, positions: np.ndarray, within: float) -> Clearances:
    """Compute the distances between links that are nearer than `within` [m], by MuJoCo.

    Balls around links and capsules around shapes rule out the others. The poses of all frames are in the
    base frame, (m, f, 3, 3) and (m, f, 3) [m].
    """
    shapes = pairs.shapes
    posture, pair = _near(pairs, rotations, positions, within)
    sizes = np.diff(pairs.begin)[pair]
    case = np.repeat(np.arange(len(pair)), sizes)
    inner = np.arange(len(case)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    between = pairs.between[pairs.begin[pair[case]] + inner]
    turned = rotations[:, shapes.frame]
    ends = positions[:, shapes.frame, None] + shapes.ends @ turned.mT
    first, second = (ends[posture[case], between[:, k]] for k in range(2))
    flat, (radius, other) = pairs.grounded[pair[case]], shapes.radius[between.T]
    lowest = np.minimum(first[:, 0, 2], first[:, 1, 2])
    least = np.where(flat, lowest, segment_distances(first, second) - other) - radius
    near = np.flatnonzero(least < within)
    near = near[np.lexsort((least[near], case[near]))]

    turn = (turned @ shapes.turn).reshape(*turned.shape[:2], 9)
    place = positions[:, shapes.frame] + (shapes.place[:, None] @ turned.mT)[:, :, 0]
    model, data, geoms = shapes.model, shapes.data, shapes.geoms
    witness, fromto = np.zeros((len(pair), 6)), np.zeros(6)
    best, set_up = [within] * len(pair), -1
    bounds, cases, rows = least[near].tolist(), case[near].tolist(), posture[case[near]].tolist()
    for bound, k, row, (a, b) in zip(bounds, cases, rows, geoms[between[near]].tolist(), strict=True):
        if bound >= best[k]:
            continue
        if row != set_up:
            set_up = row
            data.geom_xpos[geoms], data.geom_xmat[geoms] = place[row], turn[row]
        found = mujoco.mj_geomDistance(model, data, a, b, best[k], fromto)
        if found < best[k]:
            best[k], witness[k] = found, fromto
    best = np.array(best)
    close = best < within
    distance = np.full((len(rotations), len(pairs.names)), within)
    distance[posture, pair] = best
    points = witness[close].reshape(-1, 2, 3)
    away = points[:, 1] - points[:, 0]
    length = np.linalg.norm(away, axis=1, keepdims=True)
    normal = np.sign(best[close])[:, None] * away / np.where(length > 0, length, 1.0)
    return Clearances(distance, posture[close], pair[close], points, normal)


def _near(
    pairs: LinkPairs, rotations: np.ndarray, positions: np.ndarray, within: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return posture and pair, (c,) each, of links whose balls are nearer than `within`."""
    center = positions + (rotations @ pairs.center[..., None])[..., 0]
    one, other = pairs.frames.T
    apart = np.linalg.norm(center[:, one] - center[:, other], axis=2) - pairs.reach[other]
    near = np.where(pairs.grounded, center[:, one, 2], apart) - pairs.reach[one] < within
    posture, pair = np.nonzero(near)
    return posture, pair


def _balls(shapes: LinkShapes, owners: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and radius of a ball around the shapes of each frame, (f, 3) and (f,) [m]."""
    center, reach = np.zeros((len(shapes.tree.frames), 3)), np.zeros(len(shapes.tree.frames))
    for frame, own in owners.items():
        ends, radius = shapes.ends[own], shapes.radius[own, None]
        low, high = (ends - radius[..., None]).min(axis=(0, 1)), (ends + radius[..., None]).max(axis=(0, 1))
        center[frame] = (low + high) / 2
        reach[frame] = (np.linalg.norm(ends - center[frame], axis=2) + radius).max()
    return center, reach


def reference_posture(robot: Robot) -> np.ndarray:
    """Return the joint angles of the keyframe `stand`, or of the zero pose if there is none, (n,) [rad]."""
    model = robot.model
    return standing(model)[[model.joint(name).qposadr[0] for name in joint_names(model)]]


def _adjacent(robot: Robot, shapes: LinkShapes) -> Callable[[np.ndarray], bool]:
    """Return a function that tells whether joints, (n,) bool, act as one, or as none."""
    tree, zero = shapes.tree, np.zeros((1, len(shapes.tree.joints)))
    rotations = link_rotations(tree, shapes.base, zero)
    positions = frame_positions(tree, shapes.base, rotations, shapes.origin)
    pivots = joint_pivots(tree, shapes.base, rotations, positions)[0]
    owner = np.array([robot.model.joint(name).bodyid[0] for name in tree.joints])
    near = COMPOUND * leg_length(robot)

    def adjacent(joints: np.ndarray) -> bool:
        if len(set(owner[joints])) < 2:
            return True
        apart = pivots[joints, None] - pivots[None, joints]
        return bool(np.linalg.norm(apart, axis=2).max() <= near)

    return adjacent
