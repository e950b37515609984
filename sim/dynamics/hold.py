"""Move the robot to a posture, let it come to rest and hold it, in the full dynamics of MuJoCo."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.base.result import Array
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.dynamics.balance import Balance, balance_of, mechanical_energy
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.path import smooth_path, straight_path

CONTROL_PERIOD = 0.02  # s, between checks of the gates of a hold
LANDING_TIME = 0.1  # s
CLAMP_IMPEDANCE = 0.9999
AVERAGED_PERIODS = 5  # when gated
STILL_PERIODS = 10  # control periods in which no cell's force may change
STICKING_PERIODS = 500  # most control periods for dry friction to take over the load
CREATED_ENERGY = 1e-3  # J, more than contacts store; a larger gain of energy is a fault of the simulation
SERVO_PERIOD = 0.002  # s, between updates of the commanded angles while moving


@dataclass(frozen=True)
class Held:
    """A posture at rest: averages over its window, before sensor noise.

    Attributes:
        joint_angles: true joint angles, (n,) [rad].
        motor_angles: true angles of the motors over the gear ratio, (n,) [rad].
        commanded: commanded angles, (n,) [rad].
        torques: actuator torques, (n,) [Nm].
        cell_forces: true cell forces, tared, (8,) [N].
        com: centre of mass in the base frame, (2,) [m].
        drift: largest displacement of a sole corner since the robot was put down [m].
        settled_after: time from the release until the posture was accepted [s].
        balance: balance of forces, moments, torques and energy.
        wrenches: true wrenches of the wrench sensors, without zeros, (2, 6) [N, Nm]; (0, 6): no such sensors.
    """

    joint_angles: Array
    motor_angles: Array
    commanded: Array
    torques: Array
    cell_forces: Array
    com: Array
    drift: float
    settled_after: float
    balance: Balance
    wrenches: Array


def put_down(
    stand: Stand, angles: np.ndarray, support: str = "double", command: np.ndarray | None = None
) -> None:
    """Put the robot down at a posture on one foot or both and clamp its feet where they land.

    The foot of the base frame stands again where it stood first, for the plates' poses are recorded once.
    """
    stand.foot_contact = feet_in_contact(np.array([support]))[0]

    def land(pose: np.ndarray) -> np.ndarray:
        stand.reset(angles, pose)
        stand.command = angles if command is None else command
        stand.run(LANDING_TIME)
        return stand.feet()[stand.base]

    pose = stand.chain.base_pose(angles, stand.base)
    place = land(pose)
    if (first := stand.places.setdefault(stand.base, place)) is not place:
        land(_moved(pose, place, first))
    stand.mark_feet()
    clamp(stand)
    stand.run(stand.protocol.rest_time)


def _moved(pose: np.ndarray, place: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the pose of a body, (7,), of which one part was moved from a place to another one, (3,)."""
    turn, out = np.zeros(4), pose.copy()
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), float(other[2] - place[2]))
    away = pose[:3] - [*place[:2], 0.0]
    mujoco.mju_rotVecQuat(out[:3], away, turn)
    out[:2] += other[:2]
    mujoco.mju_mulQuat(out[3:], turn, pose[3:])
    return out


def move(stand: Stand, start: np.ndarray, end: np.ndarray, command: np.ndarray) -> None:
    """Move from one planned posture to the next with clamped feet, along the closed chain if both stand.

    The servos damp the joint's own speed, so the command leads by their derivative time; together that is a
    PD controller on angle and speed. The commanded angles end at `command`, which differs from `end` by
    command noise.
    """
    stand.stiction.release(stand.data)
    clamp(stand)
    duration = stand.protocol.move_time
    path_between = stand.chain.path if stand.foot_contact.all() else straight_path
    path = smooth_path(start, path_between, end, duration)
    time = np.arange(1, round(duration / SERVO_PERIOD) + 1) * SERVO_PERIOD
    part = time[:, None] / duration
    noise = (1 - part) * (stand.command - start) + part * (command - end)
    for angles in path(time) + stand.rig.controller.derivative_time * path(time, 1) + noise:
        stand.command = angles
        stand.run(SERVO_PERIOD)
    stand.command = command
    stand.run(stand.protocol.rest_time)


