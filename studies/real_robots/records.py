"""Make records like a real humanoid's on one foot, with known truth, by MuJoCo alone.

The left sole is held to the ground by two hinges with springs, about which the foot rocks. The joints follow
a spline through random postures in full dynamics. The sensor is MuJoCo's own, between foot and ground. The
axes in which a log writes the wrench, its sign, and where the sensor sits are drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import new_folder, write_text
from tulip_testbed.sim.robot import Robot, joint_names, sole_corners, sole_point

FRAMES = ("sensor", "base", "world")  # the axes of a logged wrench
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
ROCKS = ("rocks_x", "rocks_y")  # hinges of the left sole
GRAVITY = 9.81  # m/s2
STEP, EVERY, SETTLING, SECONDS = 0.002, 5, 2.0, 50.0  # s, steps a row, s before the first row, s of a record
# How far a true robot and its sensors are from what is stated (s.d., but for ranges).
MASS, MOST_MASS, CENTER = 0.1, 0.25, 0.003  # relative; m
ROCKING, ROCKED_BY = (0.25, 1.0), 0.06  # range, deg under the weight at that distance, m
# Range of the compliance, over the one at which the robot tips over; uniform in the logarithm.
SOFT = (0.05, 0.8)
ORIGIN = ((-0.03, 0.03), (-0.02, 0.02), (0.0, 0.05))  # range of the sensor, m
TURN, CROSS_TALK, ARM = 0.6, 0.01, 0.03  # deg; relative; m: range of moments over that of forces
ZERO, NOISE, STEP_OF = (2.0, 0.1), (0.2, 0.01), (0.05, 0.002)  # N, Nm
ENCODER_ZERO, ENCODER_NOISE, ENCODER_STEP = 0.15, 0.02, 0.088  # deg
UNKNOWN_PLACE = 0.05  # m, as a user states who does not know where in the foot the sensor sits
DELAY = 0.03  # s, of the soles
IMU, NOT_LOGGED = 0.2, 5.0  # deg; the heading of the world's axes may be any
# The motion.
KNOTS, FINE = 40, 0.05  # postures; s between the times at which the centre of mass is led
SPEED = (0.25, 0.5)  # range of the fastest joint's, at half of the times; rad/s
EXCURSION, STANCE_EXCURSION = 0.7, 0.35  # rad, from the posture `stand`
INSIDE = 0.5  # of the sole: where the centre of mass is led; less where the sole's yielding takes it further
UPRIGHT, LIFTED, TRIES = np.cos(np.radians(45.0)), 0.02, 4000  # of the free body; m, of the other foot
SERVO, ROTOR = 40.0, 0.02  # rad/s, kg m2


@dataclass(frozen=True)
class Truth:
    """The truth about one record, hidden from the tool.

    Attributes:
        frame, sign: axes of the logged wrench; 1: of the ground on the robot, -1: of the robot on the ground.
        mass: by link, over the nominal one. center: its error, (3,) [m].
        compliance: of the sole about x and y, (2,) [rad/Nm].
        origin, turn: of the sensor from the point of the sole below the ankle, in the foot's axes, (3,) [m],
            and rotation vector, (3,) [rad].
        cross_talk: reading over wrench, (6, 6). zeros: right and left, (2, 6) [N, Nm].
        encoder_zeros: by joint [rad]. constants: angles of the joints that are not logged [rad].
        imu: roll, pitch and yaw of the foot on level ground in the axes of a log in the world's, (3,) [rad].
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
    """A simulated motion of T rows.

    Attributes:
        time: (T,) [s]. joints: true angles, (T, n) [rad]. tilt: of the sole about x and y, (T, 2) [rad].
        wrench: of the ground on the foot, in the sensor, (T, 6) [N, Nm].
    """

    time: np.ndarray
    joints: np.ndarray
    tilt: np.ndarray
    wrench: np.ndarray


