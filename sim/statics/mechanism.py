"""Read the robot's mechanism in a laboratory's scene from the compiled model, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.drives import motor_joint
from tulip_testbed.sim.dynamics.stiction import BREAKAWAY, sliding_friction
from tulip_testbed.sim.model_features import check_features
from tulip_testbed.sim.plates import plate_geometry, short_feet
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names, sole_corners, sole_point
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec
from tulip_testbed.sim.statics.rocking_board import RockingBoard, rocking_board
from tulip_testbed.sim.statics.soft_constraints import Stops, board_compliance, contact_compliance, stops_of

LEVEL = 1e-6  # m, largest difference in height of a sole's corners
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class Joint:
    """A hinge or slide.

    Attributes:
        column: of the coordinates. kind: `HINGE` or `SLIDE`.
        axis, anchor: in its body's frame, (3,).
        zero: coordinate at which it is as the file draws it (`ref`) [rad, m].
    """

    column: int
    kind: int
    axis: np.ndarray
    anchor: np.ndarray
    zero: float


@dataclass(frozen=True)
class Body:
    """A body: index of its parent, pose in the parent's frame, and its joints in order."""

    name: str
    parent: int
    position: np.ndarray
    rotation: np.ndarray
    joints: tuple[Joint, ...]


@dataclass(frozen=True)
class Rope:
    """A spring between points of a body and of the world, without force in a range of lengths [N/m, m]."""

    body: int
    point: np.ndarray
    anchor: np.ndarray
    stiffness: float
    length: tuple[float, float]


@dataclass(frozen=True)
class Mechanism:
    """The mechanism of one laboratory, as far as statics needs it.

    The n coordinates are the angles of hinges and the displacements of slides: the robot's joints and, if the
    rig has them, rotors and sole springs. Body 0 is the torso.

    Attributes:
        bodies: the tree, parents first; the torso's entry has no joints.
        mass, center: mass of every body, (nb,) [kg], and its centre of mass in its frame, (nb, 3) [m].
        gravity: acceleration of gravity, (3,) [m/s2].
        joints: columns of the robot's joints, in the plan's order.
        motors: columns that their servos turn.
        gain, limit: stiffness and torque limit of the servos, by joint, [Nm/rad], [Nm].
        stiffness, rest: springs in single coordinates, (n,) [Nm/rad or N/m], [rad or m].
        springs: fixed tendons as (stiffness, (low, high), coefficients (n,)).
        ropes: springs to the world.
        friction: dry friction of every coordinate, (n,) [Nm].
        stops: limits of the coordinates.
        feet: indices of the bodies of the right and left foot.
        soles: indices of the bodies of the right and left sole.
        sole_points: point of each sole below the ankle, in its body's frame, (2, 3) [m].
        corners: corners of the soles relative to these points, (2, 4, 2) [m].
        sole_friction: coefficient of static friction under each sole, (2,).
        cells: positions of the cells on their plates, (2, 4, 2) [m].
        plate_weight: share of its plate's weight on every cell, (2,) [N].
        top_height: height of the boards' top over the floor [m].
        board_compliance, sole_compliance: compliance of each board on its cells and of each sole on its
            board in height, roll and pitch, about the plate's origin and the sole point, (2, 3, 3).
        rocking: the board of each plate if it has a short foot, (2,).
        names: names of the coordinates.
    """

    bodies: tuple[Body, ...]
    mass: np.ndarray
    center: np.ndarray
    gravity: np.ndarray
    joints: np.ndarray
    motors: np.ndarray
    gain: np.ndarray
    limit: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    springs: tuple[tuple[float, tuple[float, float], np.ndarray], ...]
    ropes: tuple[Rope, ...]
    friction: np.ndarray
    stops: Stops
    feet: tuple[int, int]
    soles: tuple[int, int]
    sole_points: np.ndarray
    corners: np.ndarray
    sole_friction: np.ndarray
    cells: np.ndarray
    plate_weight: np.ndarray
    top_height: float
    board_compliance: np.ndarray
    sole_compliance: np.ndarray
    rocking: tuple[RockingBoard | None, RockingBoard | None]
    names: tuple[str, ...]

    def with_play(self, fraction: float) -> Mechanism:
        """Return the mechanism with this fraction of the springs' free play, about its middle."""
        springs = [
            (k, ((low + high - fraction * (high - low)) / 2, (low + high + fraction * (high - low)) / 2), row)
            for k, (low, high), row in self.springs
        ]
        return replace(self, springs=tuple(springs))

    def subtree(self, body: int) -> list[int]:
        """List a body and all that hang on it."""
        members = [body]
        for number in range(body + 1, len(self.bodies)):
            if self.bodies[number].parent in members:
                members.append(number)
        return members

    @property
    def balanced(self) -> Mechanism:
        """Return the mechanism with boards that rock balanced on their diagonals."""
        right, left = (board and replace(board, balanced=True) for board in self.rocking)
        return replace(self, rocking=(right, left))

    @property
    def tare(self) -> np.ndarray:
        """Return what the cells bear under the empty boards, (8,) [N]."""
        shares = zip(self.rocking, self.plate_weight, strict=True)
        return np.concatenate([board.tare(own) if board else np.full(4, own) for board, own in shares])


