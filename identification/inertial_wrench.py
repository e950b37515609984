"""The wrench of the ground that the nominal robot needs to hold a posture, or to move as it was measured."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, walk
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.robot import rotation_matrices

# Gauss's rule for means over a row's window, whose weight is 15/16 (1 - u^2)^2: places u and weights.
QUADRATURE = ((-(3**-0.5), 3 / 14), (0.0, 4 / 7), (3**-0.5, 3 / 14))


def needed_wrench(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute force and moment of the ground in the base frame, (m, 6) [N, Nm].

    The base foot is flat and at rest, and the moment is about its sole point. In double support it is the sum
    of both feet. Without rates or accelerations of the joints these are zero.
    """
    return link_wrenches(nominal, measurements)[0].sum(axis=1)


def link_wrenches(nominal: Nominal, measurements: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Compute what each link needs, (m, n_links, 6) [N, Nm], and its centre of mass, (m, n_links, 3) [m].

    See `needed_wrench`.
    """
    regressor, centers = _regressor(nominal, measurements)
    return np.einsum("mlik,lk->mli", regressor, inertial_parameters(nominal.robot.model)), centers


def wrench_regressor(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute the regressor of `needed_wrench`, (m, 6, n_links, 10), for `inertial_parameters`.

    Atkeson, An and Hollerbach 1986.
    """
    return _regressor(nominal, measurements)[0].swapaxes(1, 2)


def inertial_parameters(model: mujoco.MjModel) -> np.ndarray:
    """Return mass, first moments and inertia about the origin of each link's frame, (n_links, 10).

    The order is m, m c_x, m c_y, m c_z, xx, xy, yy, xz, yz, zz [kg, kg m, kg m2]; links as in the MJCF file.
    """
    standard = standard_parameters(model)
    principal = rotation_matrices(model.body_iquat[1:])
    about_center = principal * model.body_inertia[1:, None] @ principal.mT
    return np.column_stack([standard, moved_inertia(standard, about_center)])


def moved_inertia(standard: np.ndarray, about_center: np.ndarray) -> np.ndarray:
    """Return the elements of inertias about the origin, (n, 6), of those about the centre of mass, (n, 3, 3).

    Args:
        standard: (n, 4) [kg, kg m].
    """
    mass, moment = standard[:, :1], standard[:, 1:]
    center = np.divide(moment, mass, out=np.zeros_like(moment), where=mass > 0)
    cross = _crossing(center)
    whole = about_center - mass[..., None] * cross @ cross
    return whole[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def _regressor(nominal: Nominal, measurements: Measurements) -> tuple[np.ndarray, np.ndarray]:
    m, robot = measurements, nominal.robot
    rates, accelerations = (
        np.zeros_like(m.joint_angles) if values is None else values
        for values in (m.joint_rates, m.joint_accelerations)
    )
    side, count = base_foot(m.support), len(nominal.parameters.tree.links)
    regressor, centers = np.empty((len(m), count, 6, 10)), np.empty((len(m), count, 3))
    for k, foot in enumerate((robot.stance_foot, robot.swing_foot)):
        rows = side == k
        motion = m.joint_angles[rows], rates[rows], accelerations[rows]
        regressor[rows], centers[rows] = _of_foot(nominal, foot, nominal.points[k], motion, m.gravity)
    return regressor, centers


def beyond_weight(nominal: Nominal, measurements: Measurements) -> np.ndarray:
    """Compute what motion adds by CAD: shift of the centre of pressure, vertical and horizontal force.

    The mean over a row's window is not that of the mean posture: the postures between count too.

    Returns:
        side by side, (m, 5) [m, m, N, -, -], the horizontal force over the weight; (0, 5) for a robot that is
        held.
    """
    if measurements.joint_rates is None and measurements.joint_accelerations is None:
        return np.zeros((0, 5))
    held = replace(measurements, joint_rates=None, joint_accelerations=None)
    each = [share * needed_wrench(nominal, _within(measurements, at)) for at, share in QUADRATURE]
    moving = np.sum(each, axis=0)
    still = needed_wrench(nominal, held)
    after, before = (np.column_stack([-w[:, 4], w[:, 3]]) / w[:, 2:3] for w in (moving, still))
    added = moving - still
    return np.column_stack([after - before, added[:, 2], added[:, :2] / still[:, 2:3]])


def _within(measurements: Measurements, at: float) -> Measurements:
    """Return the motion at a time in each row's window, from -1 to 1, by the means of the row."""
    m = measurements
    half = np.where(np.isfinite(m.window), m.window, 0.0)[:, None] / 2
    none = np.zeros_like(m.joint_angles)
    rates, faster = (none if v is None else v for v in (m.joint_rates, m.joint_accelerations))
    angles = m.joint_angles + half * at * rates + half**2 * (at**2 - 1 / 7) / 2 * faster
    return replace(m, joint_angles=angles, joint_rates=rates + half * at * faster)


def _of_foot(
    nominal: Nominal,
    foot: str,
    sole: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    gravity: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `wrench_regressor` and centres of mass, with the foot accelerated upward in place of gravity.

    Args:
        sole: sole point in the foot's frame, (3,) [m].
        motion: angles, rates and accelerations of the joints, (m, n_joints) each.
    """
    tree = nominal.parameters.tree
    angles, rates, accelerations = motion
    base = tree.frame(foot)
    rotations = link_rotations(tree, base, angles)
    positions = frame_positions(tree, base, rotations, -sole)
    turning, turning_faster, faster = np.zeros((3, *positions.shape))  # of every frame: w, dw/dt and dv/dt
    faster[:, base, 2] = gravity
    for step in walk(tree, base):
        known, new, edge = step.known, step.new, step.edge
        w, dw = turning[:, known], turning_faster[:, known]
        pivot = faster[:, known] + _swept(w, dw, rotations[:, known] @ step.anchor_known)
        if edge.axis is not None:
            axis = rotations[:, edge.child] @ (edge.axis if step.forward else -edge.axis)
            spin = axis * rates[:, [edge.joint]]
            dw = dw + axis * accelerations[:, [edge.joint]] + np.cross(w, spin)
            w = w + spin
        turning[:, new], turning_faster[:, new] = w, dw
        faster[:, new] = pivot - _swept(w, dw, rotations[:, new] @ step.anchor_new)
    links = np.array(tree.frame_of_link)
    turn, place, pull = rotations[:, links], positions[:, links], faster[:, links]
    w, dw = turning[:, links], turning_faster[:, links]
    out = np.zeros((*place.shape[:2], 6, 10))
    swept = _crossing(dw) + _crossing(w) @ _crossing(w)
    out[..., :3, 0] = pull
    out[..., :3, 1:4] = swept @ turn
    out[..., 3:, 0] = np.cross(place, pull)
    out[..., 3:, 1:4] = (_crossing(place) @ swept - _crossing(pull)) @ turn
    # In the link's axes I dw + w x I w is linear in the six elements of I.
    own, faster_own = (np.einsum("mlij,mli->mlj", turn, v) for v in (w, dw))
    out[..., 3:, 4:] = turn @ (_elements(faster_own) + _crossing(own) @ _elements(own))
    model = nominal.robot.model
    center = place + (turn @ model.body_ipos[1:, :, None])[..., 0]
    return out, center


def _crossing(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices of the cross product by vectors, (..., 3) -> (..., 3, 3)."""
    return np.cross(vectors[..., None, :], np.eye(3)).mT


def _elements(vectors: np.ndarray) -> np.ndarray:
    """Return I v as a linear function of I's elements xx, xy, yy, xz, yz, zz, (..., 3) -> (..., 3, 6)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    o = np.zeros_like(x)
    rows = [[x, y, o, z, o, o], [o, x, y, o, z, o], [o, o, o, x, y, z]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _swept(turning: np.ndarray, turning_faster: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the acceleration of the end of an arm that turns with a frame, (..., 3) [m/s2]."""
    return np.cross(turning_faster, arm) + np.cross(turning, np.cross(turning, arm))
