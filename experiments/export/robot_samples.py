"""Random consistent robots that the measurements allow: for control that shall hold for all of them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.identification.consistent_robot import (
    ConsistentRobot,
    Target,
    consistent_robot,
    robot_with,
)
from tulip_testbed.identification.pseudo_inertia import central, pseudo_inertia, solid
from tulip_testbed.sim.random_robots import draw_robot

SPREAD = 0.1  # assumed, of what statics cannot see: of ln mass, of centres in half edges, of ln lengths
TRIES = 20


def robot_samples(
    model: mujoco.MjModel,
    cad: np.ndarray,
    ellipsoids: np.ndarray,
    target: Target,
    mass_error: float,
    count: int,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """Draw consistent robots.

    Base parameters and total mass are normal with the target's covariance. The other parameters are drawn
    about CAD with the spread of `draw_robot`, and the lengths of the inertia boxes with it too; the sample is
    the consistent robot with the drawn base parameters that is nearest to the drawn CAD. Draws that no
    consistent robot has are drawn again; after `TRIES` the nearest one is taken.

    Args:
        model: the robot with CAD's masses. cad: its pseudo-inertias, (n_links, 4, 4).
        ellipsoids: of `bounding_ellipsoids`.
        mass_error: standard error of the total mass [kg]. count: of robots, s.

    Returns:
        mass, (s, n_links) [kg], center_of_mass, (s, n_links, 3) [m], inertia about it, (s, n_links, 3, 3)
        [kg m2], pseudo_inertia, (s, n_links, 4, 4), base_parameters, (s, p) [m], and
        misfit_in_standard_errors: distance to the base parameters that were drawn, (s,); 0: none.
    """
    deviation = np.sqrt(np.diag(target.covariance))
    root = np.linalg.cholesky(target.covariance / np.outer(deviation, deviation)) * deviation[:, None]

    def draw() -> tuple[np.ndarray, np.ndarray, Target]:
        value = target.value + root @ rng.standard_normal(len(root))
        mass = target.mass + mass_error * rng.standard_normal()
        reference, standard = np.zeros_like(cad), draw_robot(model, SPREAD, rng)
        for k in np.flatnonzero(cad[:, 3, 3] > 0):  # with other lengths of its inertia box
            own, _, inertia = central(cad[k])
            second = standard[k, 0] / own * (np.trace(inertia) / 2 * np.eye(3) - inertia)
            size, axes = np.linalg.eigh(second)
            second = (axes * size * np.exp(2 * SPREAD * rng.standard_normal(3))) @ axes.T
            tensor = np.trace(second) * np.eye(3) - second
            reference[k] = pseudo_inertia(standard[k, 0], standard[k, 1:] / standard[k, 0], tensor)
        return solid(reference), ellipsoids, replace(target, value=value, mass=mass)

    def consistent() -> ConsistentRobot:
        for _ in range(TRIES):
            if (robot := robot_with(*draw())) is not None:
                return robot
        return consistent_robot(*draw())

    robots = [consistent() for _ in range(count)]
    pseudo = np.array([robot.pseudo for robot in robots])
    mass = pseudo[..., 3, 3]
    center, inertia = np.zeros((*mass.shape, 3)), np.zeros((*mass.shape, 3, 3))
    for k, link in zip(*np.nonzero(mass > 0), strict=True):
        _, center[k, link], inertia[k, link] = central(pseudo[k, link])
    return {
        "mass": mass,
        "center_of_mass": center,
        "inertia": inertia,
        "pseudo_inertia": pseudo,
        "base_parameters": np.array([robot.value for robot in robots]),
        "misfit_in_standard_errors": np.array([robot.misfit for robot in robots]),
    }