def draw_truth(
    robot: Robot, rng: np.random.Generator | None, not_logged: Sequence[str] = (), soft: bool = False
) -> Truth:
    """Draw what is true of a record; without a generator it is as stated, on a sole that hardly rocks."""
    some, scale = rng or np.random.default_rng(0), float(rng is not None)

    def normal(sd: Any, *size: int) -> np.ndarray:
        return scale * sd * some.standard_normal(size)

    links, joints = [robot.model.body(k).name for k in range(1, robot.model.nbody)], joint_names(robot.model)
    units = np.repeat([1.0, ARM], 3)
    rocking = np.radians(some.uniform(*ROCKING, 2) if rng else np.full(2, 1e-3))
    compliance = rocking / (ROCKED_BY * robot.model.body_mass.sum() * GRAVITY)
    if soft:
        compliance = SOFT[0] * (SOFT[1] / SOFT[0]) ** some.uniform(size=2) * _tipping(robot)
    return Truth(
        frame=str(some.choice(FRAMES)) if rng else FRAMES[0],
        sign=int(some.choice([1, -1])) if rng else 1,
        mass={link: float(1 + np.clip(normal(MASS), -MOST_MASS, MOST_MASS)) for link in links},
        center={link: normal(CENTER, 3).tolist() for link in links},
        compliance=compliance.tolist(),
        origin=[scale * some.uniform(*ends) for ends in ORIGIN],
        turn=np.radians(normal(TURN, 3)).tolist(),
        cross_talk=(np.eye(6) + normal(CROSS_TALK, 6, 6) * units[:, None] / units).tolist(),
        zeros=(normal(1.0, 2, 6) * np.repeat(ZERO, 3)).tolist(),
        encoder_zeros={name: float(np.radians(normal(ENCODER_ZERO))) for name in joints},
        constants={name: float(np.radians(normal(NOT_LOGGED))) for name in not_logged},
        imu=[*np.radians(normal(IMU, 2)), scale * some.uniform(-np.pi, np.pi)],
    )


def true_spec(robot: Robot, truth: Truth) -> mujoco.MjSpec:
    """Return the robot with its true masses."""
    spec = robot.spec.copy()
    for body in spec.bodies[1:]:
        factor = truth.mass[body.name]
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
        body.ipos = body.ipos + np.array(truth.center[body.name])
    return spec


def on_left_foot(robot: Robot, truth: Truth) -> mujoco.MjModel:
    """Return the true robot as a tree that grows from its left foot, which rocks on the ground.

    The world's origin is the sole's middle. Links and joints keep their names, frames and signs.
    """
    spec, old = mujoco.MjSpec(), true_spec(robot, truth).compile()
    spec.option.timestep, spec.option.gravity = STEP, [0, 0, -GRAVITY]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.degree = False
    data = mujoco.MjData(old)
    mujoco.mj_kinematics(old, data)
    turns, places = data.xmat.reshape(-1, 3, 3), data.xpos
    middle = sole_corners(robot.model, robot.swing_foot).mean(axis=0)

    def grow(parent: mujoco.MjsBody, k: int, before: int, held_by: int, sign: int) -> mujoco.MjsBody:
        """Add a link, seen from the one before it, with the hinges that the file gives one of the two."""
        place = turns[before].T @ (places[k] - places[before]) if before else -middle
        turn = turns[before].T @ turns[k] if before else np.eye(3)
        body = parent.add_body(name=old.body(k).name, pos=place, quat=_quaternion(turn))
        body.mass, body.inertia, body.explicitinertial = old.body_mass[k], old.body_inertia[k], True
        body.ipos, body.iquat = old.body_ipos[k], old.body_iquat[k]
        for j in (old.body_jntadr[held_by] + np.arange(old.body_jntnum[held_by]))[::sign] if held_by else ():
            anchor, axis = turns[k].T @ (data.xanchor[j] - places[k]), sign * turns[k].T @ data.xaxis[j]
            body.add_joint(name=old.joint(j).name, pos=anchor, axis=axis, armature=ROTOR)
        for child in map(int, np.flatnonzero(old.body_parentid == k)):
            if child != before:
                grow(body, child, k, child, 1)
        above = int(old.body_parentid[k])
        if above not in (before, 0):
            grow(body, above, k, k, -1)
        return body

    foot = grow(spec.worldbody, old.body(robot.swing_foot).id, 0, 0, 1)
    for name, axis, compliance in zip(ROCKS, np.eye(3), truth.compliance, strict=False):
        joint = foot.add_joint(name=name, pos=middle, axis=axis)
        joint.stiffness, joint.damping = [1 / compliance, 0, 0], [DELAY / compliance, 0, 0]  # polynomials
    place = sole_point(robot.model, robot.swing_foot) + truth.origin
    foot.add_site(name="sensor", pos=place, quat=_quaternion(Rotation.from_rotvec(truth.turn).as_matrix()))
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    return spec.compile()


