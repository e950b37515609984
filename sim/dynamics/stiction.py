"""Stiction: bodies and joints at rest stick until dry friction cannot carry the load.

MuJoCo's friction rows act on velocity and are regularised: a row at rest under a load creeps at
(1 - d) / d * a / b, where d is the impedance (at most 0.9999), a the acceleration that the load would
cause and b the damping of the row. In Karnopp's model (1985) friction at rest is the force that holds the
load. So once everything is calm, the force of each row is replaced by a constant one: `qfrc_applied` in a
joint, and a pair of opposite `xfrc_applied` between a foot and its plate. The unloaded rows no longer
creep, and no constant force exceeds the available friction.
"""

import mujoco
import numpy as np

BREAKAWAY = 1.02  # static over sliding friction, assumed: a row that crept at its limit holds once it stops
LEAST = 1e-3  # share of the friction that a joint's row keeps while the joint slips at its limit

LEAST_TORSION = 1e-9  # Nm, for a single contact point


class Stiction:
    """Stiction in one scene; a class because it accumulates forces while things stick.

    Args:
        model: the scene.
        contact_pairs: pairs of bodies in contact by explicit contact pairs, upper body first, for example
            foot and plate.

    Attributes:
        torques: constant friction on every degree of freedom, (nv,) [N m, N].
        wrenches: constant force and moment on every body, (nbody, 6) [N, N m].
    """

    def __init__(self, model: mujoco.MjModel, contact_pairs: list[tuple[int, int]]):
        self.model, self.contact_pairs = model, contact_pairs
        self.frictionloss = model.dof_frictionloss.copy()
        self.capacity = BREAKAWAY * self.frictionloss
        self.friction = [BREAKAWAY * sliding_friction(model, pair) for pair in contact_pairs]
        self.torques, self.wrenches = np.zeros(model.nv), np.zeros((model.nbody, 6))

    def engage(self, data: mujoco.MjData) -> None:
        """Replace the forces of the friction rows in the last step by constant forces.

        A row can still cancel its constant force and carry its friction in the opposite direction, so that
        a joint is held when its load decreases or reverses; only the row of a joint beyond its limit is
        opened, so that the joint slips.
        """
        before = self.torques
        wanted = before + friction_rows(self.model, data)
        self.torques = np.clip(wanted, -self.capacity, self.capacity)
        data.qfrc_applied += self.torques - before
        slips = np.abs(wanted) > self.capacity
        held = self.capacity + np.abs(self.torques)
        self.model.dof_frictionloss[:] = np.where(slips, LEAST * self.capacity, held)
        for above, below in self.contact_pairs:
            points, forces, _ = _contacts(self.model, data, above, below)
            forces = forces - _normal(data, below) * (forces @ _normal(data, below))[:, None]
            for body, sign in ((above, 1.0), (below, -1.0)):
                moments = np.cross(points - data.xipos[body], forces).sum(axis=0)
                wrench = sign * np.concatenate([forces.sum(axis=0), moments])
                self.wrenches[body] += wrench
                data.xfrc_applied[body] += wrench

    def release(self, data: mujoco.MjData) -> None:
        """Remove the constant forces, so that everything can move again."""
        data.qfrc_applied -= self.torques
        data.xfrc_applied -= self.wrenches
        self.forget()

    def forget(self) -> None:
        """Clear all constant forces after the data were reset."""
        self.torques[:], self.wrenches[:] = 0.0, 0.0
        self.model.dof_frictionloss[:] = self.frictionloss

    def overloaded(self, data: mujoco.MjData) -> list[str]:
        """List the joints and bodies whose load in the last step exceeds dry friction."""
        loads = self.torques + friction_rows(self.model, data)
        over = np.flatnonzero(np.abs(loads) > self.capacity * (1 + LEAST / 2))
        names = [self.model.joint(self.model.dof_jntid[dof]).name for dof in over]
        for (above, below), friction in zip(self.contact_pairs, self.friction, strict=True):
            if self._sliding_load(data, above, below, friction) > 1:
                names.append(self.model.body(above).name)
        return names

    def _sliding_load(self, data: mujoco.MjData, above: int, below: int, friction: float) -> float:
        """Return the friction that a body needs at rest over the available one; above 1 it slides.

        The limit surface of tangential force and moment about the normal is approximated by an ellipse
        (Howe and Cutkosky, 1996), with the moment about the centre of pressure.
        """
        normal = _normal(data, below)
        points, forces, torques = _contacts(self.model, data, above, below)
        if not len(points) and not self.wrenches[above].any():
            return 0.0  # in the air
        pressure = forces @ normal
        if pressure.sum() <= 0:
            return np.inf
        centre = pressure @ points / pressure.sum()
        wrench = self.wrenches[above]
        force = forces.sum(axis=0) + wrench[:3]
        moment = np.cross(points - centre, forces).sum(axis=0) + torques.sum(axis=0)
        moment += wrench[3:] + np.cross(data.xipos[above] - centre, wrench[:3])
        along = np.linalg.norm(force - normal * (normal @ force)) / (friction * pressure.sum())
        arms = np.linalg.norm(np.cross(points - centre, normal), axis=1)
        about = normal @ moment / max(friction * pressure @ arms, LEAST_TORSION)
        return float(along**2 + about**2)


def friction_rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the forces of the rows of dry friction in the last step on every degree of freedom, (nv,)."""
    kinds, dofs = data.efc_type[: data.nefc], data.efc_id[: data.nefc]
    rows = kinds == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
    exerted = np.zeros(model.nv)
    exerted[dofs[rows]] = data.efc_force[: data.nefc][rows]
    return exerted


def _normal(data: mujoco.MjData, below: int) -> np.ndarray:
    return data.xmat[below].reshape(3, 3)[:, 2]


def _contacts(
    model: mujoco.MjModel, data: mujoco.MjData, above: int, below: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, forces and torques on the upper body in its contacts with the lower one, (k, 3) each."""
    bodies = model.geom_bodyid[data.contact.geom].reshape(-1, 2)
    touching = np.flatnonzero((np.sort(bodies) == sorted((above, below))).all(axis=1))
    local = np.zeros((len(touching), 6))
    for row, k in zip(local, touching, strict=True):
        mujoco.mj_contactForce(model, data, k, row)
    local *= np.where(bodies[touching, 1] == above, 1.0, -1.0)[:, None]
    frames = data.contact.frame.reshape(-1, 3, 3)[touching]
    forces, torques = (np.einsum("kij,ki->kj", frames, part) for part in (local[:, :3], local[:, 3:]))
    return data.contact.pos.reshape(-1, 3)[touching], forces, torques


def sliding_friction(model: mujoco.MjModel, pair: tuple[int, int]) -> float:
    for k in range(model.npair):
        geoms = model.pair_geom1[k], model.pair_geom2[k]
        if {model.geom_bodyid[geom] for geom in geoms} == set(pair):
            return float(model.pair_friction[k, 0])
    raise ValueError(f"no contact pair between bodies {pair}")
