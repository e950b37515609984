"""Make records like a real humanoid's on one foot, with known truth, by MuJoCo alone.

The left sole is held to the ground by two hinges with springs, about which the foot rocks. The joints follow a
spline through random postures in full dynamics. The sensor is MuJoCo's own, between sole and ground. What the
log does not say is drawn: the axes in which the wrench is written, its sign, and where the sensor sits.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder, write_text
from tulip_testbed.sim.robot import Robot, joint_names, sole_corners, sole_point

ROCKS = ("rocks_x", "rocks_y")  # hinges of the left sole
FRAMES = ("sensor", "base", "world")  # the axes of a logged wrench
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
GRAVITY = 9.81  # m/s2
STEP, EVERY, SETTLING = 0.002, 5, 2.0  # s, steps a row, s before the first row
# How far a true robot and its sensors are from what is stated (s.d., but for ranges).
MASS, CENTER = 0.1, 0.003  # relative; m
COMPLIANCE = (0.25 / 20, 1.0 / 20)  # range, deg/Nm: about half a degree at 20 Nm
ORIGIN = ((-0.03, 0.03), (-0.02, 0.02), (0.0, 0.05))  # range of the sensor, m
TURN, CROSS_TALK, ARM = 0.6, 0.01, 0.05  # deg; relative; m: a moment's unit in forces
ZERO, NOISE, STEP_OF = (2.0, 0.1), (0.2, 0.01), (0.05, 0.002)  # N, Nm
ENCODER_ZERO, ENCODER_NOISE, ENCODER_STEP = 0.15, 0.02, 0.088  # deg
IMU, HEADING, NOT_LOGGED = 0.2, 2.0, 5.0  # deg
# The motion.
SPEED = (0.25, 0.5)  # range of the fastest joint's, at half of the times; rad/s
EXCURSION, STANCE_EXCURSION = 0.7, 0.35  # rad, from the posture `stand`
INSIDE = 0.5  # of the sole: where the centre of mass is led
UPRIGHT, LIFTED, TRIES = np.radians(45.0), 0.02, 4000  # of the free body; m, of the other foot
SERVO, ROTOR = 40.0, 0.02  # rad/s, kg m2


@dataclass(frozen=True)
class Truth:
    """What is true of one record, and hidden from the tool.

    Attributes:
        frame, sign: axes of the logged wrench; 1: of the ground on the robot, -1: of the robot on the ground.
        mass: by link, over the nominal one. center: its error, (3,) [m].
        compliance: of the sole about x and y, (2,) [rad/Nm].
        origin, turn: of the sensor from the point of the sole below the ankle, in the foot's axes, (3,) [m], and
            rotation vector, (3,) [rad].
        cross_talk: reading over wrench, (6, 6). zeros: right and left, (2, 6) [N, Nm].
        encoder_zeros: by joint [rad]. constants: angles of the joints that are not logged [rad].
        imu: rotation vector of the world's axes as logged, (3,) [rad].
    """

    frame: str
    sign: int
    mass: dict[str, float]
    center: dict[str, list[float]]
    compliance: list[float]
    origin: list[float]
    turn: list[float]
    cross_talk: list[list[float]]
    zeros: list[list[float]]
    encoder_zeros: dict[str, float]
    constants: dict[str, float]
    imu: list[float]


@dataclass(frozen=True)
class Motion:
    """What MuJoCo simulated, T rows.

    Attributes:
        time: (T,) [s]. joints: true angles, (T, n) [rad]. tilt: of the sole about x and y, (T, 2) [rad].
        sole: its axes in the world, (T, 3, 3). wrench: of the ground, in the sensor, (T, 6) [N, Nm].
        center: of mass, from the sole's middle, in the world (T, 3) [m].
        momentum: linear, and angular about the world's origin, (T, 6) [N s, N m s].
    """

    time: np.ndarray
    joints: np.ndarray
    tilt: np.ndarray
    sole: np.ndarray
    wrench: np.ndarray
    center: np.ndarray
    momentum: np.ndarray


def exact(robot: Robot, not_logged: Sequence[str] = ()) -> Truth:
    """Return the truth of a record without any fault, on a sole that hardly rocks."""
    return draw_truth(robot, None, not_logged)


def draw_truth(robot: Robot, generator: np.random.Generator | None, not_logged: Sequence[str] = ()) -> Truth:
    """Draw what is true of a record; without a generator everything is as stated."""
    rng, scale = generator or np.random.default_rng(0), 0.0 if generator is None else 1.0

    def normal(sd: float, *size: int) -> np.ndarray:
        return scale * sd * rng.standard_normal(size)

    links = [robot.model.body(k).name for k in range(1, robot.model.nbody)]
    joints = joint_names(robot.model)
    units = np.repeat([1.0, ARM], 3)
    yaw = np.append(normal(IMU, 2), normal(HEADING, 1))
    return Truth(
        frame=str(rng.choice(FRAMES)) if scale else FRAMES[0],
        sign=int(rng.choice([1, -1])) if scale else 1,
        mass={link: float(1 + np.clip(normal(MASS, 1)[0], -0.25, 0.25)) for link in links},
        center={link: normal(CENTER, 3).tolist() for link in links},
        compliance=np.radians(rng.uniform(*COMPLIANCE, 2) if scale else np.full(2, 1e-4)).tolist(),
        origin=(scale * np.array([rng.uniform(*ends) for ends in ORIGIN])).tolist(),
        turn=np.radians(normal(TURN, 3)).tolist(),
        cross_talk=(np.eye(6) + normal(CROSS_TALK, 6, 6) * units[:, None] / units).tolist(),
        zeros=(normal(1.0, 2, 6) * np.repeat(ZERO, 3)).tolist(),
        encoder_zeros=dict(zip(joints, np.radians(normal(ENCODER_ZERO, len(joints))).tolist(), strict=True)),
        constants={name: float(np.radians(normal(NOT_LOGGED, 1)[0])) for name in not_logged},
        imu=np.radians(yaw).tolist(),
    )


def true_spec(robot: Robot, truth: Truth) -> mujoco.MjSpec:
    """Return the robot with its true masses."""
    spec = robot.spec.copy()
    for body in spec.bodies[1:]:
        factor = truth.mass[body.name]
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
        body.ipos = body.ipos + np.array(truth.center[body.name])
    return spec


def simulate(robot: Robot, truth: Truth, seconds: float, generator: np.random.Generator) -> Motion:
    """Move the robot on its left foot for some seconds in full dynamics."""
    aim = _trajectory(robot, truth.constants, seconds + SETTLING, generator)
    model = on_left_foot(robot, truth)
    data = mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in joint_names(robot.model)]  # every joint is a hinge
    rocks = [model.joint(name).qposadr[0] for name in ROCKS]
    data.qpos[at] = aim(0.0)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    stiffness = SERVO**2 * np.diag(inertia)[at]
    model.dof_damping[at] = damping = 2 * stiffness / SERVO
    rows: list[tuple[np.ndarray, ...]] = []
    seen = mujoco.MjData(model)
    for k in range(round((seconds + SETTLING) / STEP)):
        now = k * STEP
        seen.qpos, seen.qvel = data.qpos, data.qvel
        data.qfrc_applied[at] = stiffness * (aim(now) - data.qpos[at]) + damping * aim(now, 1)
        mujoco.mj_step(model, data)
        if now < SETTLING or k % EVERY:
            continue
        # Sensors read the acceleration of the step; that of mj_forward ignores the implicit damping.
        seen.qacc = (data.qvel - seen.qvel) / STEP
        mujoco.mj_inverse(model, seen)
        mujoco.mj_subtreeVel(model, seen)
        linear = model.body_subtreemass[0] * seen.subtree_linvel[0]
        angular = seen.subtree_angmom[0] + np.cross(seen.subtree_com[0], linear)
        axes = seen.body(robot.swing_foot).xmat.reshape(3, 3)
        row = (now - SETTLING, seen.qpos[at], seen.qpos[rocks], axes, seen.sensordata)
        rows.append(tuple(map(np.array, (*row, seen.subtree_com[0], np.append(linear, angular)))))
    return Motion(*(np.array(column) for column in zip(*rows, strict=True)))


def log(robot: Robot, truth: Truth, motion: Motion, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the columns of a log: what encoders and sensors give, in the log's axes."""
    names, count = joint_names(robot.model), len(motion.time)

    def noisy(values: np.ndarray, sd: Any, step: Any) -> np.ndarray:
        return np.round((values + sd * generator.standard_normal(values.shape)) / step) * step

    zeros = np.array([truth.encoder_zeros[name] for name in names])
    degrees = noisy(np.degrees(motion.joints + zeros), ENCODER_NOISE, ENCODER_STEP)
    sd, step = np.repeat(NOISE, 3), np.repeat(STEP_OF, 3)
    left = noisy(motion.wrench @ np.array(truth.cross_talk).T + truth.zeros[1], sd, step)
    right = noisy(np.tile(truth.zeros[0], (count, 1)), sd, step)
    turns = {
        "sensor": lambda: np.tile(np.eye(3), (count, 1, 1)),
        "base": lambda: _in_base(robot, truth, np.radians(degrees)),
        "world": lambda: Rotation.from_rotvec(truth.imu).as_matrix() @ motion.sole,
    }[truth.frame]()
    columns = {"t_s": motion.time}
    columns |= {f"{n}_deg": degrees[:, k] for k, n in enumerate(names) if n not in truth.constants}
    for foot, wrench in (("left", left), ("right", right)):
        both = np.einsum("tij,tkj->tki", turns, wrench.reshape(count, 2, 3)).reshape(count, 6)
        columns |= {f"{foot}_foot_{c}": truth.sign * both[:, k] for k, c in enumerate(CHANNELS)}
    return columns