def simulate(robot: Robot, truth: Truth, seconds: float, rng: np.random.Generator) -> Motion:
    """Move the robot on its left foot for some seconds in full dynamics."""
    led = INSIDE * (1 - np.array(truth.compliance[::-1]) / _tipping(robot))
    aim = _trajectory(robot, truth.constants, seconds + SETTLING, led, rng)
    model = on_left_foot(robot, truth)
    data, seen = mujoco.MjData(model), mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in joint_names(robot.model)]  # every joint is a hinge
    rocks = [model.joint(name).qposadr[0] for name in ROCKS]
    data.qpos[at] = aim(0.0)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia := np.zeros((model.nv, model.nv)))
    stiffness = SERVO**2 * np.diag(inertia)[at]
    model.dof_damping[at] = damping = 2 * stiffness / SERVO
    rows = []
    for k, now in enumerate(np.arange(0.0, seconds + SETTLING - STEP / 2, STEP)):
        seen.qpos, seen.qvel = data.qpos, data.qvel
        data.qfrc_applied[at] = stiffness * (aim(now) - data.qpos[at]) + damping * aim(now, 1)
        mujoco.mj_step(model, data)
        if now < SETTLING or k % EVERY:
            continue
        # Sensors read the acceleration of the step; that of mj_forward ignores the implicit damping.
        seen.qacc = (data.qvel - seen.qvel) / STEP
        mujoco.mj_inverse(model, seen)
        row = now - SETTLING, seen.qpos[at], seen.qpos[rocks], seen.sensordata
        rows.append(tuple(map(np.array, row)))
    return Motion(*(np.array(column) for column in zip(*rows, strict=True)))


