"""Find the feet, their soles and the directions of a robot by its geometry."""

import re
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.experiments.robot_import.skeleton import Array, Skeleton
from tulip_testbed.measurements.cells import SIGNS

UP = np.array([0.0, 0.0, 1.0])
SOLE = 0.004  # m: points no higher above the lowest one belong to the sole
TOE = 0.015  # m: a foot whose toes have a joint of their own is not much higher than these
LEVEL = np.radians(30.0)  # a sole that is steeper at zero angles is none
ROUGH = np.radians(1.0)  # meshes are not flatter than this
STRAIGHT = np.radians(10.0)  # a frame that differs less keeps its direction about the vertical
LOPSIDED = 0.25  # of a sole's length: a foot that reaches so much farther points to the front
LEAST_SOLE, MOST_SOLE = 0.01, 1.0  # m, length and width
REFINED = 3  # times that the plane of a sole is fitted again


@dataclass(frozen=True)
class Foot:
    """A foot.

    Attributes:
        link: its number.
        axes: x forward, y left, z up out of the sole, in the world at zero angles, (3, 3), columns.
        origin: over the ankle, (3,) [m].
        corners: of the sole, in the order of `CORNERS`, in these axes from the origin, (4, 3) [m].
    """

    link: int
    axes: Array
    origin: Array
    corners: Array


@dataclass(frozen=True)
class Stance:
    """The feet on which a robot stands, and its forward direction.

    Attributes:
        feet: right and left.
        axes: of the root: x forward, y left, z up, (3, 3), columns.
        toes: hinges between a foot and its toes, which are fixed.
        turned: links whose frames are not those of the file.
    """

    feet: tuple[Foot, Foot]
    axes: Array
    toes: frozenset[str]
    turned: tuple[str, ...]


def stance_of(
    skeleton: Skeleton, names: tuple[str, str] | None = None, sole: tuple[float, ...] = ()
) -> Stance:
    """Find feet and directions.

    Args:
        names: of right and left foot, if the geometry does not tell.
        sole: reach in front of the ankle and behind it, width, height of the ankle, if it does not tell [m].
    """
    pair, toes = _pair(skeleton, names)
    ankles = [skeleton.data.xanchor[skeleton.model.joint(skeleton.hinges([link])[-1]).id] for link in pair]
    if sole:
        soles = [(_stated(ankle, sole, np.eye(3)[0]), UP) for ankle in ankles]
    else:
        soles = [_sole(skeleton, link) for link in pair]
    known = 1 if names is not None else _known_sides([skeleton.name(link).lower() for link in pair])
    forward = _forward(soles, ankles, known)
    if sole:
        soles = [(_stated(ankle, sole, forward), UP) for ankle in ankles]
    left = np.cross(UP, forward)
    if names is None and (ankles[1] - ankles[0]) @ left < 0:
        pair, soles, ankles = pair[::-1], soles[::-1], ankles[::-1]
    _, old = skeleton.pose(1)
    axes = _axes(old, UP, forward)
    turned = [] if np.allclose(axes, old, atol=1e-6) else [skeleton.name(1)]
    feet = []
    for link, (points, normal), ankle in zip(pair, soles, ankles, strict=True):
        place, old = skeleton.pose(link)
        own_axes = _axes(old, normal, forward)
        sole_points, own = (points - ankle) @ own_axes, (place - ankle) @ own_axes
        low, high = sole_points[:, :2].min(axis=0), sole_points[:, :2].max(axis=0)
        inside = bool((own[:2] > low).all() and (own[:2] < high).all())
        origin = place if inside else ankle.copy()
        feet.append(Foot(link, own_axes, origin, _corners((points - origin) @ own_axes)))
        if not inside or not np.allclose(own_axes, old, atol=1e-6):
            turned.append(skeleton.name(link))
    return Stance((feet[0], feet[1]), axes, toes, tuple(turned))


def _pair(skeleton: Skeleton, names: tuple[str, str] | None) -> tuple[list[int], frozenset[str]]:
    """Return the links of both feet and the hinges of their toes."""
    if names is not None:
        movable = [skeleton.name(link) for link in skeleton.links if skeleton.hinges([link])]
        for name in names:
            if name not in movable:
                raise InputError(f"feet: found '{name}', expected two of the links {listed(movable)}")
        if names[0] == names[1]:
            raise InputError(f"feet: found '{names[0]}' twice, expected the right and the left one")
        return [skeleton.model.body(name).id for name in names], frozenset()
    heights = np.array([np.inf, *(skeleton.lowest(link, UP) for link in skeleton.links)])
    ends = [k for k in skeleton.links if k not in skeleton.model.body_parentid]
    for end in ends:
        if not skeleton.solid(end):  # it reaches at least as low as its centre of mass
            heights[end] = skeleton.data.xipos[end, 2]
    order = [int(k) for k in np.argsort(heights) if np.isfinite(heights[k]) and k > 1]
    first = order[0]
    others = [k for k in order if k not in skeleton.path(first) and first not in skeleton.path(k)]
    if unknown := [skeleton.name(k) for k in (first, *others[:1]) if not skeleton.solid(k)]:
        raise InputError(
            f"found no geometry of the lowest links {listed(unknown)}, expected that of soles; state `feet`, "
            "the right and the left one of the ends of chains "
            f"{listed(skeleton.name(k) for k in order if k in ends)}, and `sole`"
        )
    if not others or heights[others[0]] - heights[first] > 0.1:
        raise InputError(
            f"found one lowest link, '{skeleton.name(first)}', and no other at its height; expected two "
            "feet. A body on one foot is described by hand (docs/how-to/your-robot.md)"
        )
    pair, toes = [first, others[0]], set()
    for k, foot in enumerate(pair):  # perhaps a toe: the link above is as low, and long
        above = int(skeleton.model.body_parentid[foot])
        if above in (0, 1) or heights[above] - heights[foot] > TOE or above in skeleton.path(pair[1 - k]):
            continue
        if np.ptp(_lowest_points(skeleton, above, UP)[:, :2], axis=0).max() > 4 * LEAST_SOLE:
            toes |= set(skeleton.hinges([foot]))
            pair[k] = above
    return pair, frozenset(toes)


