"""Do forces, moments, torques and energy balance? Checked in every hold, from what MuJoCo computed."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from sim.model import PLATES
from sim.plates import cell_names
from sim.stand import Stand


@dataclass(frozen=True)
class Books:
    """What is left over where physics says zero, and the energy of a hold.

    Attributes:
        weight: sum of the cells' forces minus the robot's weight [N].
        moments: largest difference between a plate's roll or pitch moment by its four cells and by
            the wrench of the foot upon it [Nm].
        torques: largest difference between the torques that the actuators exert and those that
            inverse dynamics (`mj_inverse`) asks for at this state [Nm].
        dissipated: mechanical energy lost since the release; friction can only take it away [J].
        kinetic: what is left of it in motion [J].
    """

    weight: float
    moments: float
    torques: float
    dissipated: float
    kinetic: float


def keep_books(stand: Stand, energy_before: float) -> Books:
    """Close the books on a posture that is held now.

    Args:
        energy_before: `mechanical_energy` when the clamps had been released.
    """
    model, data = stand.model, stand.data
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    weight = model.body_subtreemass[stand.torso] * model.opt.gravity[2]
    moments = [
        np.abs(by_cells - by_foot)
        for by_cells, by_foot in zip(_moments_by_cells(stand), _moments_by_feet(stand), strict=True)
    ]
    exerted = data.qfrc_actuator + data.qfrc_applied
    for body in np.flatnonzero(data.xfrc_applied.any(axis=1)):
        force, torque = data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:]
        mujoco.mj_applyFT(model, data, force, torque, data.xipos[body], body, exerted)
    mujoco.mj_inverse(model, data)
    mujoco.mj_energyVel(model, data)
    return Books(
        weight=float(stand.cell_forces().sum() + weight),
        moments=float(np.max(moments)),
        torques=float(np.abs(data.qfrc_inverse - exerted).max()),
        dissipated=energy_before - mechanical_energy(stand),
        kinetic=float(data.energy[1]),
    )


def mechanical_energy(stand: Stand) -> float:
    """Kinetic, potential and the servos' elastic energy at this moment [J].

    With the command at rest a servo is a spring kp (u - q) and a damper; where it saturates,
    the spring's energy grows linearly.
    """
    model, data = stand.model, stand.data
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    gains, limits = model.actuator_gainprm[stand.servos, 0], model.actuator_forcerange[stand.servos, 1]
    torque = np.abs(gains * (stand.command - data.qpos[stand.motors]))
    elastic = np.where(torque < limits, torque**2, (2 * torque - limits) * limits) / (2 * gains)
    return float(data.energy.sum() + elastic.sum())


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
