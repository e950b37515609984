"""One placement in MuJoCo: the robot on its two plates, and the quantities read from it."""

import mujoco
import numpy as np

from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.drives import motor_joint
from tulip_testbed.sim.dynamics.stiction import Stiction
from tulip_testbed.sim.path import ClosedChain, tipped
from tulip_testbed.sim.plates import cell_addresses, cell_names, short_feet, tare
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names, sole_point
from tulip_testbed.sim.scene import laboratory_scene, nominal_plates
from tulip_testbed.sim.sensors import ANKLE, PLATE
from tulip_testbed.sim.soft_floor import gravity_on
from tulip_testbed.sim.specs import compile_spec
from tulip_testbed.sim.wrench_sensors import foot_addresses, frame_of, in_frame, mountings

HOIST_DAMPING = (200.0, 2.0)  # N s/m, N m s


class Stand:
    """The robot on its plates; a class because MuJoCo's state is mutable and outlives a posture.

    Attributes:
        rig: the laboratory.
        chain: the nominal robot alone as a closed chain.
        model, data: the scene.
        stiction: dry friction at rest.
        foot_contact: which of the two feet the robot stands on, (2,) bool.
        places: where the foot of the base frame stood when the robot was first put down, by its number, (3,)
            [m, m, rad].
    """

    def __init__(self, rig: Rig, plate_poses: np.ndarray):
        self.rig, self.robot, self.protocol = rig, rig.robot, rig.protocol
        nominal = rig.robot.model
        self.chain = ClosedChain(nominal, rig.robot)
        joints = joint_names(nominal)
        spec = laboratory_scene(rig, plate_poses)
        _add_clamps(spec, rig.robot.feet)
        soles = [spec.geom(f"{foot}_{CORNERS[0]}").parent.name for foot in rig.robot.feet]
        self.model = compile_spec(spec, str(rig.robot.path))
        self.data, self.gravity = mujoco.MjData(self.model), self.model.opt.gravity.copy()
        self.qpos = np.array([self.model.joint(name).qposadr[0] for name in joints])
        motors = [motor_joint(self.model, name) for name in joints]
        self.motors = np.array([self.model.joint(motor).qposadr[0] for motor in motors])
        driven = self.model.actuator_trnid[:, 0].tolist()
        self.servos = np.array([driven.index(self.model.joint(motor).id) for motor in motors])
        self.free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
        self.free_qpos = slice(self.model.jnt_qposadr[self.free], self.model.jnt_qposadr[self.free] + 7)
        first = self.model.jnt_dofadr[self.free]
        self.model.dof_damping[first : first + 6] += hoist_damping(rig)
        self.torso = int(self.model.jnt_bodyid[self.free])
        self.foot_contact = np.array([True, True])
        self.places: dict[int, np.ndarray] = {}
        self.clamps = np.array([self.model.equality(f"{foot}_clamp").id for foot in rig.robot.feet])
        self.cells = cell_addresses(self.model)
        self.tare = tare(self.model)
        self.sensed = _sensed(rig)
        in_ankles = rig.sensors.wrench is not None and rig.sensors.wrench.place == ANKLE
        self.wrench_channels = foot_addresses(self.model, rig.robot.feet if in_ankles else ())
        # A board with a short foot rocks: its other cells rise by no more than that.
        self.rise = np.repeat(short_feet(self.model).max(axis=1), len(CORNERS))
        self.sole_points = {foot: sole_point(nominal, foot) for foot in rig.robot.feet}
        self.sole_names = rig.robot.sole_geoms
        self.soles = [self.model.body(name).id for name in soles]
        plates = [self.model.body(f"{plate}_plate").id for plate in PLATES]
        self.boards = np.repeat(plates, len(CORNERS))  # below each corner
        self.corner_geoms = np.array([self.model.geom(name).id for name in self.sole_names])
        self.cell_sites = np.array([self.model.site(name).id for name in cell_names()])
        self.stiction = Stiction(self.model, list(zip(self.soles, plates, strict=True)))
        top = spec.geom(f"{PLATES[0]}_plate_top")
        self.top_height = float(top.pos[2] + top.size[2])

    @property
    def base(self) -> int:
        """Return the index of the foot that carries the base frame: 0, right, unless it is in the air."""
        return int(self.foot_contact.argmax())

    @property
    def command(self) -> np.ndarray:
        """Return the commanded angles, (n,) [rad]."""
        return self.data.ctrl[self.servos]

    @command.setter
    def command(self, angles: np.ndarray) -> None:
        self.data.ctrl[self.servos] = angles

    def offset(self, torques: np.ndarray) -> np.ndarray:
        """Return the command offset that makes the servos exert torques, (n,) [rad]."""
        return torques / self.model.actuator_gainprm[self.servos, 0]

    def reset(self, angles: np.ndarray, pose: np.ndarray) -> None:
        """Reset the scene with the robot at joint angles (n,) and torso pose (7,), at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.stiction.forget()
        self.data.qpos[self.motors] = angles
        self.data.qpos[self.qpos] = angles
        self.data.qpos[self.free_qpos] = pose
        self.command = angles

    def run(self, duration: float) -> None:
        """Step for `duration` [s], at least one step."""
        steps = max(1, round(duration / self.model.opt.timestep))
        if not any(self.rig.floor):
            mujoco.mj_step(self.model, self.data, steps)
            return
        for _ in range(steps):
            mujoco.mj_step(self.model, self.data)
            self.turn_floor()

    def turn_floor(self) -> None:
        """Turn the floor by the load that the cells bear now."""
        if any(self.rig.floor):
            x, y, yaw = self.feet()[self.base]
            away = self.data.site_xpos[self.cell_sites, :2] - [x, y]
            c, s = np.cos(yaw), np.sin(yaw)
            places = away @ np.array([[c, -s], [s, c]])  # in the base frame
            self.model.opt.gravity[:] = gravity_on(self.rig.floor, self.gravity, self.cell_forces(), places)

    def speed(self) -> float:
        """Return the largest speed of any degree of freedom [rad/s, m/s]."""
        return float(np.abs(self.data.qvel).max())

    def cell_forces(self) -> np.ndarray:
        """Return the true tared cell forces at this moment, (8,) [N]."""
        return self.data.sensordata[self.cells] - self.tare

    def wrenches(self) -> np.ndarray:
        """Return the true wrenches at the wrench sensors at this moment, (2, 6) or (0, 6) [N, Nm].

        Ankles have MuJoCo's sensors; below the feet it is that of all contacts and stiction on the sole.
        """
        if not self.sensed:
            return -self.data.sensordata[self.wrench_channels]
        mujoco.mj_rnePostConstraint(self.model, self.data)
        sides = []
        for sole, (name, turn, place) in zip(self.soles, self.sensed, strict=True):
            body, wrench = self.data.body(name), self.data.cfrc_ext[sole]
            rotation = body.xmat.reshape(3, 3)
            centre = self.data.subtree_com[self.model.body_rootid[sole]]
            at = body.xpos + rotation @ place - centre
            sides.append(in_frame(rotation @ turn, at, np.concatenate([wrench[3:], wrench[:3]])))
        return np.array(sides)

    def mark_feet(self) -> None:
        """Store the feet's poses, where the clamps hold them."""
        self.marked_corners = self._corners()
        for clamp, foot in zip(self.clamps, self.robot.feet, strict=True):
            body = self.data.body(foot)
            self.model.eq_data[clamp, :11] = [0, 0, 0, *body.xpos, *body.xquat, 1]

    def feet(self) -> np.ndarray:
        """Return the planar poses of both feet in the world, (2, 3) [m, m, rad]."""
        poses = []
        for foot in self.robot.feet:
            body = self.data.body(foot)
            rotation = body.xmat.reshape(3, 3)
            point = body.xpos + rotation @ self.sole_points[foot]
            poses.append([point[0], point[1], np.arctan2(rotation[1, 0], rotation[0, 0])])
        return np.array(poses)

    def centre_of_mass(self) -> np.ndarray:
        """Return MuJoCo's centre of mass in the base frame, (2,) [m]."""
        x, y, yaw = self.feet()[self.base]
        east = self.data.subtree_com[self.torso][:2] - [x, y]
        return np.array(
            [np.cos(yaw) * east[0] + np.sin(yaw) * east[1], np.cos(yaw) * east[1] - np.sin(yaw) * east[0]]
        )

    def plates_in_base(self) -> np.ndarray:
        """Return the true poses of both plates in the base frame, (2, 3) [m, m, rad]."""
        x, y, yaw = self.feet()[self.base]
        poses = []
        for plate in PLATES:
            body = self.data.body(f"{plate}_plate")
            dx, dy = body.xpos[0] - x, body.xpos[1] - y
            rotation = body.xmat.reshape(3, 3)
            turn = np.arctan2(rotation[1, 0], rotation[0, 0]) - yaw
            poses.append([np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx, turn])
        return np.array(poses)

    def tipped(self, planned: np.ndarray) -> bool:
        """Return whether the torso is far from its planned pose, (7,)."""
        return tipped(self.data.qpos[self.free_qpos], planned, self.protocol.tilt_limit)

    def drift(self) -> float:
        """Return the largest horizontal displacement of a sole corner since `mark_feet` [m]."""
        displacements = np.linalg.norm((self._corners() - self.marked_corners)[:, :2], axis=1)
        return float(displacements[np.repeat(self.foot_contact, 4)].max())

    def fault(self, slip_limit: float | None = None) -> str | None:
        """Return why a posture cannot be used, or None; the slip limit [m] is the protocol's by default."""
        limit = self.protocol.slip_limit if slip_limit is None else slip_limit
        for event, names, gaps in (
            ("lost sole corner", self.sole_names, self._sole_gaps()),
            ("lifted cell", CELLS, self._cell_gaps()),
        ):
            gaps = np.where(np.repeat(self.foot_contact, 4), gaps, 0.0)
            if gaps.max() > self.protocol.lift_limit:
                return f"{event} {names[int(gaps.argmax())]}"
        if (drift := self.drift()) > limit:
            return f"slipped {1e3 * drift:.2f} mm"
        return None

    def _corners(self) -> np.ndarray:
        """Return the eight sole corners in the world, (8, 3) [m]."""
        return self.data.geom_xpos[self.corner_geoms].copy()

    def _sole_gaps(self) -> np.ndarray:
        """Return the heights of the eight sole corners over their board, (8,) [m]."""
        upward = self.data.xmat.reshape(-1, 3, 3)[self.boards, :, 2]
        height = ((self._corners() - self.data.xpos[self.boards]) * upward).sum(axis=1)
        return height - self.top_height - self.model.geom_size[self.corner_geoms, 0]

    def _cell_gaps(self) -> np.ndarray:
        """Return the heights of the eight cells over the floor beyond those of a rocking board, (8,) [m]."""
        floor = self.data.geom("floor").xpos[2]
        return self.data.site_xpos[self.cell_sites, 2] - floor - self.rise