def _lowest_points(skeleton: Skeleton, link: int, up: Array) -> Array:
    """Return the points of a link that touch a plane below it, (k, 3) [m]."""
    balls = map(skeleton.points, skeleton.solid(link))
    points = np.concatenate([p - r * up for p, r in balls])
    heights = points @ up
    return points[heights < heights.min() + SOLE]


def _sole(skeleton: Skeleton, link: int) -> tuple[Array, Array]:
    """Return the points of a sole, (k, 3) [m], and its normal, (3,), out of the ground."""
    name = skeleton.name(link)
    if not skeleton.solid(link):
        raise InputError(f"foot '{name}': found no geometry, expected a sole; state `sole`")
    normal = UP
    for _ in range(REFINED):
        points = _lowest_points(skeleton, link, normal)
        spread = points - points.mean(axis=0)
        _, size, axes = np.linalg.svd(spread, full_matrices=False)
        flat = len(points) >= 3 and size[1] > 0.1 * size[0]
        if not flat:
            break
        fitted = axes[2] * np.sign(axes[2] @ UP)
        if np.arccos(np.clip(fitted @ UP, -1, 1)) > LEVEL:
            break
        normal = UP if fitted @ UP > np.cos(ROUGH) else fitted
    points = _lowest_points(skeleton, link, normal)
    width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] if len(points) > 2 else 0.0
    if width < LEAST_SOLE / 2:
        raise InputError(
            f"foot '{name}': found {len(points)} points that touch the ground, on a line or narrower than "
            f"{1e3 * LEAST_SOLE:g} mm; expected a sole with an area"
        )
    return points, normal


def _stated(ankle: Array, sole: tuple[float, ...], forward: Array) -> Array:
    """Return the corners of a sole that is stated, (4, 3) [m] in the world."""
    front, rear, width, height = sole
    possible = np.isfinite(sole).all() and max(np.abs(sole)) <= MOST_SOLE and height >= 0
    if not possible or min(front + rear, width) < LEAST_SOLE:
        raise InputError(
            f"sole: found {listed(f'{value:g}' for value in sole)} m, expected reach in front of the ankle "
            f"and behind it (together {LEAST_SOLE:g} m or more), width and height, at most {MOST_SOLE:g} m"
        )
    corners = [[x, y, -height] for x in (front, -rear) for y in (width / 2, -width / 2)]
    return ankle + np.array(corners) @ np.array([forward, np.cross(UP, forward), UP])


def _forward(soles: list[tuple[Array, Array]], ankles: list[Array], known: int | None) -> Array:
    """Return the horizontal direction across the line of the ankles in which the soles reach farther.

    Args:
        known: 1 if the second foot is known to be the left one, -1 if the first one is, else None.
    """
    line = (ankles[1] - ankles[0]) * [1, 1, 0]
    if np.linalg.norm(line) < 1e-3:
        raise InputError("found both ankles above one another, expected feet side by side at zero angles")
    forward = np.cross(line / np.linalg.norm(line), UP)
    reach = length = 0.0
    for (points, _), ankle in zip(soles, ankles, strict=True):
        along = (points - ankle) @ forward
        reach += along.max() + along.min()
        length += np.ptp(along)
    axis = np.eye(3)[int(np.abs(forward).argmax())]
    near = axis * np.sign(axis @ forward)
    if near @ forward > np.cos(STRAIGHT):
        forward = near
    if known is not None:
        return forward * known
    if abs(reach) < LOPSIDED * length:  # feet that reach almost as far back: x is the front, as is usual
        return forward * (np.sign(forward[0]) or 1.0)
    return forward * np.sign(reach)


def _known_sides(names: list[str]) -> int | None:
    """Return 1 if the second foot is the left one by the names, -1 if the first one is, else None."""
    left, right = (
        [side in name or side[0] in re.split(r"[^a-z]+", name) for name in names]
        for side in ("left", "right")
    )
    if left == [False, True] and right[0]:
        return 1
    return -1 if left == [True, False] and right[1] else None


def _axes(old: Array, up: Array, forward: Array) -> Array:
    """Return axes with z up and x forward, the file's own direction about z if it is nearly so."""
    x = old[:, 0] - (old[:, 0] @ up) * up
    wanted = forward - (forward @ up) * up
    wanted /= np.linalg.norm(wanted)
    if np.linalg.norm(x) > 0.5 and x @ wanted / np.linalg.norm(x) > np.cos(STRAIGHT):
        wanted = x / np.linalg.norm(x)
    return np.column_stack([wanted, np.cross(up, wanted), up])


def _corners(points: Array) -> Array:
    """Return the four outermost points of a sole: front left, front right, rear right, rear left."""
    center = (points[:, :2].max(axis=0) + points[:, :2].min(axis=0)) / 2
    half = np.maximum(np.ptp(points[:, :2], axis=0) / 2, 1e-6)
    scaled = (points[:, :2] - center) / half
    chosen = [points[int((scaled @ signs).argmax()), :2] for signs in SIGNS]
    return np.column_stack([chosen, np.full(4, points[:, 2].min())])
