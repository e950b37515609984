"""Random robots that differ from the nominal one as a built robot differs from its design."""

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
import scipy

from tulip_testbed.base.errors import InputError


def draw_robot(model: mujoco.MjModel, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Draw the standard parameters (eq. 5) of a random robot around the nominal one, (n_links, 4) [kg, kg m].

    All links are independent, left and right ones too. A mass is log-normal with the nominal mass as mean
    and an s.d. of `spread` of ln m, 0 < spread <= 1. A centre of mass moves along the axes of the link's
    inertia box (the solid box of uniform density with the link's mass and inertia) by a normal deviate with
    an s.d. of `spread` half edges, truncated at the faces of the box. The inertia about the centre of mass is
    proportional to the mass (`edit_of`), so that every link stays physically consistent (Wensing, Kim and
    Slotine 2018): positive mass, positive principal moments, triangle inequality.
    """
    check_spread(spread)
    heavy = model.body_mass[1:] > 0
    factor, deviate = np.ones(len(heavy)), np.zeros((len(heavy), 3))
    factor[heavy] = np.exp(spread * rng.standard_normal(heavy.sum()) - spread**2 / 2)
    drawn = rng.random((heavy.sum(), 3))
    deviate[heavy] = spread * scipy.stats.truncnorm.ppf(drawn, -1 / spread, 1 / spread)
    mass = factor * model.body_mass[1:]
    place = model.body_ipos[1:] + _turned(model, deviate * half_edges(model))
    return np.column_stack([mass, mass[:, None] * place])


def check_spread(spread: float) -> None:
    if not 0 < spread <= 1:
        raise InputError(
            f"robot_spread: found {spread}, expected more than 0 and at most 1 (s.d. of the logarithm of a "
            "link's mass, and of its centre of mass in half edges of its box)"
        )


def half_edges(model: mujoco.MjModel) -> np.ndarray:
    """Return the half edges of every link's inertia box along its principal axes, (n_links, 3) [m].

    A solid box with half edges a has the moments I_x = m (a_y^2 + a_z^2) / 3. The box of a link without
    mass is a point.
    """
    mass, moment = model.body_mass[1:, None], model.body_inertia[1:]
    squares = 1.5 * (moment.sum(axis=1, keepdims=True) - 2 * moment)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.maximum(np.where(mass > 0, squares / mass, 0.0), 0.0))


def _turned(model: mujoco.MjModel, vectors: np.ndarray) -> np.ndarray:
    """Rotate vectors from the axes of the inertia boxes to the links' frames."""
    turned = np.empty_like(vectors)
    for k, quaternion in enumerate(model.body_iquat[1:]):
        mujoco.mju_rotVecQuat(turned[k], vectors[k], quaternion)
    return turned


def edit_of(model: mujoco.MjModel, standard: np.ndarray) -> Callable[[mujoco.MjSpec], None]:
    """Return the edit of a scene, for `Rig.edit`, that gives the robot these standard parameters.

    They are (n_links, 4) [kg, kg m, kg m, kg m]; the model is that of the nominal robot alone.
    """
    names = tuple(model.body(k).name for k in range(1, model.nbody))
    mass = standard[:, 0]
    has_mass = mass > 0
    place = model.body_ipos[1:].copy()
    place[has_mass] = standard[has_mass, 1:] / mass[has_mass, None]
    ratio = np.ones(len(mass))
    ratio[has_mass] = mass[has_mass] / model.body_mass[1:][has_mass]
    inertia = ratio[:, None] * model.body_inertia[1:]
    return partial(_set_links, names, mass, place, inertia, model.body_iquat[1:].copy())


def _set_links(
    names: tuple[str, ...],
    mass: np.ndarray,
    place: np.ndarray,
    inertia: np.ndarray,
    turn: np.ndarray,
    spec: mujoco.MjSpec,
) -> None:
    for k, name in enumerate(names):
        body = spec.body(name)
        body.explicitinertial = True
        body.mass, body.ipos, body.iquat, body.inertia = mass[k], place[k], turn[k], inertia[k]
        body.fullinertia = np.full(6, np.nan)
