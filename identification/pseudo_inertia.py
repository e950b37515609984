"""Pseudo-inertias: mass, first and second moments of a link in one 4 x 4 matrix.

P = [[Sigma, h], [h', m]] with the second moments Sigma = integral of x x' dm about the origin of the link's
frame, h = m c and the mass m. A link is physically consistent if and only if P is positive definite
(Wensing, Kim and Slotine 2018, "Linear matrix inequalities for physically consistent inertial parameter
identification"): its mass is positive and its moments of inertia satisfy the triangle inequality.
"""

import mujoco
import numpy as np

from tulip_testbed.identification.nominal import link_boxes
from tulip_testbed.sim.robot import rotation_matrices

LEAST_PART = 0.1  # of a mass
LEAST_GYRATION = 1e-3  # m: radius that a link has at least along every axis, or it would be flat
REACH = 0.5  # of the ellipsoid that CAD's own inertia takes up at most


def pseudo_inertia(mass: float, center: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return a pseudo-inertia, (4, 4), by the inertia about the centre of mass, (3, 3) [kg m2]."""
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    point = np.append(center, 1.0)
    pseudo = mass * np.outer(point, point)
    pseudo[:3, :3] += second
    return pseudo


def pseudo_inertias(model: mujoco.MjModel) -> np.ndarray:
    """Return the pseudo-inertia of every link in MJCF order, (n_links, 4, 4)."""
    axes = rotation_matrices(model.body_iquat[1:])
    inertia = (axes * model.body_inertia[1:, None]) @ axes.mT
    bodies = zip(model.body_mass[1:].tolist(), model.body_ipos[1:], inertia, strict=True)
    return np.array([pseudo_inertia(*body) for body in bodies])


def standard_of(pseudo: np.ndarray) -> np.ndarray:
    """Return the standard parameters [m, m c_x, m c_y, m c_z], (..., 4) [kg, kg m]."""
    return pseudo[..., 3, [3, 0, 1, 2]]


def central(pseudo: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass [kg], centre (3,) [m] and inertia about the centre (3, 3) [kg m2] of one pseudo-inertia."""
    mass, first = float(pseudo[3, 3]), pseudo[:3, 3]
    center = first / mass
    second = pseudo[:3, :3] - np.outer(first, center)
    second = (second + second.T) / 2
    return mass, center, np.trace(second) * np.eye(3) - second


def moved(pseudo: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Return pseudo-inertias in another frame by a homogeneous transform from the old to it, (..., 4, 4)."""
    return transform @ pseudo @ transform.mT


def at_standard(pseudo: np.ndarray, standard: np.ndarray) -> np.ndarray:
    """Return pseudo-inertias of the same shape with other masses and centres, (n, 4, 4).

    The standard parameters are (n, 4) [kg, kg m]. A mass becomes no less than `LEAST_PART` of what it was.
    """
    heavy = np.flatnonzero(pseudo[:, 3, 3] > 0)
    part = np.maximum(standard[heavy, 0] / pseudo[heavy, 3, 3], LEAST_PART)
    shift = np.tile(np.eye(4), (len(heavy), 1, 1))
    before, wanted = pseudo[heavy, :3, 3] / pseudo[heavy, 3, 3, None], standard[heavy, 1:]
    shift[:, :3, 3] = wanted / (part * pseudo[heavy, 3, 3])[:, None] - before
    out = pseudo.copy()
    out[heavy] = part[:, None, None] * moved(pseudo[heavy], shift)
    return out


def solid(pseudo: np.ndarray) -> np.ndarray:
    """Return pseudo-inertias in which every link with mass has some extent along every axis, (n, 4, 4).

    A CAD model may hold a flat or a pointlike link, whose pseudo-inertia is singular.
    """
    found = pseudo.copy()
    for one in found:
        mass = one[3, 3]
        if mass > 0:
            center = one[:3, 3] / mass
            second = one[:3, :3] - mass * np.outer(center, center)
            size, axes = np.linalg.eigh((second + second.T) / 2)
            lack = np.maximum(mass * LEAST_GYRATION**2 - size, 0.0)
            one[:3, :3] += (axes * lack) @ axes.T
    return found


def bounding_ellipsoids(model: mujoco.MjModel, pseudo: np.ndarray) -> np.ndarray:
    """Return a matrix Q a link with tr(P Q) >= 0 for all mass inside its ellipsoid, (n_links, 4, 4).

    The ellipsoid is the smallest around the box of the link's geometry, enlarged if CAD's own inertia, in the
    pseudo-inertias, takes up more than half of the bound. Q = [[-S^-1, S^-1 c], [c' S^-1, 1 - c' S^-1 c]] for
    the ellipsoid (x - c)' S^-1 (x - c) <= 1 (Wensing, Kim and Slotine 2018).
    """
    boxes = link_boxes(model)
    found = np.zeros_like(pseudo)
    for k, (low, high) in enumerate(boxes):
        middle = (low + high) / 2
        shape = 1 / (3 * np.maximum((high - low) / 2, LEAST_GYRATION) ** 2)
        where = np.eye(4)
        where[:3, 3] = -middle
        mass = pseudo[k, 3, 3]
        taken = 0.0
        if mass > 0:
            taken = float(shape @ np.diag(moved(pseudo[k], where))[:3]) / mass
        shape = shape / max(1.0, taken / REACH)
        found[k] = where.T @ np.diag([*-shape, 1.0]) @ where
    return found
