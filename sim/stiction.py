"""Dry friction that holds: what has come to rest sticks until friction cannot carry the load.

MuJoCo's friction rows act on velocity and are regularised: a row at rest under a load creeps at
(1 - d) / d * a / b (d: impedance, at most 0.9999; a: acceleration that the load would cause; b:
damping of the row). In Karnopp's model (1985) friction at rest is whatever force holds the load.
So once everything is calm, the force that each row carries is handed over to a constant one,
`qfrc_applied` in a joint and a pair of opposite `xfrc_applied` between a foot and its plate. The
rows, left without load, creep no more, and nothing is held that friction could not hold.
"""

from __future__ import annotations

import mujoco
import numpy as np

BREAKAWAY = 1.02  # static over sliding friction, assumed: what crept at its limit holds when it stops
LEAST = 1e-3  # share of its friction that a row keeps when the constant force has the rest


class Stiction:
    """What sticks in one scene. A class because it adds up forces while things stick.

    Args:
        model: the scene.
        standing: pairs of bodies, the one above first, e.g. foot and plate; each pair touches by
            explicit contact pairs.
    """

    def __init__(self, model: mujoco.MjModel, standing: list[tuple[int, int]]):
        self.model, self.standing = model, standing
        self.capacity = BREAKAWAY * model.dof_frictionloss
        self.cone = [BREAKAWAY * _friction(model, pair) for pair in standing]

    def engage(self, data: mujoco.MjData) -> None:
        """Hand over what the friction rows carried in the last step; each keeps what is left of it."""
        kinds, dofs = data.efc_type[: data.nefc], data.efc_id[: data.nefc]
        rows = kinds == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        data.qfrc_applied[dofs[rows]] += data.efc_force[: data.nefc][rows]
        np.clip(data.qfrc_applied, -self.capacity, self.capacity, out=data.qfrc_applied)
        left = self.capacity - np.abs(data.qfrc_applied)
        self.model.dof_frictionloss[:] = np.maximum(left, LEAST * self.capacity)
        for pair in self.standing:
            above, below = pair
            for point, force in _friction_forces(self.model, data, pair):
                for body, sign in ((above, 1.0), (below, -1.0)):
                    data.xfrc_applied[body, :3] += sign * force
                    data.xfrc_applied[body, 3:] += sign * np.cross(point - data.xipos[body], force)

    def release(self, data: mujoco.MjData) -> None:
        """Let everything move again."""
        data.qfrc_applied[:] = 0.0
        data.xfrc_applied[:] = 0.0
        self.model.dof_frictionloss[:] = self.capacity / BREAKAWAY

    def overloaded(self, data: mujoco.MjData) -> list[str]:
        """Joints and bodies that need more than dry friction can carry, as of the last step."""
        model = self.model
        loads = data.qfrc_applied.copy()
        kinds, dofs = data.efc_type[: data.nefc], data.efc_id[: data.nefc]
        rows = kinds == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        loads[dofs[rows]] += data.efc_force[: data.nefc][rows]
        over = np.flatnonzero(np.abs(loads) > self.capacity * (1 + LEAST / 2))
        names = [model.joint(model.dof_jntid[dof]).name for dof in over]
        mujoco.mj_rnePostConstraint(model, data)
        for (above, below), cone in zip(self.standing, self.cone, strict=True):
            force = data.xmat[below].reshape(3, 3).T @ data.cfrc_ext[above][3:]
            if np.linalg.norm(force[:2]) > cone * force[2]:
                names.append(model.body(above).name)
        return names


def _friction_forces(
    model: mujoco.MjModel, data: mujoco.MjData, pair: tuple[int, int]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Point and tangential force on the first body of every contact of a pair, world frame."""
    found, force = [], np.zeros(6)
    for k, contact in enumerate(data.contact):
        first, second = model.geom_bodyid[contact.geom]
        if {first, second} == set(pair):
            mujoco.mj_contactForce(model, data, k, force)
            sign = 1.0 if second == pair[0] else -1.0
            along = contact.frame.reshape(3, 3)[1:].T @ force[1:3]
            found.append((contact.pos.copy(), sign * along))
    return found


def _friction(model: mujoco.MjModel, pair: tuple[int, int]) -> float:
    """Coefficient of sliding friction in the contact pair of two bodies."""
    for k in range(model.npair):
        geoms = model.pair_geom1[k], model.pair_geom2[k]
        if {model.geom_bodyid[geom] for geom in geoms} == set(pair):
            return float(model.pair_friction[k, 0])
    raise ValueError(f"no contact pair between bodies {pair}")
