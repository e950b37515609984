"""Move the robot to a posture, let it stand, hold it: the full MuJoCo dynamics."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from sim.model import CELLS, CORNERS, PLATES, compile_spec, joint_names, load_model, sole_point
from sim.path import base_pose, closed_path
from sim.plates import cell_addresses, cell_names, plate_geometry, tare
from sim.rig import Rig
from sim.scene import laboratory_scene

CONTROL_PERIOD = 0.02  # s, at which path and gate are updated
LANDING_TIME = 0.1  # s
CLAMP_IMPEDANCE = 0.9999
SERVO_UPDATES = 10  # updates of the commanded angles within a control period while moving


@dataclass(frozen=True)
class Held:
    """A posture that stood still: averages over its window, before any sensor noise.

    Attributes:
        joint_angles: true joint angles, (n,) [rad].
        commanded: commanded joint angles, (n,) [rad].
        torques: actuator torques, (n,) [Nm].
        cell_forces: true cell forces, tared, (8,) [N].
        com: centre of mass in the base frame, (2,) [m].
        drift: largest movement of a sole corner since the robot was put down [m].
        settled_after: time from release to the gate [s].
    """

    joint_angles: np.ndarray
    commanded: np.ndarray
    torques: np.ndarray
    cell_forces: np.ndarray
    com: np.ndarray
    drift: float
    settled_after: float


class Stand:
    """One placement: the robot on its two plates, as MuJoCo sees it.

    A class because MuJoCo's state is mutable and outlives a posture.
    """

    def __init__(self, rig: Rig, plate_poses: np.ndarray):
        spec = laboratory_scene(rig, plate_poses)
        self.nominal = load_model(rig.robot)
        self._add_clamps(spec, rig)
        self.protocol = rig.protocol
        self.robot = rig.robot
        self.derivative_time = rig.controller.derivative_time
        self.model = compile_spec(spec, str(rig.robot.path))
        self.data = mujoco.MjData(self.model)
        joints = joint_names(self.nominal)
        self.qpos = np.array([self.model.joint(name).qposadr[0] for name in joints])
        self.dofs = np.array([self.model.joint(name).dofadr[0] for name in joints])
        self.servos = np.array([_servo_of(self.model, name) for name in joints])
        free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
        self.free = free
        self.free_qpos = slice(self.model.jnt_qposadr[free], self.model.jnt_qposadr[free] + 7)
        self.free_dofs = slice(self.model.jnt_dofadr[free], self.model.jnt_dofadr[free] + 6)
        self.torso = self.model.jnt_bodyid[free]
        self.clamps = np.array([self.model.equality(f"{foot}_clamp").id for foot in rig.robot.feet])
        self.cells = cell_addresses(self.model)
        self.tare = tare(self.model)
        self.last_forces = np.zeros(8)
        self.sole_points = {foot: sole_point(self.nominal, foot) for foot in rig.robot.feet}
        self.sole_names = [f"{foot}_{corner}" for foot in rig.robot.feet for corner in CORNERS]
        self.top_height = plate_geometry(spec, PLATES[0]).top_height

    def put_down(self, command: np.ndarray) -> None:
        """Put the robot down at a posture and clamp its feet where they came to stand."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.qpos] = command
        self.data.qpos[self.free_qpos] = base_pose(self.nominal, self.robot, command)
        self.data.ctrl[self.servos] = command
        self._run(LANDING_TIME)
        self._mark_feet()
        self._clamp()
        self._run(self.protocol.rest_time)

    def move(self, start: np.ndarray, end: np.ndarray, command: np.ndarray) -> None:
        """Move along the closed chain from one planned posture to the next, feet clamped.

        The servos damp the joint's own speed, so the command leads by their derivative time:
        together a PD controller on angle and speed. The commanded angles arrive at `command`,
        which differs from `end` by command noise.
        """
        self._clamp()
        steps = round(self.protocol.move_time / CONTROL_PERIOD)
        path = closed_path(self.nominal, self.robot, start, end, steps)
        first, last = self.data.ctrl[self.servos] - start, command - end
        before = start
        for k, angles in enumerate(path):
            lead = self.derivative_time * (angles - before) / CONTROL_PERIOD
            for part in np.arange(1, SERVO_UPDATES + 1) / SERVO_UPDATES:
                blend = (k + part) / steps
                reference = before + part * (angles - before)
                self.data.ctrl[self.servos] = reference + lead + (1 - blend) * first + blend * last
                self._run(CONTROL_PERIOD / SERVO_UPDATES)
            before = angles
        self.data.ctrl[self.servos] = command
        self._run(self.protocol.rest_time)

    def hold(self, plan: np.ndarray) -> tuple[Held | None, str]:
        """Release the clamps and hold: the held posture, or None and why it has to be dropped."""
        protocol = self.protocol
        self._release()
        upright = base_pose(self.nominal, self.robot, plan)
        released, needed = self.data.time, round(protocol.calm_time / CONTROL_PERIOD)
        calm: list[np.ndarray] = []
        while len(calm) < needed:
            if self.data.time - released > protocol.hold_time - protocol.window:
                return None, "did not settle"
            self._run(CONTROL_PERIOD)
            if self._tipped(upright):
                return None, "tipped"
            calm = [*calm, self._state()] if self._settled() else []
        settled_after = self.data.time - released
        if not protocol.gated:
            self._run(released + protocol.hold_time - protocol.window - self.data.time)
            calm = []
            for _ in range(round(protocol.window / CONTROL_PERIOD)):
                self._run(CONTROL_PERIOD)
                calm.append(self._state())
        if reason := self._fault():
            return None, reason
        mean = np.mean(calm, axis=0)
        joints = len(self.qpos)
        held = Held(
            joint_angles=mean[:joints],
            commanded=self.data.ctrl[self.servos].copy(),
            torques=self.data.actuator_force[self.servos].copy(),
            cell_forces=mean[joints : joints + 8],
            com=mean[joints + 8 :],
            drift=self._drift(),
            settled_after=settled_after,
        )
        return held, ""

    def _state(self) -> np.ndarray:
        """What is averaged: joint angles, tared cell forces, CoM in the base frame."""
        forces = self.data.sensordata[self.cells] - self.tare
        return np.concatenate([self.data.qpos[self.qpos], forces, self._com()])

    def _run(self, duration: float) -> None:
        mujoco.mj_step(self.model, self.data, max(1, round(duration / self.model.opt.timestep)))

    def _clamp(self) -> None:
        self.data.eq_active[self.clamps] = 1
        self.model.eq_solimp[self.clamps, :2] = CLAMP_IMPEDANCE

    def _release(self) -> None:
        """Let the contacts take over slowly: a sudden release would make the feet hop."""
        steps = round(self.protocol.rest_time / CONTROL_PERIOD)
        for impedance in np.geomspace(CLAMP_IMPEDANCE, 1e-4, steps):
            self.model.eq_solimp[self.clamps, :2] = impedance
            self._run(CONTROL_PERIOD)
        self.data.eq_active[self.clamps] = 0

    def _add_clamps(self, spec: mujoco.MjSpec, rig: Rig) -> None:
        """Welds between the feet and the ground, off at first."""
        for foot in rig.robot.feet:
            spec.add_equality(
                name=f"{foot}_clamp",
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                name1="world",
                name2=foot,
                active=False,
            )

    def _mark_feet(self) -> None:
        """Mark where the feet stand; there the clamps hold them."""
        self.marked_corners = self._corners()
        for clamp, foot in zip(self.clamps, self.robot.feet, strict=True):
            body = self.data.body(foot)
            self.model.eq_data[clamp, :11] = [0, 0, 0, *body.xpos, *body.xquat, 1]

    def _feet(self) -> np.ndarray:
        """Planar poses of both feet in the world, (2, 3) [m, m, rad]."""
        poses = []
        for foot in self.robot.feet:
            body = self.data.body(foot)
            rotation = body.xmat.reshape(3, 3)
            point = body.xpos + rotation @ self.sole_points[foot]
            poses.append([point[0], point[1], np.arctan2(rotation[1, 0], rotation[0, 0])])
        return np.array(poses)

    def _com(self) -> np.ndarray:
        """Centre of mass in the base frame, from MuJoCo's own, (2,) [m]."""
        x, y, yaw = self._feet()[0]
        east = self.data.subtree_com[self.torso][:2] - [x, y]
        return np.array(
            [np.cos(yaw) * east[0] + np.sin(yaw) * east[1], np.cos(yaw) * east[1] - np.sin(yaw) * east[0]]
        )

    def plates_in_base(self) -> np.ndarray:
        """True poses of both plates in the base frame at this moment, (2, 3) [m, m, rad]."""
        x, y, yaw = self._feet()[0]
        poses = []
        for plate in PLATES:
            body = self.data.body(f"{plate}_plate")
            dx, dy = body.xpos[0] - x, body.xpos[1] - y
            rotation = body.xmat.reshape(3, 3)
            turn = np.arctan2(rotation[1, 0], rotation[0, 0]) - yaw
            poses.append([np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx, turn])
        return np.array(poses)

    def _settled(self) -> bool:
        """Everything slow, and no cell's force changing: judged by what a laboratory could see."""
        forces = self.data.sensordata[self.cells].copy()
        change, self.last_forces = np.abs(forces - self.last_forces).max(), forces
        speed = max(np.abs(self.data.qvel[self.dofs]).max(), np.abs(self.data.qvel[self.free_dofs]).max())
        return bool(speed < self.protocol.speed_gate and change < self.protocol.force_gate)

    def _tipped(self, planned: np.ndarray) -> bool:
        actual = self.data.qpos[self.free_qpos]
        difference = np.zeros(3)
        mujoco.mju_subQuat(difference, actual[3:], planned[3:])
        return bool(
            np.linalg.norm(difference[:2]) > self.protocol.tilt_limit
            or abs(actual[2] - planned[2]) > 0.2 * planned[2]
        )

    def _drift(self) -> float:
        """Largest horizontal way of any sole corner from where it was put down [m]."""
        return float(np.linalg.norm((self._corners() - self.marked_corners)[:, :2], axis=1).max())

    def _corners(self) -> np.ndarray:
        """The eight sole corners in the world, (8, 3) [m]."""
        return np.array([self.data.geom(name).xpos for name in self.sole_names])

    def _sole_gaps(self) -> np.ndarray:
        """Height of the eight sole corners over their board, (8,) [m]."""
        gaps = []
        for k, name in enumerate(self.sole_names):
            plate, corner = self.data.body(f"{PLATES[k // 4]}_plate"), self.data.geom(name)
            height = plate.xmat.reshape(3, 3)[:, 2] @ (corner.xpos - plate.xpos)
            gaps.append(height - self.top_height - self.model.geom(name).size[0])
        return np.array(gaps)

    def _cell_gaps(self) -> np.ndarray:
        """Height of the eight cells over the floor, (8,) [m]."""
        floor = self.data.geom("floor").xpos[2]
        return np.array([self.data.site(name).xpos[2] - floor for name in cell_names()])

    def _fault(self) -> str | None:
        """Why a settled posture cannot be used, or None."""
        for what, names, gaps in (
            ("lost sole corner", self.sole_names, self._sole_gaps()),
            ("lifted cell", CELLS, self._cell_gaps()),
        ):
            if gaps.max() > self.protocol.lift_limit:
                return f"{what} {names[int(gaps.argmax())]}"
        if self._drift() > self.protocol.slip_limit:
            return f"slipped {1e3 * self._drift():.2f} mm"
        return None


def _servo_of(model: mujoco.MjModel, joint: str) -> int:
    wanted = model.joint(joint).id
    return next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == wanted)