def map_text(robot: Robot, truth: Truth) -> str:
    """Return what a user can state about the log, TOML."""
    lines = [
        'placement = "one"',
        f"gravity = {GRAVITY}",
        '\n[columns]\ntime = {column = "t_s", unit = "s"}',
        f"\n[sensors]\nencoder_sd = {np.radians(ENCODER_NOISE):.6f}",
        f"encoder_resolution = {np.radians(ENCODER_STEP):.6f}",
    ]
    if truth.constants:
        sd = np.radians(NOT_LOGGED)
        lines += ["\n[constant_joints]"]
        lines += [f'"{name}" = {{value = 0.0, sd = {sd:.4f}}}' for name in truth.constants]
    for side, foot in (("right", robot.stance_foot), ("left", robot.swing_foot)):
        x, y, z = (float(one) for one in sole_point(robot.model, foot))
        lines += [
            f'\n[[contacts]]\nname = "{side}"\nkind = "wrench"\nmount = "foot"',
            'channels = ["fx", "fy", "fz", "mx", "my", "mz"]',
            f"pose = {{x = {x:.5f}, y = {y:.5f}, z = {z:.5f}, roll = 0.0, pitch = 0.0, yaw = 0.0}}",
            f"zero = {np.repeat(ZERO, 3).tolist()}",
        ]
    return "\n".join(lines) + "\n"


