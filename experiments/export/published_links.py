"""The bodies of a published file behind the links of the robot that `tulip robot` made of it."""

from pathlib import Path

import mujoco
import numpy as np
from scipy.linalg import sqrtm

from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.robot_import.published import read_published
from tulip_testbed.experiments.robot_import.skeleton import LEAST_MASS
from tulip_testbed.identification.pseudo_inertia import moved, pseudo_inertias, solid
from tulip_testbed.sim.robot import Robot, joint_names

# m, and as a sine: hinges that are farther apart are not the same. MuJoCo writes quaternions with six digits,
# which turns a body by up to 1.7e-6 against the one that carries it; ten bodies add that up.
APART = 2e-5


class PublishedLinks:
    """Bodies of a published MJCF or URDF, of which several may be fixed to each other in one link of a robot.

    Hinges of the same name have to lie on the same axes at zero angles; other robots are refused.

    Attributes:
        names: of the bodies with mass. link: number of the robot's link that each belongs to, (b,).
        pseudo: their pseudo-inertias in the frames of these links, (b, 4, 4).
        transform: homogeneous, from the bodies' own frames to those of the links, (b, 4, 4).
    """

    def __init__(self, path: Path, robot: Robot):
        source = read_published(path)
        model, data = source.model, source.at_zero(joint_names(robot.model))
        other = mujoco.MjData(robot.model)
        other.qpos[[int(robot.model.joint(name).qposadr[0]) for name in joint_names(robot.model)]] = 0.0
        mujoco.mj_kinematics(robot.model, other)
        onto = _alignment(path, (model, data), (robot.model, other))
        of_hinge = {name: int(robot.model.joint(name).bodyid[0]) - 1 for name in joint_names(robot.model)}
        link = np.zeros(model.nbody, int)  # of the robot, by body: that of the next hinge above
        for body in range(1, model.nbody):
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            hinges = [model.joint(k).name for k in range(first, first + count)]
            own = [of_hinge[name] for name in hinges if name in of_hinge]
            link[body] = own[0] if own else link[model.body_parentid[body]]
        bodies = np.flatnonzero((model.body_rootid == source.root) & (model.body_mass > LEAST_MASS))
        self.link = link[bodies]
        poses = [_pose(data, body) for body in bodies.tolist()]
        links = zip(poses, self.link, strict=True)
        self.transform = np.array([np.linalg.inv(_pose(other, k + 1)) @ onto @ pose for pose, k in links])
        self.names = tuple(model.body(body).name for body in bodies)
        self.pseudo = moved(pseudo_inertias(model)[bodies - 1], self.transform)

    def by_link(self, count: int) -> np.ndarray:
        """Return the sum of the pseudo-inertias of every link, (count, 4, 4)."""
        sums = np.zeros((count, 4, 4))
        np.add.at(sums, self.link, self.pseudo)
        return sums

    def changed(self, wanted: np.ndarray) -> dict[str, np.ndarray]:
        """Return new pseudo-inertias in the bodies' own frames by name, (4, 4) each.

        The bodies of a link share its change: their masses are scaled alike and their places stretched and
        moved alike. This is a congruence, which keeps every body positive definite, and their sum is exact.

        Args:
            wanted: pseudo-inertias of the links, (n_links, 4, 4).
        """
        each = solid(self.pseudo)
        sums = np.zeros_like(wanted)
        np.add.at(sums, self.link, each)
        by_body = {}
        for k, name in enumerate(self.names):
            stretched = moved(each[k], _stretch(sums[self.link[k]], wanted[self.link[k]]))
            by_body[name] = moved(stretched, np.linalg.inv(self.transform[k]))
        return by_body


def _pose(data: mujoco.MjData, body: int) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    return pose


def _alignment(
    path: Path, source: tuple[mujoco.MjModel, mujoco.MjData], robot: tuple[mujoco.MjModel, mujoco.MjData]
) -> np.ndarray:
    """Return the rigid transform from the file's world to the robot's, (4, 4), from axes of equal hinges."""
    names = joint_names(robot[0])
    there = {source[0].joint(k).name: k for k in range(source[0].njnt)}
    if missing := [name for name in names if name not in there]:
        raise InputError(
            f"{path}: found no joint '{missing[0]}', expected the file that the robot is made of"
        )
    a = [there[name] for name in names]
    b = [robot[0].joint(name).id for name in names]
    left, _, right = np.linalg.svd(robot[1].xaxis[b].T @ source[1].xaxis[a])
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    axes = robot[1].xaxis[b]
    across = np.eye(3) - axes[:, :, None] * axes[:, None]  # off the axis, along which an anchor is free
    gap = robot[1].xanchor[b] - source[1].xanchor[a] @ turn.T
    place = np.linalg.lstsq(across.reshape(-1, 3), (across @ gap[..., None]).ravel(), rcond=None)[0]
    apart = np.linalg.norm((across @ (gap - place)[..., None])[..., 0], axis=1)
    tilted = np.linalg.norm(source[1].xaxis[a] @ turn.T - axes, axis=1)
    worst = int(np.argmax(np.maximum(apart, tilted)))
    if max(apart[worst], tilted[worst]) > APART:
        raise InputError(
            f"{path}: joint '{names[worst]}': found its axis {1e3 * apart[worst]:.3g} mm and "
            f"{np.degrees(tilted[worst]):.3g} degrees away from the robot's, expected the file that the "
            "robot is made of"
        )
    onto = np.eye(4)
    onto[:3, :3], onto[:3, 3] = turn, place
    return onto


def _stretch(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return T with T old T' = new, (4, 4): masses by one factor, a symmetric stretch about the centre."""
    (mass, mass_now), centers, seconds = (old[3, 3], new[3, 3]), [], []
    for pseudo in (old, new):
        centers.append(pseudo[:3, 3] / pseudo[3, 3])
        seconds.append(pseudo[:3, :3] - pseudo[3, 3] * np.outer(centers[-1], centers[-1]))
    root = np.real(sqrtm(seconds[0]))
    back = np.linalg.inv(root)
    whole, scale = np.eye(4), np.sqrt(mass_now / mass)
    # Distances from the centre scale with the root of second moments over masses.
    whole[:3, :3] = back @ np.real(sqrtm(root @ seconds[1] @ root)) @ back
    whole[:3, 3] = scale * centers[1] - whole[:3, :3] @ centers[0]
    whole[3, 3] = scale
    return whole