def mechanism(rig: Rig) -> Mechanism:
    """Read the mechanism from the rig's scene, compiled with everything that the rig changes.

    Raises:
        InputError: the scene or the protocol has something that statics does not support.
    """
    if not np.isfinite(rig.protocol.speed_gate):
        raise InputError(
            "static equilibrium: found a robot read before it is at rest (speed_gate inf), expected a finite "
            "gate; use the full dynamics"
        )
    nominal = rig.robot.model
    spec = laboratory_scene(rig, np.zeros((2, 3)))
    model = compile_spec(spec, str(rig.robot.path))
    check_features(model, "static equilibrium")
    for foot in rig.robot.feet:
        heights = [model.geom(f"{foot}_{corner}").pos[2] for corner in CORNERS]
        if (gap := np.ptp(heights)) > LEVEL:
            raise InputError(
                f"static equilibrium: foot '{foot}': found sole corners at heights that differ by "
                f"{1e3 * gap:.3g} mm, expected one height; such a foot rocks: use the full dynamics"
            )
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
    root = int(model.jnt_bodyid[free])
    members = [b for b in range(1, model.nbody) if model.body_rootid[b] == root]
    number = {body: k for k, body in enumerate(members)}
    turning = [j for j in range(model.njnt) if model.jnt_bodyid[j] in number and j != free]
    column = {j: k for k, j in enumerate(turning)}
    names = joint_names(nominal)
    joints = np.array([column[model.joint(name).id] for name in names])
    motors = [model.joint(motor_joint(model, name)).id for name in names]
    servos = [_servo(model, motor) for motor in motors]
    feet = [model.body(foot).id for foot in rig.robot.feet]
    soles = [int(model.geom(f"{foot}_{CORNERS[0]}").bodyid[0]) for foot in rig.robot.feet]
    plates = [model.body(f"{plate}_plate").id for plate in PLATES]
    sites = [[model.site(f"{plate}_plate_{corner}").id for corner in CORNERS] for plate in PLATES]
    weight = np.array([-model.body_subtreemass[plate] * model.opt.gravity[2] / 4 for plate in plates])
    top = [plate_geometry(spec, plate).top_height for plate in PLATES]
    dofs = np.array([model.jnt_dofadr[j] for j in turning])
    cells = np.array([[_on_plate(model, s, p) for s in row] for row, p in zip(sites, plates, strict=True)])
    corners = np.array([sole_corners(nominal, foot)[:, :2] for foot in rig.robot.feet])
    springs, ropes = _tendons(model, number, column, root)
    rocking = [rocking_board(*plate) for plate in zip(cells, short_feet(model), strict=True)]
    return Mechanism(
        bodies=tuple(_body(model, body, number, column) for body in members),
        mass=model.body_mass[members].copy(),
        center=model.body_ipos[members].copy(),
        gravity=model.opt.gravity.copy(),
        joints=joints,
        motors=np.array([column[motor] for motor in motors]),
        gain=model.actuator_gainprm[servos, 0].copy(),
        limit=model.actuator_forcerange[servos, 1].copy(),
        stiffness=model.jnt_stiffness[turning].reshape(len(turning), -1)[:, 0].copy(),
        rest=np.array([model.qpos_spring[model.jnt_qposadr[j]] for j in turning]),
        springs=springs,
        ropes=ropes,
        friction=model.dof_frictionloss[dofs].copy(),
        stops=stops_of(model, turning, dofs),
        feet=(number[feet[0]], number[feet[1]]),
        soles=(number[soles[0]], number[soles[1]]),
        sole_points=np.array(
            [
                _in_body(model, sole, foot, sole_point(nominal, foot))
                for sole, foot in zip(soles, rig.robot.feet, strict=True)
            ]
        ),
        corners=corners,
        sole_friction=np.array(
            [BREAKAWAY * sliding_friction(model, pair) for pair in zip(soles, plates, strict=True)]
        ),
        cells=cells,
        plate_weight=weight,
        top_height=float(top[0] if np.ptp(top) == 0 else np.nan),
        board_compliance=np.array(
            [
                board_compliance(
                    cells[k],
                    rig.compliance.cell + contact_compliance(model, f"{plate}_plate_{CORNERS[0]}", None),
                )
                for k, plate in enumerate(PLATES)
            ]
        ),
        sole_compliance=np.array(
            [
                board_compliance(
                    corners[k], contact_compliance(model, f"{foot}_{CORNERS[0]}", f"{PLATES[k]}_plate_top")
                )
                for k, foot in enumerate(rig.robot.feet)
            ]
        ),
        rocking=(rocking[0], rocking[1]),
        names=tuple(model.joint(j).name for j in turning),
    )


