"""The planning problem: nominal kinematics, masses, drives, soles and ranges of a robot, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, moved_frames, walk
from tulip_testbed.identification.nominal import link_boxes
from tulip_testbed.identification.postures import PlanningRanges, planning_ranges
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import PlateGeometry
from tulip_testbed.sim.robot import Robot, between_feet, sole_corners, sole_point

CLOSING = 12  # joints between the feet, as many as the equations of swing foot, torso and CoM
Limb = tuple[int, int, float]
Leg = tuple[Limb, ...]
LEAST_LIMB = 0.1  # m, between joint centres; shorter links lie inside their neighbours' capsules


@dataclass(frozen=True)
class Margins:
    """Margins in addition to the planning ranges.

    Attributes:
        mass_sd: s.d. of every link's mass relative to the nominal one, and of its centre of mass relative to
            the half edges of its inertia box, all independent [-].
        assurance: number of standard deviations of the centre of mass that every edge of the support
            polygon keeps in addition to d_s; 1.645 means 95 % probability for each edge [-].
        torque_share: largest predicted holding torque relative to the drive's limit [-].
        foot_load: smallest load of each foot [N].
        foot_moment: s.d. of each foot's tilting moment about its prediction, by dry friction and tracking
            errors in a stiff closed chain; soles keep it with the same assurance [N m]. TULip's drives (0.8
            of their dry friction, command errors of 0.5 mrad) give 0.5 about x and 0.6 about y.
        board: distance between a sole and the edge of its board, since boards are laid with errors of some
            millimetres and a corner beyond the edge carries no load [m].
        joint: distance from both ends of a joint's range, since a joint at its stop takes load from the feet
            [rad].
        stretch: shortening of the distance from hip to ankle relative to a straight leg; straight knees are
            singular, and paths between such postures may be out of reach [-].
        leg_clearance: distance between the capsules around the limbs of the two legs [m].
        rounding: distance from every bound in the constraint's own scale, so that rounding by solver and
            file format violates none [-].
    """

    mass_sd: float = 0.10
    assurance: float = 1.645
    torque_share: float = 0.85
    foot_load: float = 25.0
    foot_moment: float = 0.55
    board: float = 0.01
    joint: float = 0.002
    stretch: float = 0.01
    leg_clearance: float = 0.01
    rounding: float = 1e-5


@dataclass(frozen=True)
class Problem:
    """A robot as the optimisation of postures needs it; n joints, f frames, p base parameters.

    Attributes:
        ranges, margins, plate: ranges, margins and plate geometry that define the constraints.
        between: joints between the feet, which inverse kinematics determines, (12,).
        limits: ranges of all joints, (n, 2) [rad].
        torques: torque limits of the drives, (n, 2) [N m]; infinite if the robot's file has none.
        mass, center: mass of every frame, (f,) [kg], and its centre of mass in the frame, (f, 3) [m].
        gravity: acceleration of gravity [m/s2].
        soles: corners of the stance and the swing sole in their feet's frames, (2, 4, 2) [m].
        points: sole points below both ankles in the feet's frames, (2, 3) [m].
        swing, torso: frame numbers.
        moved: frames that each joint moves relative to the stance foot, (n, f) bool.
        upstream: whether joint i carries joint j, (n, n) bool.
        parameter_covariance: covariance of the nominal base parameters, (p, p) [m2].
        limbs: limbs of the two legs as pairs of frames and radii [m], at least two per leg.
        legs: frames at hip and ankle, and their distance with a straight knee [m].
        nominal: nominal base parameters, (p,) [m].
    """

    robot: Robot
    parameters: BaseParameters
    ranges: PlanningRanges
    margins: Margins
    plate: PlateGeometry
    between: np.ndarray
    limits: np.ndarray
    torques: np.ndarray
    mass: np.ndarray
    center: np.ndarray
    gravity: float
    soles: np.ndarray
    points: np.ndarray
    swing: int
    torso: int
    moved: np.ndarray
    upstream: np.ndarray
    parameter_covariance: np.ndarray
    limbs: tuple[Leg, Leg]
    legs: tuple[Limb, ...]
    nominal: np.ndarray

    @property
    def weight(self) -> float:
        """Return the weight of the robot [N]."""
        return float(self.mass.sum() * self.gravity)


def planning_problem(
    robot: Robot,
    plate: PlateGeometry,
    ranges: PlanningRanges | None = None,
    margins: Margins | None = None,
    support: str = "double",
) -> Problem:
    """Read the planning problem from the robot's files.

    Args:
        robot: the robot.
        plate: geometry of the boards.
        ranges: planning ranges; None means those of the robot's description.
        margins: margins; None means the defaults.
        support: support whose base parameters are optimised, see `base_parameters`.

    Raises:
        InputError: the files are broken, or a leg has other than six joints.
    """
    model, margins = robot.model, margins or Margins()
    parameters = base_parameters(robot, model, support)
    tree, base = parameters.tree, parameters.base
    between = np.flatnonzero(between_feet(model, robot))
    if len(between) != CLOSING:
        raise InputError(
            f"{robot.model_file}: found {len(between)} joints between the feet, expected {CLOSING} "
            "(six a leg) to optimise postures"
        )
    frames, standard = np.array(tree.frame_of_link), standard_parameters(model)
    mass, center = np.zeros(len(tree.frames)), np.zeros((len(tree.frames), 3))
    mass[frames], center[frames] = standard[:, 0], model.body_ipos[1:]
    moved = moved_frames(tree, base)
    outer = {step.edge.joint: step.new for step in walk(tree, base) if step.edge.joint >= 0}
    carried = moved[:, [outer[j] for j in range(len(tree.joints))]]
    limits = torque_limits(robot)
    torques = np.column_stack([-limits, limits])
    limbs, legs = _limbs(model, robot, parameters)
    return Problem(
        robot=robot,
        parameters=parameters,
        ranges=ranges or planning_ranges(robot),
        margins=margins,
        plate=plate,
        between=between,
        limits=tree.joint_range,
        torques=torques,
        mass=mass,
        center=center,
        gravity=float(-model.opt.gravity[2]),
        soles=np.array([sole_corners(model, foot)[:, :2] for foot in robot.feet]),
        points=np.array([sole_point(model, foot) for foot in robot.feet]),
        swing=tree.frame(robot.swing_foot),
        torso=frames[0],
        moved=moved,
        upstream=carried & ~np.eye(len(carried), dtype=bool),
        parameter_covariance=_parameter_covariance(model, parameters, standard, margins.mass_sd),
        limbs=limbs,
        legs=legs,
        nominal=parameters.values(standard),
    )


def _parameter_covariance(
    model: mujoco.MjModel, parameters: BaseParameters, standard: np.ndarray, relative: float
) -> np.ndarray:
    """Propagate the covariance of masses and centres of mass to the base parameters, linearised."""
    mass, inertia = standard[:, 0], model.body_inertia[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        squares = 1.5 * (inertia.sum(axis=1, keepdims=True) - 2 * inertia) / mass[:, None]
    half = np.sqrt(np.maximum(np.where(mass[:, None] > 0, squares, 0.0), 0.0))
    total = mass.sum()
    by_standard = parameters.from_standard.reshape(-1, len(mass), 4) / total
    by_mass = by_standard[..., 0] + (by_standard[..., 1:] * model.body_ipos[1:]).sum(axis=2)
    by_mass = by_mass - (parameters.values(standard) / total)[:, None]
    columns = [relative * mass * by_mass]
    for link, quaternion in enumerate(model.body_iquat[1:]):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quaternion)
        columns.append(by_standard[:, link, 1:] @ turn.reshape(3, 3) * (relative * mass[link] * half[link]))
    root = np.column_stack(columns)
    return root @ root.T


def _limbs(
    model: mujoco.MjModel, robot: Robot, parameters: BaseParameters
) -> tuple[tuple[Leg, Leg], tuple[Limb, ...]]:
    """Return the limbs between torso and feet that are long enough to collide, and the whole legs.

    A limb is a capsule between the origins of its own and of the next frame; its radius is the lateral
    extent of its box.
    """
    tree = parameters.tree
    rotations = link_rotations(tree, tree.frame_of_link[0], np.zeros((1, len(tree.joints))))
    places = frame_positions(tree, tree.frame_of_link[0], rotations, np.zeros(3))[0]
    before = {step.new: step.known for step in walk(tree, tree.frame_of_link[0])}
    boxes = link_boxes(model)
    limbs, legs = [], []
    for foot in robot.feet:
        leg, length, frame = [], 0.0, tree.frame(foot)
        while frame in before:
            parent = before[frame]
            long = float(np.linalg.norm(places[frame] - places[parent]))
            if parent in before and long >= LEAST_LIMB:
                link = tree.frame_of_link.index(parent)
                leg.append((parent, frame, float(np.abs(boxes[link, :, 1]).max())))
                length += long
            frame = parent
        limbs.append(tuple(leg))
        if len(leg) > 1:
            legs.append((leg[-1][0], leg[0][1], length))
    return (limbs[0], limbs[1]), tuple(legs)