def log(robot: Robot, truth: Truth, motion: Motion, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the columns of a log: what encoders and sensors give, in the log's axes."""
    names, count = joint_names(robot.model), len(motion.time)

    def read(values: np.ndarray, sd: Any, step: Any) -> np.ndarray:
        return np.round((values + sd * rng.standard_normal(values.shape)) / step) * step

    zeros, (sd, step) = list(truth.encoder_zeros.values()), np.repeat([NOISE, STEP_OF], 3, axis=1)
    degrees = read(np.degrees(motion.joints + zeros), ENCODER_NOISE, ENCODER_STEP)
    left = read(motion.wrench @ np.array(truth.cross_talk).T + truth.zeros[1], sd, step)
    right = read(np.tile(truth.zeros[0], (count, 1)), sd, step)
    turns = np.tile(np.eye(3), (count, 2, 1, 1))
    if truth.frame != "sensor":
        turns = _in_base(robot, truth, np.radians(degrees))
    if truth.frame == "world":
        lean = (Rotation.from_euler("xyz", truth.imu) * Rotation.from_euler("XY", motion.tilt)).as_matrix()
        turns = (lean @ turns[:, 1].mT)[:, None] @ turns
    columns = {"t_s": motion.time}
    columns |= {f"{n}_deg": degrees[:, k] for k, n in enumerate(names) if n not in truth.constants}
    for side, (foot, wrench) in enumerate((("right", right), ("left", left))):
        turned = np.einsum("tij,tkj->tki", turns[:, side], wrench.reshape(count, 2, 3)).reshape(count, 6)
        columns |= {f"{foot}_foot_{c}": truth.sign * turned[:, k] for k, c in enumerate(CHANNELS)}
    return columns


def map_text(robot: Robot, truth: Truth) -> str:
    """Return what a user can state about the log, TOML."""
    encoder, step, unknown = np.radians([ENCODER_NOISE, ENCODER_STEP, NOT_LOGGED])
    text = f"""placement = "one"
gravity = {GRAVITY}
columns.time = {{column = "t_s", unit = "s"}}
sensors = {{encoder_sd = {encoder:.6f}, encoder_resolution = {step:.6f}}}
tolerances = {{wrench-origin = {UNKNOWN_PLACE}}}
[constant_joints]
"""
    text += "".join(f'"{name}" = {{value = 0.0, sd = {unknown:.4f}}}\n' for name in truth.constants)
    for side, foot in (("right", robot.stance_foot), ("left", robot.swing_foot)):
        x, y, z = (float(one) for one in sole_point(robot.model, foot))
        text += f"""
[[contacts]]
name = "{side}"
kind = "wrench"
mount = "foot"
channels = ["fx", "fy", "fz", "mx", "my", "mz"]
pose = {{x = {x:.5f}, y = {y:.5f}, z = {z:.5f}, roll = 0.0, pitch = 0.0, yaw = 0.0}}
zero = {np.repeat(ZERO, 3).tolist()}
"""
    return text


def write_record(
    robot: Robot, seed: int, out: Path, not_logged: Sequence[str] = (), soft: bool = False
) -> Truth:
    """Write a new folder of the log `series.csv` and of `MAP.toml`; return what they hide."""
    drawn, moving, reading = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(3))
    truth = draw_truth(robot, drawn, not_logged, soft)
    columns = log(robot, truth, simulate(robot, truth, SECONDS, moving), reading)
    with new_folder(out) as folder:
        table = np.column_stack(list(columns.values()))
        np.savetxt(folder / "series.csv", table, "%.5f", ",", header=",".join(columns), comments="")
        write_text(folder / "MAP.toml", map_text(robot, truth))
    return truth


def _quaternion(turn: np.ndarray) -> np.ndarray:
    return np.roll(Rotation.from_matrix(turn).as_quat(), 1)


def _tipping(robot: Robot) -> float:
    """Return the compliance at which the nominal robot, standing, tips over on its left sole [rad/Nm]."""
    data = mujoco.MjData(robot.model)
    data.qpos = robot.model.key("stand").qpos
    mujoco.mj_kinematics(robot.model, data)
    mujoco.mj_comPos(robot.model, data)
    foot = data.body(robot.swing_foot)
    sole = foot.xpos[2] + foot.xmat[6:] @ sole_point(robot.model, robot.swing_foot)
    return 1 / (robot.model.body_mass.sum() * GRAVITY * (data.subtree_com[1, 2] - sole))


def _in_base(robot: Robot, truth: Truth, angles: np.ndarray) -> np.ndarray:
    """Return the feet's axes in the published root's by readings and CAD, as software does, (n, 2, 3, 3)."""
    model, data, names = robot.model, mujoco.MjData(robot.model), joint_names(robot.model)
    at = [model.joint(name).qposadr[0] for name in names]
    known, out = [name not in truth.constants for name in names], np.empty((len(angles), 2, 3, 3))
    bodies = (robot.stance_foot, robot.swing_foot, model.body(1).name)
    right, left, root = (data.body(name).xmat.reshape(3, 3) for name in bodies)
    mujoco.mj_kinematics(model, data)
    as_published = root.copy()  # at zero angles the world's axes are the file's
    for k, row in enumerate(angles):
        data.qpos[at] = row * known
        mujoco.mj_kinematics(model, data)
        out[k] = as_published @ root.T @ np.stack([right, left])
    return out


