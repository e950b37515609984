"""Wrench sensors in or under the feet: their frames, their place in the scene, and what is below them."""

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.sim.robot import Robot, sole_point
from tulip_testbed.sim.sensors import SOLE, WrenchSensors


def mountings(sensors: WrenchSensors, robot: Robot) -> np.ndarray:
    """Return the pose of each foot's sensor in its foot's frame, (2, 6) [m, rad]."""
    poses = np.tile(np.array(sensors.mounting, float), (2, 1))
    if sensors.place == SOLE:
        poses[:, :3] += [sole_point(robot.model, foot) for foot in robot.feet]
    return poses


def add_foot_sensors(spec: mujoco.MjSpec, feet: Sequence[str], mounting: Sequence[float]) -> None:
    """Add a site with a force and a torque sensor to each foot, in its ankle.

    The mounting is its pose in the foot's frame, x, y, z, roll, pitch, yaw [m, rad].
    """
    rotation, place = frame_of(mounting)
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    for foot in feet:
        name = f"{foot}_wrench"
        spec.body(foot).add_site(name=name, pos=place, quat=[w, x, y, z])
        for kind, sensor in (
            ("force", mujoco.mjtSensor.mjSENS_FORCE),
            ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
        ):
            spec.add_sensor(
                name=f"{name}_{kind}", type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name
            )


def foot_addresses(model: mujoco.MjModel, feet: Sequence[str]) -> np.ndarray:
    """Return the addresses of the channels of both feet in `sensordata`, (2, 6).

    MuJoCo's sensors give the wrench that the leg exerts on the foot. The reading is its opposite: the
    wrench of the ground on the foot, less the weight of the foot.
    """
    kinds = ("force", "torque")
    first = [[model.sensor(f"{foot}_wrench_{kind}").adr[0] for kind in kinds] for foot in feet]
    return (np.array(first, int).reshape(-1, 2, 1) + np.arange(3)).reshape(-1, 6)


def frame_of(mounting: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and origin of a sensor's frame in its foot's frame, (3, 3) and (3,) [m]."""
    return Rotation.from_euler("xyz", mounting[3:]).as_matrix(), np.array(mounting[:3])


def in_frame(rotation: np.ndarray, place: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Transform wrenches, (..., 6) [N, Nm], to a frame: rotation (..., 3, 3), place (..., 3) [m]."""
    force, moment = wrenches[..., :3], wrenches[..., 3:]
    both = np.stack([force, moment - np.cross(place, force)], axis=-2) @ rotation
    return both.reshape(*both.shape[:-2], 6)


def nominal_feet(robot: Robot) -> np.ndarray:
    """Return mass and centre of both nominal feet with all that hangs on them, (2, 4) [kg, m].

    The centre is in the foot's frame, with the joints beyond the foot, if any, as the file draws them.
    """
    model = robot.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    rows = []
    for foot in (model.body(name).id for name in robot.feet):
        arm = data.subtree_com[foot] - data.xpos[foot]
        rows.append([model.body_subtreemass[foot], *(arm @ data.xmat[foot].reshape(3, 3))])
    return np.array(rows)