def _body(model: mujoco.MjModel, body: int, number: dict[int, int], column: dict[int, int]) -> Body:
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joints = [
        Joint(
            column[j],
            int(model.jnt_type[j]),
            model.jnt_axis[j].copy(),
            model.jnt_pos[j].copy(),
            float(model.qpos0[model.jnt_qposadr[j]]),
        )
        for j in range(first, first + count)
        if j in column
    ]
    if odd := [
        model.joint(j).name
        for j in range(first, first + count)
        if j in column and model.jnt_type[j] not in (HINGE, SLIDE)
    ]:
        raise InputError(f"static equilibrium: found joints {listed(odd)} that are neither hinge nor slide")
    return Body(
        name=model.body(body).name,
        parent=number.get(int(model.body_parentid[body]), -1),
        position=model.body_pos[body].copy(),
        rotation=_matrix(model.body_quat[body]),
        joints=tuple(joints),
    )


def _tendons(model, number, column, root):
    """Return fixed tendons with springs, and spatial tendons from the robot to the world as ropes."""
    springs, ropes = [], []
    for t in range(model.ntendon):
        name, stiffness = model.tendon(t).name, float(np.ravel(model.tendon_stiffness[t])[0])
        low, high = (float(x) for x in model.tendon_lengthspring[t])
        first, count = int(model.tendon_adr[t]), int(model.tendon_num[t])
        kinds = model.wrap_type[first : first + count]
        objects, coefficients = model.wrap_objid[first : first + count], model.wrap_prm[first : first + count]
        if (kinds == mujoco.mjtWrap.mjWRAP_JOINT).all():
            row = np.zeros(len(column))
            for j, c in zip(objects, coefficients, strict=True):
                row[column[int(j)]] = c
            springs.append((stiffness, (low, high), row))
            continue
        bodies = (
            model.site_bodyid[objects] if (kinds == mujoco.mjtWrap.mjWRAP_SITE).all() and count == 2 else []
        )
        inside = [k for k, b in enumerate(bodies) if int(b) in number]
        outside = [k for k, b in enumerate(bodies) if int(b) == 0]
        if len(inside) != 1 or len(outside) != 1:
            raise InputError(
                f"static equilibrium: tendon '{name}': "
                "expected joints, or one site on the robot and one in the world"
            )
        site, anchor = int(objects[inside[0]]), int(objects[outside[0]])
        ropes.append(
            Rope(
                number[int(model.site_bodyid[site])],
                model.site_pos[site].copy(),
                model.site_pos[anchor].copy(),
                stiffness,
                (low, high),
            )
        )
    return tuple(springs), tuple(ropes)


def _in_body(model: mujoco.MjModel, sole: int, foot: str, point: np.ndarray) -> np.ndarray:
    """Return a point of a foot in the frame of its sole, which is the foot or a body below it."""
    if sole == model.body(foot).id:
        return point
    return point - model.body_pos[sole]


def _on_plate(model: mujoco.MjModel, site: int, plate: int) -> np.ndarray:
    body = int(model.site_bodyid[site])
    place = model.site_pos[site] if body == plate else model.body_pos[body] + model.site_pos[site]
    return place[:2]


def _servo(model: mujoco.MjModel, joint: int) -> int:
    return next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == joint)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