def hold(stand: Stand, plan: np.ndarray) -> tuple[Held | None, str]:
    """Release the clamps and hold: return the held posture, or None and the reason for dropping it.

    Once everything is calm, dry friction sticks where it can carry the load (`sim.dynamics.stiction`).
    Nothing changes after that, so that a short average equals that of the whole window.
    """
    protocol, data = stand.protocol, stand.data
    release(stand)
    before = mechanical_energy(stand)
    upright = stand.chain.base_pose(plan, stand.base)
    released = data.time
    latest = released + protocol.hold_time - protocol.window
    while True:
        if reason := _come_to_rest(stand, upright, latest):
            return None, reason
        settled_after = data.time - released
        if _stick(stand):
            break
        stand.stiction.release(data)
    if protocol.gated:
        window = AVERAGED_PERIODS * CONTROL_PERIOD
    else:
        stand.run(latest - data.time)
        window = protocol.window
    mean = _average(stand, window)
    if over := stand.stiction.overloaded(data):
        return None, f"broke loose at {over[0]}"
    if reason := stand.fault():
        return None, reason
    balance = balance_of(stand, before)
    if balance.dissipated < -CREATED_ENERGY:
        return None, "gained energy while held"
    joints = len(stand.qpos)
    held = Held(
        joint_angles=mean[:joints],
        motor_angles=mean[joints : 2 * joints],
        commanded=stand.command.copy(),
        torques=data.actuator_force[stand.servos].copy(),
        cell_forces=mean[2 * joints : 2 * joints + 8],
        com=mean[2 * joints + 8 : 2 * joints + 10],
        drift=stand.drift(),
        settled_after=settled_after,
        balance=balance,
        wrenches=mean[2 * joints + 10 :].reshape(-1, 6),
    )
    return held, ""


def _come_to_rest(stand: Stand, upright: np.ndarray, latest: float) -> str | None:
    """Wait until nothing has moved for `calm_time`; return None, or the reason for giving up."""
    protocol, data, calm = stand.protocol, stand.data, 0
    while calm < round(protocol.calm_time / CONTROL_PERIOD):
        if data.time > latest:
            return "did not settle"
        stand.run(CONTROL_PERIOD)
        if data.warning.number.any():
            return "MuJoCo warned of an unstable simulation"
        if stand.tipped(upright):
            return "tipped"
        calm = calm + 1 if stand.speed() < protocol.speed_gate else 0
    return None


def _stick(stand: Stand) -> bool:
    """Let dry friction stick; return whether it then carries the load and no cell's force changes."""
    forces = []
    for _ in range(STICKING_PERIODS):
        stand.stiction.engage(stand.data)
        stand.run(CONTROL_PERIOD)
        forces.append(stand.cell_forces())
        recent = forces[-STILL_PERIODS:]
        still = len(recent) == STILL_PERIODS and np.ptp(recent, axis=0).max() < stand.protocol.force_gate
        if still and not stand.stiction.overloaded(stand.data):
            return True
    return False


def _average(stand: Stand, window: float) -> np.ndarray:
    """Average joint and motor angles, cell forces, centre of mass and wrenches over a window."""
    states = []
    for _ in range(round(window / CONTROL_PERIOD)):
        stand.run(CONTROL_PERIOD)
        qpos = stand.data.qpos
        states.append(
            np.concatenate(
                [
                    qpos[stand.qpos],
                    qpos[stand.motors],
                    stand.cell_forces(),
                    stand.centre_of_mass(),
                    stand.wrenches().ravel(),
                ]
            )
        )
    return np.mean(states, axis=0)


def clamp(stand: Stand) -> None:
    """Clamp the feet that stand, where they were marked."""
    clamps = stand.clamps[stand.foot_contact]
    stand.data.eq_active[clamps] = 1
    stand.model.eq_solimp[clamps, :2] = CLAMP_IMPEDANCE


def release(stand: Stand) -> None:
    """Release the clamps slowly, since a sudden release would make the feet hop."""
    for impedance in np.geomspace(CLAMP_IMPEDANCE, 1e-4, round(stand.protocol.rest_time / CONTROL_PERIOD)):
        stand.model.eq_solimp[stand.clamps, :2] = impedance
        stand.run(CONTROL_PERIOD)
    stand.data.eq_active[stand.clamps] = 0