def write_record(
    robot: Robot, seed: int, out: Path, seconds: float = 50.0, not_logged: Sequence[str] = ()
) -> Truth:
    """Write a new folder: the log `series.csv`, `MAP.toml`, and apart in `truth` what they hide."""
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)]
    truth = draw_truth(robot, streams[0], not_logged)
    motion = simulate(robot, truth, seconds, streams[1])
    hidden = {"t_s": motion.time}
    hidden |= {f"tilt_{axis}_deg": np.degrees(motion.tilt[:, k]) for k, axis in enumerate("xy")}
    hidden |= {f"com_{axis}_m": motion.center[:, k] for k, axis in enumerate("xyz")}
    with new_folder(out) as folder:
        (folder / "truth").mkdir()
        write_text(folder / "series.csv", _csv(log(robot, truth, motion, streams[2])))
        write_text(folder / "MAP.toml", map_text(robot, truth))
        write_text(folder / "truth" / "truth.json", json.dumps(asdict(truth), indent=1) + "\n")
        write_text(folder / "truth" / "motion.csv", _csv(hidden))
        write_text(folder / "truth" / "robot.xml", true_spec(robot, truth).to_xml())
    return truth


def _csv(columns: dict[str, np.ndarray]) -> str:
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(f"{v:.5f}" for v in row) for row in rows)]) + "\n"


