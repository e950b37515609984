"""Do forces, moments, torques and energy balance? Checked in every hold, apart from MuJoCo's solver."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.dynamics.stiction import friction_rows
from tulip_testbed.sim.plates import cell_names
from tulip_testbed.sim.robot import PLATES


@dataclass(frozen=True)
class Balance:
    """What is left over where statics says zero, and the energy of a hold.

    Attributes:
        weight: sum of the cells' forces minus the robot's weight [N].
        moments: largest difference between a plate's roll or pitch moment by its four cells and by
            the wrench of the foot upon it [Nm].
        torques: largest torque or force on any of the robot's degrees of freedom that gravity,
            springs, actuators, dry friction and the plates' wrench on the feet leave over [Nm, N].
        centre: distance of the centre of pressure, by the cells where they are, from the centre of
            mass's projection [m].
        dissipated: mechanical energy lost since the release; friction can only take it away [J].
        kinetic: what is left of it in motion [J].
    """

    weight: float
    moments: float
    torques: float
    centre: float
    dissipated: float
    kinetic: float


def balance_of(stand: Stand, energy_before: float) -> Balance:
    """Close the books on a posture that is held now.

    Args:
        energy_before: `mechanical_energy` when the clamps had been released.
    """
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
    """Kinetic, potential and the servos' elastic energy at this moment [J].

    With the command at rest a servo is a spring kp (u - q) and a damper; where it saturates,
    the spring's energy grows linearly.
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
    """What is left over on each of the robot's degrees of freedom, as if it stood still, (n,) [Nm, N]."""
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
    """What joints at their limits exert, (nv,)."""
    rows = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
    exerted = np.zeros(model.nv)
    mujoco.mj_mulJacTVec(model, data, exerted, np.where(rows, data.efc_force[: data.nefc], 0.0))
    return exerted


def _moments_by_cells(stand: Stand) -> np.ndarray:
    """Moments of the tared cells about each plate's origin in the plate's axes, (2, 2) [Nm]."""
    forces = stand.cell_forces().reshape(2, 4)
    places = np.array([stand.data.site(name).xpos for name in cell_names()]).reshape(2, 4, 3)
    moments = []
    for plate, force, place in zip(PLATES, forces, places, strict=True):
        body = stand.data.body(f"{plate}_plate")
        x, y, _ = ((place - body.xpos) @ body.xmat.reshape(3, 3)).T
        moments.append([y @ force, -x @ force])
    return np.array(moments)


def _moments_by_feet(stand: Stand) -> np.ndarray:
    """The same by the whole wrench, contacts and stiction, that each plate exerts on its foot."""
    data, moments = stand.data, []
    for sole, plate in zip(stand.soles, PLATES, strict=True):
        body = data.body(f"{plate}_plate")
        torque, force = data.cfrc_ext[sole][:3], data.cfrc_ext[sole][3:]
        centre = data.subtree_com[stand.model.body_rootid[sole]]
        about_plate = torque + np.cross(centre - body.xpos, force)
        moments.append(body.xmat.reshape(3, 3).T @ about_plate)
    return np.array(moments)[:, :2]
