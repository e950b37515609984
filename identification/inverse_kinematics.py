"""Differential inverse kinematics from task space to joint angles (the only importer of mink)."""

import mink
import mujoco
import numpy as np

from tulip_testbed.sim.robot import Robot, between_feet, joint_names, sole_point

TOLERANCE = 1e-9  # of every task's error [m, rad]
ITERATIONS = 15


class InverseKinematics:
    """Inverse kinematics of one robot; a class because mink's tasks are costly to make."""

    def __init__(self, robot: Robot, model: mujoco.MjModel):
        self.robot, self.model = robot, model
        self.configuration = mink.Configuration(model)
        self.feet = [mink.FrameTask(foot, "body", 1.0, 1.0) for foot in robot.feet]
        free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
        self.torso = model.body(model.jnt_bodyid[free]).name
        self.orientation = mink.FrameTask(self.torso, "body", 0.0, 1.0)
        self.com = mink.ComTask(1.0)
        self.tasks: list[mink.Task] = [*self.feet, self.orientation, self.com]
        joints = [model.joint(name) for name in joint_names(model)]
        self.joints = np.array([joint.qposadr[0] for joint in joints])
        # The tasks do not determine all joints: those not between the feet stay at the guess, the others
        # move as little as possible (Newton's steps are least-norm).
        free_joints = ~between_feet(model, robot)
        cost = np.zeros(model.nv)
        cost[[joint.dofadr[0] for joint, free in zip(joints, free_joints, strict=True) if free]] = 1.0
        self.posture = mink.PostureTask(model, cost)
        if free_joints.any():
            self.tasks.append(self.posture)
        self.sole = [sole_point(model, foot) for foot in robot.feet]

    def solve(
        self, swing_pose: np.ndarray, com: np.ndarray, torso_rpy: np.ndarray, guess: np.ndarray
    ) -> np.ndarray | None:
        """Return joint angles, (n_joints,) [rad], or None if the targets cannot be reached.

        Args:
            swing_pose: planar pose of the swing foot in the base frame, (3,) [m, m, rad].
            com: target of the nominal centre of mass over the ground, (3,) [m].
            torso_rpy: roll, pitch, yaw of the torso, (3,) [rad].
            guess: configuration to start from, (nq,); joints that are not between the feet keep it.
        """
        poses = (np.zeros(3), swing_pose)
        for task, pose, sole in zip(self.feet, poses, self.sole, strict=True):
            turn = mink.SO3.from_z_radians(pose[2])
            origin = np.array([pose[0], pose[1], 0.0]) - turn.apply(sole)
            task.set_target(mink.SE3.from_rotation_and_translation(turn, origin))
        torso = mink.SO3.from_rpy_radians(*torso_rpy)
        self.orientation.set_target(mink.SE3.from_rotation(torso))
        self.com.set_target(com)
        self.posture.set_target(guess)
        self.configuration.update(guess)
        for _ in range(ITERATIONS):
            # dt = 1 and unit gain: a Newton step.
            try:
                velocity = mink.solve_ik(self.configuration, self.tasks, 1.0, "daqp", damping=1e-9, limits=[])
            except mink.NoSolutionFound:  # happens far out of reach, where the iteration diverges
                return None
            self.configuration.integrate_inplace(velocity, 1.0)
            if self._error() < TOLERANCE:
                return self.configuration.q[self.joints].copy()
        return None

    def height(self, body: str) -> float:
        """Return the height of a body's origin in the last solution [m]."""
        return float(self.configuration.data.body(body).xpos[2])

    def _error(self) -> float:
        errors = [np.abs(task.compute_error(self.configuration)[task.cost > 0]).max() for task in self.tasks]
        return max(errors)
