"""Find the posture in which a robot stands: knees bent, soles level, centre of mass between them."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import scipy

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.experiments.robot_import.skeleton import Array
from tulip_testbed.sim.robot import Robot, between_feet, bodies_to_root, joint_names, joint_ranges

BENT = (0.94, 0.97, 0.985)  # heights of the root over the soles that are tried, of that with straight legs
STARTS = 6
CLOSE = 1e-4  # m, rad: largest error of a posture that stands
LIMIT = np.radians(3.0)  # distance from the joints' limits
# Weights of what is only wished for, against equations with weight one [m, rad].
STAY, CENTER = 1e-4, 3e-3
ROOM = 0.03  # of a leg's length, between links that are not neighbours
TRIES = 400  # of postures of the arms
SPREAD = 0.6  # rad, s.d. of these about the first one


@dataclass(frozen=True)
class Standing:
    """A posture that stands.

    Attributes:
        qpos: of the model, root first, (nq,).
        height: of the root's origin over the soles [m].
        spacing: of the feet's origins to the side [m].
        leg: from the hip (first hinge of a leg) to the sole, with straight legs [m].
    """

    qpos: Array
    height: float
    spacing: float
    leg: float


def standing(
    robot: Robot, soles: tuple[Array, Array], reference: dict[str, float], distances: Callable[[Array], Array]
) -> Standing:
    """Find a posture that stands.

    Args:
        robot: its root and feet have x forward, y left, z up.
        soles: middle of each sole in its foot's frame, (3,) [m].
        reference: angles near which the joints stay, by name [rad].
        distances: between p pairs of links that should not touch, by joint angles (m, n), (m, p) [m].
    """
    model = robot.model
    data, names = mujoco.MjData(model), joint_names(model)
    ids = [model.body(foot).id for foot in robot.feet]
    low, high = joint_ranges(model).T
    margin = np.minimum(LIMIT, 0.1 * (high - low))
    low, high = low + margin, high - margin
    wanted = np.clip([reference.get(name, 0.0) for name in names], low, high)
    legs = between_feet(model, robot)
    data.qpos[:], data.qpos[3] = 0.0, 1.0  # straight legs
    mujoco.mj_kinematics(model, data)
    points = [data.xpos[k] + data.xmat[k].reshape(3, 3) @ sole for k, sole in zip(ids, soles, strict=True)]
    ground, spacing = float(np.mean([point[2] for point in points])), float(points[1][1] - points[0][1])
    first, second = (list(bodies_to_root(model, foot)) for foot in ids)
    hip = int(model.body_jntadr[[body for body in first if body not in second][-1]])
    straight, leg = float(data.xpos[1, 2] - ground), float(data.xanchor[hip, 2] - ground)

    def place(x: Array) -> None:
        data.qpos[:3], data.qpos[3:7], data.qpos[7:] = [x[0], 0, x[1]], [1, 0, 0, 0], x[2:]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)

    def equations(x: Array) -> Array:
        place(x)
        out = []
        for k, side in ((0, -1), (1, 1)):
            turn = data.xmat[ids[k]].reshape(3, 3)
            point = data.xpos[ids[k]] + turn @ soles[k]
            out += [*(point - [0, side * spacing / 2, 0]), turn[2, 0], turn[2, 1], turn[1, 0]]
        return np.array(out)

    def residuals(x: Array) -> Array:
        return np.concatenate([equations(x), CENTER * data.subtree_com[1, :2], STAY * (x[2:] - wanted)])

    rng = np.random.default_rng(0)

    def solved(height: float, share: float, spread: float) -> Array:
        """Begin between the joints' zeros and the middle of their ranges: that bends knees as they go."""
        middle = np.clip((low + high) / 2, -1.0, 1.0)
        start = np.where(legs, (1 - share) * wanted + share * middle, wanted)
        start = np.clip(start + spread * rng.standard_normal(len(start)) * legs, low + 1e-6, high - 1e-6)
        bounds = (np.array([-1.0, height - 1e-9, *low]), np.array([1.0, height + 1e-9, *high]))
        first = np.array([0.0, height, *start])
        return scipy.optimize.least_squares(residuals, first, bounds=bounds, max_nfev=200).x

    best, missed = np.zeros(0), np.inf
    for bent in BENT:
        tries = [solved(bent * straight, 0.3, 0.0)]
        tries += [solved(bent * straight, rng.uniform(0.1, 0.5), 0.1 * k) for k in range(1, STARTS)]
        best = min(tries, key=lambda x: float(np.square(residuals(x)).sum()))
        if (missed := float(np.abs(equations(best)).max())) < CLOSE:
            break
    if missed > CLOSE:
        stuck = np.flatnonzero(np.minimum(best[2:] - low, high - best[2:]) < 1e-3)
        ranges = np.degrees([low - LIMIT, high + LIMIT]).T
        joints = [f"{names[k]} [{ranges[k, 0]:.0f}, {ranges[k, 1]:.0f}] deg" for k in stuck]
        limits = f"{listed(joints)} at their limits" if joints else "no joint at its limit"
        raise InputError(
            f"found no posture that stands with level soles: the best one misses by {1e3 * missed:.1f} mm "
            f"or mrad, with {limits}; expected legs that can put both feet flat on the ground with bent knees"
        )
    best = _apart(best, distances, ROOM * leg, ~legs, (low, high), rng)
    place(best)
    return Standing(data.qpos.copy(), float(best[1]), spacing, leg)


def _apart(
    x: Array,
    distances: Callable[[Array], Array],
    room: float,
    free: np.ndarray,
    limits: tuple[Array, Array],
    rng: np.random.Generator,
) -> Array:
    """Move the joints that are not between the feet until the links are apart, as little as will do.

    Pairs that they do not move, or that rough shapes never separate, have no say.

    Args:
        x: place and height of the root, then the joint angles. free: which of these may be moved.
    """
    if not free.any() or (distances(x[None, 2:]) >= room).all():
        return x
    steps = SPREAD * np.arange(TRIES + 1)[:, None] / TRIES * rng.standard_normal((TRIES + 1, free.sum()))
    tries = np.repeat(x[None], TRIES + 1, axis=0)
    tries[:, 2:][:, free] = np.clip(x[2:][free] + steps, limits[0][free], limits[1][free])
    found = np.minimum(distances(tries[:, 2:]), room)
    able = (np.ptp(found, axis=0) > 0) & (found.max(axis=0) > 0)

    def least(found: Array) -> Array:
        return np.minimum(found[:, able], room).min(axis=1, initial=room)

    best = tries[int(least(found).argmax())]  # the first of the best
    for joint in 2 + np.flatnonzero(free):
        back = best.copy()
        back[joint] = x[joint]
        now, then = least(distances(np.stack([best, back])[:, 2:]))
        best = back if then >= now else best
    return best