def _trajectory(
    robot: Robot, constants: dict[str, float], seconds: float, led: np.ndarray, rng: np.random.Generator
):
    """Return a smooth motion of the nominal robot on its left foot, (n,) [rad] of time [s], as a spline.

    The stance ankle leads its centre of mass over a part of the sole, (2,).

    Raises:
        InputError: no such motion is found.
    """
    model, names = on_left_foot(robot, draw_truth(robot, None)), joint_names(robot.model)
    data, joints = mujoco.MjData(model), [robot.model.joint(name) for name in names]
    at, fixed = [model.joint(name).qposadr[0] for name in names], [names.index(name) for name in constants]
    leg, half = np.argsort(at)[:6], np.ptp(sole_corners(robot.model, robot.swing_foot), axis=0)[:2] / 2
    stand = robot.model.key("stand").qpos[[joint.qposadr[0] for joint in joints]]
    low, high = np.array([j.range if robot.model.jnt_limited[j.id] else (-np.pi, np.pi) for j in joints]).T
    reach = np.where(np.isin(np.arange(len(names)), leg), STANCE_EXCURSION, EXCURSION)
    inside = 0.05 * (high - low)
    ends = np.maximum(low + inside, stand - reach), np.minimum(high - inside, stand + reach)

    def center(angles: np.ndarray) -> np.ndarray:
        data.qpos[at] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        return data.subtree_com[0, :2].copy()

    def balanced(angles: np.ndarray, goal: np.ndarray) -> np.ndarray:
        angles, slopes = angles.copy(), np.empty((2, 2))
        angles[fixed] = list(constants.values())
        for _ in range(4):
            off = center(angles) - goal
            for k, joint in enumerate(leg[:2]):
                slopes[:, k] = (center(angles + 1e-4 * np.eye(len(names))[joint]) - goal - off) / 1e-4
            angles[leg[:2]] -= np.clip(np.linalg.solve(slopes, off), -0.3, 0.3)
        return angles

    def stands(angles: np.ndarray, margin: float) -> bool:
        center(angles)
        other, root = data.body(robot.stance_foot), data.body(robot.model.body(1).name)
        height = other.xpos[2] + other.xmat[6:] @ sole_point(robot.model, robot.stance_foot)
        kept = (low <= angles) & (angles <= high)
        return bool(kept.all() and height > margin and root.xmat[8] > UPRIGHT)

    def drawn(shrunk: float) -> tuple[np.ndarray, np.ndarray]:
        for _ in range(TRIES):
            goal = led * rng.uniform(-half, half)
            angles = balanced(stand + shrunk * (rng.uniform(*ends) - stand), goal)
            if stands(angles, LIFTED):
                return angles, goal
        raise InputError(f"{robot.name}: found no posture on one foot in {TRIES} tries")

    knots, times = np.arange(KNOTS), np.arange(0.0, seconds + 2 * FINE, FINE)
    for shrunk in 0.95 ** np.arange(20):
        path, goal = (CubicSpline(knots, one) for one in zip(*(drawn(shrunk) for _ in knots), strict=True))
        fastest = np.abs(path(np.linspace(0, KNOTS - 1, 50 * KNOTS), 1)).max(axis=1)
        pace = rng.uniform(*SPEED) / np.median(fastest)
        rows = [balanced(path(pace * t), goal(pace * t)) for t in times]
        if all(stands(row, 0.0) for row in rows):
            return CubicSpline(times, np.array(rows))
    raise InputError(f"{robot.name}: found no motion on one foot, expected one with smaller excursions")
