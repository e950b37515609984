"""Answers of Pinocchio and FIGAROH about three robots, for tests/test_base_parameters.py (`make oracle`).

Two supports each. "right": the left foot is free, any joint angles will do. "double": both soles
stand level, so the angles are planned postures. Per support: Pinocchio's centre of mass and its
static regressor in the base frame (under the stance foot), per link of the MJCF file; and from the
x and y rows of all postures FIGAROH's rank and mapping from standard to base parameters. Of robots that
move with the right foot at rest: Pinocchio's regressor of joint torques, its root rows alone.

Of this project only the robots' files, the planned angles and the height of the sole go in.
"""

import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_reduced, get_index_eliminate

from tests.foreign_robots import ROBOTS, write_robot
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.sim.robot import Robot, joint_names, load_robot, sole_point
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.shipped import TULIP

FOLDER = Path(__file__).resolve().parent / "data" / "oracle"
SEED = 300
POSTURES = 100
KEPT = 8  # of them, for the comparison posture by posture
TOLERANCE = 1e-8  # FIGAROH's default, on a column's residual


class Oracle:
    """One robot in Pinocchio, read from its MJCF file."""

    def __init__(self, robot: Robot, model: mujoco.MjModel):
        self.pin = pin.buildModelFromMJCF(str(robot.model_file))
        self.data = self.pin.createData()
        self.mass = sum(inertia.mass for inertia in self.pin.inertias)
        if abs(self.mass - model.body_mass.sum()) > 1e-9:
            raise SystemExit(
                f"{robot.model_file}: Pinocchio read {self.mass} kg of {model.body_mass.sum()} kg"
            )
        self.links = [model.body(i).name for i in range(1, model.nbody)]
        self.frames = [self.pin.getFrameId(link, pin.FrameType.BODY) for link in self.links]
        self.columns = self._columns(model)
        self.stance, self.swing = (self.pin.getFrameId(foot, pin.FrameType.BODY) for foot in robot.feet)
        self.sole = sole_point(model, robot.stance_foot)

    def _columns(self, model: mujoco.MjModel) -> list[int]:
        """Where each of the project's joint angles stands in Pinocchio's configuration."""
        columns, used = [], dict.fromkeys(range(self.pin.njoints), 0)
        for name in joint_names(model):
            body = int(model.joint(name).bodyid[0])
            joint = self.pin.frames[self.frames[body - 1]].parentJoint
            columns.append(self.pin.idx_qs[joint] + used[joint])
            used[joint] += 1
        return columns

    def _configuration(self, angles: np.ndarray) -> np.ndarray:
        q = pin.neutral(self.pin)
        q[self.columns] = angles
        return q

    def level(self, angles: np.ndarray) -> np.ndarray:
        """The nearest angles whose soles are parallel to rounding; those of a plan are to 1e-9."""
        angles = angles.copy()
        speeds = np.array(self.columns) - 1  # the free-flyer has one speed less
        for _ in range(3):
            pin.computeJointJacobians(self.pin, self.data, self._configuration(angles))
            pin.updateFramePlacements(self.pin, self.data)
            turns = [
                pin.getFrameJacobian(self.pin, self.data, foot, pin.LOCAL_WORLD_ALIGNED)[3:, speeds]
                for foot in (self.swing, self.stance)
            ]
            stance = self.data.oMf[self.stance].rotation
            up = stance.T @ self.data.oMf[self.swing].rotation[:, 2]
            turn = stance.T @ (turns[0] - turns[1])
            angles -= np.linalg.lstsq(np.array([turn[1], -turn[0]]), up[:2], rcond=None)[0]
        return angles

    def com_and_regressor(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """CoM in the base frame (3,) [m], and its derivative by every link's standard parameters, total
        mass held fixed, (3, 4 n_links)."""
        q = self._configuration(angles)
        pin.framesForwardKinematics(self.pin, self.data, q)
        foot = self.data.oMf[self.stance]
        com = foot.rotation.T @ (pin.centerOfMass(self.pin, self.data, q) - foot.translation) - self.sole
        of_joints = pin.computeStaticRegressor(self.pin, self.data, q)
        blocks = []
        for frame in (self.pin.frames[i] for i in self.frames):
            into_joint = np.eye(4)  # a link's parameters, observed from the frame of the joint that moves it
            into_joint[1:, 0], into_joint[1:, 1:] = frame.placement.translation, frame.placement.rotation
            first = 4 * (frame.parentJoint - 1)
            block = foot.rotation.T @ of_joints[:, first : first + 4] @ into_joint
            block[:, 0] -= (foot.rotation.T @ foot.translation + self.sole) / self.mass
            blocks.append(block)
        return com, np.hstack(blocks)

    def root_rows(self, angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
        """Wrench of the ground about the sole in the stance foot's axes by ten parameters a link, (6, 10 n).

        The root lies and moves so that the foot rests on level ground.
        """
        q, v, a = self._configuration(angles), np.zeros(self.pin.nv), np.zeros(self.pin.nv)
        pin.framesForwardKinematics(self.pin, self.data, q)
        q[3:7] = pin.Quaternion(self.data.oMf[self.stance].rotation.T).coeffs()
        speeds = np.array(self.columns) - 1
        v[speeds], a[speeds] = rates, accelerations
        pin.forwardKinematics(self.pin, self.data, q, v, 0 * v)
        jacobian = pin.computeFrameJacobian(self.pin, self.data, q, self.stance, pin.LOCAL)
        v[:6] = -np.linalg.solve(jacobian[:, :6], jacobian @ v)
        pin.forwardKinematics(self.pin, self.data, q, v, a)
        drift = pin.getFrameAcceleration(self.pin, self.data, self.stance, pin.LOCAL).vector
        a[:6] = -np.linalg.solve(jacobian[:, :6], drift)
        of_joints = pin.computeJointTorqueRegressor(self.pin, self.data, q, v, a)[:6]
        pin.framesForwardKinematics(self.pin, self.data, q)
        root, foot = self.data.oMi[1], self.data.oMf[self.stance]
        into_foot = (pin.SE3(foot.rotation, foot.act(self.sole)).inverse() * root).toDualActionMatrix()
        blocks = []
        for frame in (self.pin.frames[i] for i in self.frames):
            first = 10 * (frame.parentJoint - 1)
            place = frame.placement.homogeneous
            into_joint = np.column_stack([_parameters(place @ _pseudo(e) @ place.T) for e in np.eye(10)])
            blocks.append(into_foot @ of_joints[:, first : first + 10] @ into_joint)
        return np.hstack(blocks)

    def figaroh(self, stacked: np.ndarray) -> np.ndarray:
        """FIGAROH's mapping from all standard parameters to base parameters, (rank, 4 n_links)."""
        names = [f"{link}.{quantity}" for link in self.links for quantity in ("m", "mx", "my", "mz")]
        unseen, observed = get_index_eliminate(stacked, dict.fromkeys(names, 0.0), TOLERANCE**2)
        found = QRDecomposer(tolerance=TOLERANCE).decompose(
            build_regressor_reduced(stacked, unseen), observed
        )
        return QRDecomposer.expand_mapping_matrix_to_full(found.M, observed, names)


def _pseudo(parameters: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (Wensing, Kim and Slotine 2018), (4, 4), which a change of frames T turns to T J T'."""
    mass, moment = parameters[0], parameters[1:4]
    xx, xy, yy, xz, yz, zz = parameters[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    return np.block([[second, moment[:, None]], [moment, mass]])


def _parameters(pseudo: np.ndarray) -> np.ndarray:
    """The ten parameters of a pseudo-inertia, (10,)."""
    inertia = np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3]
    return np.concatenate([[pseudo[3, 3]], pseudo[:3, 3], inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def answers(robot: Robot) -> dict[str, Any]:
    """Everything that the tests compare with, for one robot."""
    model = robot.model
    oracle = Oracle(robot, model)
    low, high = np.array([model.joint(name).range for name in joint_names(model)]).T
    plan = random_postures(robot, nominal_plates(robot)[0], POSTURES // 5, 5, SEED)
    postures = {
        "right": np.random.default_rng(SEED).uniform(low, high, (POSTURES, len(low))),
        "double": np.array([oracle.level(angles) for angles in plan.joint_angles]),
    }
    found: dict[str, Any] = {"links": np.array(oracle.links), "mass": np.array(oracle.mass)}
    for support, angles in postures.items():
        com, regressor = map(np.array, zip(*map(oracle.com_and_regressor, angles), strict=True))
        found |= {
            f"{support}.angles": angles[:KEPT],
            f"{support}.com": com[:KEPT],
            f"{support}.regressor": regressor[:KEPT, :2],
            f"{support}.mapping": oracle.figaroh(regressor[:, :2].reshape(-1, regressor.shape[2])),
        }
    angles = postures["right"][:KEPT]
    rng = np.random.default_rng(SEED + 1)
    rates, accelerations = rng.standard_normal(angles.shape), 5 * rng.standard_normal(angles.shape)
    rows = [oracle.root_rows(*motion) for motion in zip(angles, rates, accelerations, strict=True)]
    return found | {"rates": rates, "accelerations": accelerations, "root_rows": np.array(rows)}


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    software = " ".join(f"{name} {version(name)}" for name in ("pin", "figaroh", "mujoco", "dm-control"))
    with tempfile.TemporaryDirectory() as folder:
        robots = {"tulip": TULIP} | {name: write_robot(name, Path(folder) / name) for name in ROBOTS}
        for name, path in robots.items():
            found = answers(load_robot(path))
            np.savez_compressed(FOLDER / f"{name}.npz", software=software, **found)
            ranks = {support: len(found[f"{support}.mapping"]) for support in ("right", "double")}
            print(f"{name}: {len(found['links'])} links, {found['mass']:.3f} kg, FIGAROH's ranks {ranks}")
    print(f"{FOLDER}: {software}")


if __name__ == "__main__":
    main()
