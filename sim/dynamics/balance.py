"""Balance of forces, moments, torques and energy in every hold, independent of MuJoCo's solver."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.dynamics.stiction import friction_rows
from tulip_testbed.sim.plates import cell_names


@dataclass(frozen=True)
class Balance:
    """Residuals of the static balance of a hold, and its energy.

    Attributes:
        weight: sum of the cell forces minus the robot's weight [N].
        moments: largest difference between a plate's roll or pitch moment from its four cells and from the
            wrench of its foot [Nm].
        torques: largest residual torque or force on a degree of freedom of the robot after gravity,
            springs, actuators, dry friction and the plates' wrenches on the feet [Nm, N].
        centre: distance between the centre of pressure, from the true cell positions, and the projection
            of the centre of mass [m].
        dissipated: mechanical energy dissipated since the release; never negative without a fault of the
            simulation [J].
        kinetic: kinetic energy [J].
    """

    weight: float
    moments: float
    torques: float
    centre: float
    dissipated: float
    kinetic: float


def balance_of(stand: Stand, energy_before: float) -> Balance:
    """Compute the balance of the held posture, from `mechanical_energy` at the release of the clamps [J]."""
    model, data = stand.model, stand.data
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    moments = _moments_by_cells(stand) - _moments_by_feet(stand)
    forces = stand.cell_forces()
    places = np.array([data.site(name).xpos[:2] for name in cell_names()])
    weight = model.body_subtreemass[stand.torso] * model.opt.gravity[2]
    energy = mechanical_energy(stand)
    return Balance(
        weight=float(forces.sum() + weight),
        moments=float(np.abs(moments).max()),
        torques=float(np.abs(_static_residual(stand)).max()),
        centre=float(np.linalg.norm(forces @ places / forces.sum() - data.subtree_com[stand.torso, :2])),
        dissipated=energy_before - energy,
        kinetic=float(data.energy[1]),
    )


def mechanical_energy(stand: Stand) -> float:
    """Compute kinetic, potential and the servos' elastic energy [J].

    Under a constant command a servo is a spring kp (u - q) and a damper; in saturation the energy of the
    spring grows linearly.
    """
    model, data = stand.model, stand.data
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    gains, limits = model.actuator_gainprm[stand.servos, 0], model.actuator_forcerange[stand.servos, 1]
    torque = np.abs(gains * (stand.command - data.qpos[stand.motors]))
    elastic = np.where(torque < limits, torque**2, (2 * torque - limits) * limits) / (2 * gains)
    return float(data.energy.sum() + elastic.sum())


def _static_residual(stand: Stand) -> np.ndarray:
    """Compute the static residual on each of the robot's degrees of freedom, (n,) [Nm, N]."""
    model, data, still = stand.model, stand.data, mujoco.MjData(stand.model)
    still.qpos[:], still.ctrl[:] = data.qpos, data.ctrl
    for stage in (mujoco.mj_fwdPosition, mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation):
        stage(model, still)
    friction = stand.stiction.torques + friction_rows(model, data)
    left = still.qfrc_actuator + still.qfrc_passive + friction - still.qfrc_bias
    left += _limits(model, data)
    for sole in stand.soles:
        torque, force = data.cfrc_ext[sole][:3], data.cfrc_ext[sole][3:]
        centre = data.subtree_com[model.body_rootid[sole]]
        mujoco.mj_applyFT(model, data, force, torque, centre, sole, left)
    return left[model.body_rootid[model.dof_bodyid] == stand.torso]


def _limits(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the generalised forces of joints at their limits, (nv,)."""
    rows = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
    exerted = np.zeros(model.nv)
    mujoco.mj_mulJacTVec(model, data, exerted, np.where(rows, data.efc_force[: data.nefc], 0.0))
    return exerted


def _moments_by_cells(stand: Stand) -> np.ndarray:
    """Compute the moments of the tared cells about each plate's origin in its axes, (2, 2) [Nm]."""
    forces = stand.cell_forces().reshape(2, 4)
    places = np.array([stand.data.site(name).xpos for name in cell_names()]).reshape(2, 4, 3)
    moments = []
    for plate, force, place in zip(PLATES, forces, places, strict=True):
        body = stand.data.body(f"{plate}_plate")
        x, y, _ = ((place - body.xpos) @ body.xmat.reshape(3, 3)).T
        moments.append([y @ force, -x @ force])
    return np.array(moments)


def _moments_by_feet(stand: Stand) -> np.ndarray:
    """Compute the same moments from the wrench of contacts and stiction on each foot, (2, 2) [Nm]."""
    data, moments = stand.data, []
    for sole, plate in zip(stand.soles, PLATES, strict=True):
        body = data.body(f"{plate}_plate")
        torque, force = data.cfrc_ext[sole][:3], data.cfrc_ext[sole][3:]
        centre = data.subtree_com[stand.model.body_rootid[sole]]
        about_plate = torque + np.cross(centre - body.xpos, force)
        moments.append(body.xmat.reshape(3, 3).T @ about_plate)
    return np.array(moments)[:, :2]