def hoist_damping(rig: Rig) -> np.ndarray:
    """Return the damping of the torso by a slack hoist, (6,) [N s/m, N m s]; no force at rest.

    It is zero if drives and soles are rigid. MJCF has a single damping for all six degrees of freedom.
    """
    springs = rig.drives.wind_up > 0 or rig.compliance != Compliance()
    return np.repeat(HOIST_DAMPING, 3) if springs else np.zeros(6)


def _sensed(rig: Rig) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return body, rotation and place in it of the sensors in soles or plates; empty with any others."""
    sensors = rig.sensors.wrench
    if rig.wrenches_at in ("", ANKLE):
        return []
    if sensors is None or sensors.place == PLATE:
        heights = [plate.top_height for plate in nominal_plates(rig.robot)]
        tops = zip(PLATES, heights, strict=True)
        return [(f"{plate}_plate", np.eye(3), np.array([0.0, 0.0, height])) for plate, height in tops]
    poses = zip(rig.robot.feet, mountings(sensors, rig.robot), strict=True)
    return [(foot, *frame_of(pose)) for foot, pose in poses]


def _add_clamps(spec: mujoco.MjSpec, feet: tuple[str, str]) -> None:
    """Add welds between the feet and the ground, switched off."""
    for foot in feet:
        spec.add_equality(
            name=f"{foot}_clamp",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="world",
            name2=foot,
            active=False,
        )
