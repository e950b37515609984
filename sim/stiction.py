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
        for above, below in self.standing:
            points, forces = _friction_forces(self.model, data, above, below)
            for body, sign in ((above, 1.0), (below, -1.0)):
                arms = points - data.xipos[body]
                data.xfrc_applied[body, :3] += sign * forces.sum(axis=0)
                data.xfrc_applied[body, 3:] += sign * np.cross(arms, forces).sum(axis=0)

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
    model: mujoco.MjModel, data: mujoco.MjData, above: int, below: int
) -> tuple[np.ndarray, np.ndarray]:
    """Points and tangential forces on the body above in its contacts with the one below, (k, 3) each."""
    bodies = model.geom_bodyid[data.contact.geom].reshape(-1, 2)
    touching = np.flatnonzero((np.sort(bodies) == sorted((above, below))).all(axis=1))
    local = np.zeros((len(touching), 6))
    for row, k in zip(local, touching, strict=True):
        mujoco.mj_contactForce(model, data, k, row)
    local[:, 0] = 0.0
    frames = data.contact.frame.reshape(-1, 3, 3)[touching]
    signs = np.where(bodies[touching, 1] == above, 1.0, -1.0)
    return data.contact.pos.reshape(-1, 3)[touching], signs[:, None] * np.einsum(
        "kij,ki->kj", frames, local[:, :3]
    )


def _friction(model: mujoco.MjModel, pair: tuple[int, int]) -> float:
    """Coefficient of sliding friction in the contact pair of two bodies."""
    for k in range(model.npair):
        geoms = model.pair_geom1[k], model.pair_geom2[k]
        if {model.geom_bodyid[geom] for geom in geoms} == set(pair):
            return float(model.pair_friction[k, 0])
    raise ValueError(f"no contact pair between bodies {pair}")