def on_left_foot(robot: Robot, truth: Truth) -> mujoco.MjModel:
    """Return the true robot as a tree that grows from its left sole, which rocks on the ground.

    The world's origin is the sole's middle. Joints and links keep their names and frames.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = STEP, [0, 0, -GRAVITY]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.degree = False
    old = true_spec(robot, truth).compile()
    data = mujoco.MjData(old)
    mujoco.mj_kinematics(old, data)
    turns, places = data.xmat.reshape(-1, 3, 3), data.xpos
    middle = _middle(robot, robot.swing_foot)

    def grow(parent: mujoco.MjsBody, k: int, before: int, hinges: Sequence[int], sign: int) -> mujoco.MjsBody:
        place = turns[before].T @ (places[k] - places[before]) if before else -middle
        turn = turns[before].T @ turns[k] if before else np.eye(3)
        body = parent.add_body(
            name=old.body(k).name, pos=place, quat=_quaternion(turn), explicitinertial=True
        )
        body.mass, body.inertia = old.body_mass[k], old.body_inertia[k]
        body.ipos, body.iquat = old.body_ipos[k], old.body_iquat[k]
        for j in hinges:
            anchor, axis = turns[k].T @ (data.xanchor[j] - places[k]), sign * turns[k].T @ data.xaxis[j]
            body.add_joint(name=old.joint(j).name, pos=anchor, axis=axis, armature=ROTOR)
        for child in np.flatnonzero(old.body_parentid == k):
            if child not in (before, 0):
                grow(body, child, k, _hinges(old, child), 1)
        above = old.body_parentid[k]
        if above not in (before, 0):
            grow(body, above, k, _hinges(old, k)[::-1], -1)
        return body

    foot = grow(spec.worldbody, old.body(robot.swing_foot).id, 0, [], 1)
    for name, axis, compliance in zip(ROCKS, np.eye(3), truth.compliance, strict=False):
        # Coefficients of polynomials; the higher ones are zero.
        joint = foot.add_joint(name=name, pos=middle, axis=axis)
        joint.stiffness, joint.damping = [1 / compliance, 0, 0], [0.03 / compliance, 0, 0]
    turn = Rotation.from_rotvec(truth.turn).as_matrix()
    foot.add_site(
        name="sensor", pos=sole_point(robot.model, robot.swing_foot) + truth.origin, quat=_quaternion(turn)
    )
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    return spec.compile()


def _hinges(model: mujoco.MjModel, body: int) -> list[int]:
    return [
        j
        for j in np.flatnonzero(model.jnt_bodyid == body)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    ]


def _quaternion(turn: np.ndarray) -> np.ndarray:
    return np.roll(Rotation.from_matrix(turn).as_quat(), 1)


def _middle(robot: Robot, foot: str) -> np.ndarray:
    return sole_corners(robot.model, foot).mean(axis=0)


def _in_base(robot: Robot, truth: Truth, angles: np.ndarray) -> np.ndarray:
    """Return the left foot's axes in the root's of the published file, as the robot's software has them.

    It knows the nominal robot and the readings of the encoders; joints that are not logged are at zero.
    """
    model, out = robot.model, np.empty((len(angles), 3, 3))
    data = mujoco.MjData(model)
    names = joint_names(model)
    known = np.array([name not in truth.constants for name in names])
    at = np.array([model.joint(name).qposadr[0] for name in names])
    root = data.body(1).xmat  # a view; at zero angles the world's axes are the file's
    mujoco.mj_kinematics(model, data)
    as_published = root.reshape(3, 3).copy()
    for k, row in enumerate(angles):
        data.qpos[at] = row * known
        mujoco.mj_kinematics(model, data)
        foot = data.body(robot.swing_foot).xmat.reshape(3, 3)
        out[k] = as_published @ root.reshape(3, 3).T @ foot
    return out


def _trajectory(
    robot: Robot, constants: dict[str, float], seconds: float, rng: np.random.Generator
) -> CubicSpline:
    """Return a smooth motion on the left foot, (n,) [rad] of time [s], with its centre of mass over the sole.

    Raises:
        InputError: no such motion was found.
    """
    pose = _Posing(robot, constants)
    for shrunk in 0.95 ** np.arange(20):
        postures, goals = zip(*(pose.draw(rng, shrunk) for _ in range(40)), strict=True)
        path, goal = (CubicSpline(np.arange(40), np.array(one)) for one in (postures, goals))
        fastest = np.abs(path(np.linspace(0, 39, 2000), 1)).max(axis=1)
        pace = rng.uniform(*SPEED) / np.median(fastest)
        times = np.arange(0.0, seconds + 0.1, 0.05)
        if times[-1] * pace > 39:
            continue
        rows = [pose.balanced(path(pace * t), goal(pace * t)) for t in times]
        if all(map(partial(pose.stands, margin=0.0), rows)):
            return CubicSpline(times, np.array(rows))
    raise InputError(f"{robot.name}: found no motion on one foot, expected one with smaller excursions")


class _Posing:
    """Postures of the nominal robot on the left foot; a class because all share a model's data."""

    def __init__(self, robot: Robot, constants: dict[str, float]) -> None:
        self.robot, self.model = robot, on_left_foot(robot, exact(robot))
        self.data = mujoco.MjData(self.model)
        names = joint_names(robot.model)
        joints = [robot.model.joint(name) for name in names]
        self.at = [self.model.joint(name).qposadr[0] for name in names]
        self.range = np.array([j.range if robot.model.jnt_limited[j.id] else (-np.pi, np.pi) for j in joints])
        self.stand = robot.model.key("stand").qpos[[j.qposadr[0] for j in joints]]
        by_distance = sorted(range(len(names)), key=lambda k: self.at[k])  # from the left foot
        self.ankle = by_distance[:2]
        self.fixed, self.constants = [names.index(name) for name in constants], list(constants.values())
        reach = np.full(len(names), EXCURSION)
        reach[by_distance[:6]] = STANCE_EXCURSION
        low, high = self.range.T + np.multiply.outer([0.05, -0.05], np.ptp(self.range, axis=1))
        self.low, self.high = np.maximum(low, self.stand - reach), np.minimum(high, self.stand + reach)
        self.half = np.ptp(sole_corners(robot.model, robot.swing_foot), axis=0)[:2] / 2
        self.other = _middle(robot, robot.stance_foot)

    def draw(self, rng: np.random.Generator, shrunk: float) -> tuple[np.ndarray, np.ndarray]:
        """Return a posture that stands and its centre of mass over the sole, (n,) [rad] and (2,) [m]."""
        for _ in range(TRIES):
            angles = self.stand + shrunk * (rng.uniform(self.low, self.high) - self.stand)
            goal = INSIDE * rng.uniform(-self.half, self.half)
            angles = self.balanced(angles, goal)
            if self.stands(angles, LIFTED):
                return angles, goal
        raise InputError(f"{self.robot.name}: found no posture on one foot in {TRIES} tries")

    def balanced(self, angles: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return the angles with the stance ankle's changed: the centre of mass is where it should be."""
        angles = angles.copy()
        angles[self.fixed] = self.constants
        for _ in range(4):
            off = self.center(angles) - goal
            slopes = np.empty((2, 2))
            for k, joint in enumerate(self.ankle):
                moved = angles.copy()
                moved[joint] += 1e-4
                slopes[:, k] = (self.center(moved) - goal - off) / 1e-4
            angles[self.ankle] -= np.clip(np.linalg.solve(slopes, off), -0.3, 0.3)
        return angles

    def center(self, angles: np.ndarray) -> np.ndarray:
        """Return the centre of mass over the level sole, from its middle, (2,) [m]."""
        self.data.qpos[self.at] = angles
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return self.data.subtree_com[0, :2].copy()

    def stands(self, angles: np.ndarray, margin: float) -> bool:
        """Return whether the posture keeps its ranges, is upright, and lifts the other foot."""
        self.center(angles)
        other = self.data.body(self.robot.stance_foot)
        height = other.xpos[2] + other.xmat.reshape(3, 3)[2] @ self.other
        up = self.data.body(self.robot.model.body(1).name).xmat[8]
        kept = (self.range[:, 0] <= angles) & (angles <= self.range[:, 1])
        return bool(kept.all() and height > margin and up > np.cos(UPRIGHT))
