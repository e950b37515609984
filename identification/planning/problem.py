"""The planning problem: nominal kinematics, masses, drives, soles and ranges of a robot, as arrays."""

from dataclasses import dataclass, fields
from itertools import pairwise, product

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import BaseParameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations, moved_frames, walk
from tulip_testbed.identification.link_clearances import (
    LinkPairs,
    link_pairs,
    reference_posture,
    segment_distances,
)
from tulip_testbed.identification.nominal import Nominal, nominal_robot, outline
from tulip_testbed.identification.planning_ranges import (
    Margins,
    PlanningRanges,
    leg_length,
    planning_margins,
    planning_ranges,
)
from tulip_testbed.measurements import PlateGeometry
from tulip_testbed.sim.control import torque_limits
from tulip_testbed.sim.random_robots import half_edges
from tulip_testbed.sim.robot import Robot, between_feet, rotation_matrices

CLOSING = 12  # joints between the feet, as many as the equations of swing foot, torso and CoM
Limb = tuple[int, int, float]
Leg = tuple[Limb, ...]
# Of the leg's length, between joint centres; shorter links lie inside their neighbours' capsules.
LEAST_LIMB = 0.155


@dataclass(frozen=True)
class PlanningProblem(Nominal):
    """A nominal robot as the optimisation of postures needs it; n joints, f frames, p base parameters.

    Attributes:
        ranges, margins, plate: ranges, margins and plate geometry that define the constraints.
        between: joints between the feet, which inverse kinematics determines, (12,).
        torques: torque limits of the drives, (n,) [N m]; infinite if the robot's file has none.
        masses, centers: mass of every frame, (f,) [kg], and its centre of mass in the frame, (f, 3) [m].
        gravity: acceleration of gravity [m/s2].
        torso: frame number.
        moved: frames that each joint moves relative to the stance foot, (n, f) bool.
        upstream: whether joint i carries joint j, (n, n) bool.
        parameter_covariance: covariance of the nominal base parameters, (p, p) [m2].
        limbs: limbs of the two legs as pairs of frames and radii [m], at least two per leg.
        legs: frames at hip and ankle, and their distance with a straight knee [m].
        pairs: pairs of links that must keep a distance.
        side: +1 if the swing foot is the left one, -1 if it is the right one.
    """

    ranges: PlanningRanges
    margins: Margins
    plate: PlateGeometry
    between: np.ndarray
    torques: np.ndarray
    masses: np.ndarray
    centers: np.ndarray
    gravity: float
    torso: int
    moved: np.ndarray
    upstream: np.ndarray
    parameter_covariance: np.ndarray
    limbs: tuple[Leg, Leg]
    legs: tuple[Limb, ...]
    pairs: LinkPairs
    side: float = 1.0

    @property
    def weight(self) -> float:
        """Return the weight of the robot [N]."""
        return float(self.masses.sum() * self.gravity)


def planning_problem(
    robot: Robot,
    plate: PlateGeometry,
    ranges: PlanningRanges | None = None,
    margins: Margins | None = None,
    support: str = "double",
) -> PlanningProblem:
    """Read the planning problem of a support, see `base_parameters`, from the robot's files.

    Without ranges or margins they are those of the robot's description.
    """
    model, margins = robot.model, margins or planning_margins(robot)
    nominal = nominal_robot(robot, support)
    parameters = nominal.parameters
    tree, base = parameters.tree, parameters.base
    between = np.flatnonzero(between_feet(model, robot))
    if len(between) != CLOSING:
        raise InputError(
            f"{robot.model_file}: found {len(between)} joints between the feet, expected {CLOSING} "
            "(six a leg) to optimise postures"
        )
    frames, standard = np.array(tree.frame_of_link), standard_parameters(model)
    masses, centers = np.zeros(len(tree.frames)), np.zeros((len(tree.frames), 3))
    masses[frames], centers[frames] = standard[:, 0], model.body_ipos[1:]
    moved = moved_frames(tree, base)
    outer = {step.edge.joint: step.new for step in walk(tree, base) if step.edge.joint >= 0}
    carried = moved[:, [outer[j] for j in range(len(tree.joints))]]
    limbs, legs = _limbs(model, robot, parameters)
    limbs = _slim(limbs, robot, parameters, margins.leg_clearance)
    return PlanningProblem(
        **{field.name: getattr(nominal, field.name) for field in fields(nominal)},
        ranges=ranges or planning_ranges(robot),
        margins=margins,
        plate=plate,
        between=between,
        torques=torque_limits(robot),
        masses=masses,
        centers=centers,
        gravity=float(-model.opt.gravity[2]),
        torso=frames[0],
        moved=moved,
        upstream=carried & ~np.eye(len(carried), dtype=bool),
        parameter_covariance=_parameter_covariance(model, parameters, standard, margins.mass_sd),
        limbs=limbs,
        legs=legs,
        pairs=link_pairs(robot, margins.link_clearance),
    )


def _parameter_covariance(
    model: mujoco.MjModel, parameters: BaseParameters, standard: np.ndarray, relative: float
) -> np.ndarray:
    """Propagate the covariance of masses and centres of mass to the base parameters, linearised."""
    mass, half = standard[:, 0], half_edges(model)
    total = mass.sum()
    by_standard = parameters.from_standard.reshape(-1, len(mass), 4) / total
    by_mass = by_standard[..., 0] + (by_standard[..., 1:] * model.body_ipos[1:]).sum(axis=2)
    by_mass = by_mass - (parameters.values(standard) / total)[:, None]
    columns = [relative * mass * by_mass]
    for link, turn in enumerate(rotation_matrices(model.body_iquat[1:])):
        columns.append(by_standard[:, link, 1:] @ turn * (relative * mass[link] * half[link]))
    root = np.column_stack(columns)
    return root @ root.T


def _limbs(
    model: mujoco.MjModel, robot: Robot, parameters: BaseParameters
) -> tuple[tuple[Leg, Leg], tuple[Limb, ...]]:
    """Return the limbs of each leg alone that are long enough to collide, and the whole legs.

    Links that both legs hang from, as below a waist, are part of neither. A limb is a capsule between the
    origins of its own and of the next frame; its radius is the reach of its shape to the side.
    """
    tree = parameters.tree
    rotations = link_rotations(tree, tree.frame_of_link[0], np.zeros((1, len(tree.joints))))
    places = frame_positions(tree, tree.frame_of_link[0], rotations, np.zeros(3))[0]
    before = {step.new: step.known for step in walk(tree, tree.frame_of_link[0])}
    ways = [[tree.frame(foot)] for foot in robot.feet]  # from each foot to the free body
    for way in ways:
        while way[-1] in before:
            way.append(before[way[-1]])
    shared, least = set(ways[0]) & set(ways[1]), LEAST_LIMB * leg_length(robot)
    limbs, legs = [], []
    for way in ways:
        leg, length = [], 0.0
        for frame, parent in pairwise(way):
            long = float(np.linalg.norm(places[frame] - places[parent]))
            if parent not in shared and long >= least:
                link = tree.frame_of_link.index(parent)
                along = (places[frame] - places[parent]) / long
                side = np.array([0.0, 1.0, 0.0]) - along[1] * along
                side = rotations[0, parent].T @ side / np.linalg.norm(side)
                leg.append((parent, frame, float(np.abs(outline(model, link + 1) @ side).max())))
                length += long
        limbs.append(tuple(leg))
        if len(leg) > 1:
            legs.append((leg[-1][0], leg[0][1], length))
    return (limbs[0], limbs[1]), tuple(legs)


def _slim(
    limbs: tuple[Leg, Leg], robot: Robot, parameters: BaseParameters, clearance: float
) -> tuple[Leg, Leg]:
    """Return limbs no thicker than leaves the legs apart in the reference posture; link shapes say the rest.

    A capsule around a link that is not straight is much thicker than the link.
    """
    tree = parameters.tree
    rotations = link_rotations(tree, tree.frame_of_link[0], reference_posture(robot)[None])
    places = frame_positions(tree, tree.frame_of_link[0], rotations, np.zeros(3))
    share = [np.ones(len(leg)) for leg in limbs]
    for (i, (a, b, first)), (k, (c, d, second)) in product(*(list(enumerate(leg)) for leg in limbs)):
        apart = segment_distances(places[:, [a, b]], places[:, [c, d]])[0] - 2 * clearance
        fits = max(apart, 0.0) / max(first + second, 1e-9)
        share[0][i], share[1][k] = min(share[0][i], fits), min(share[1][k], fits)
    right, left = (
        tuple((a, b, radius * float(part)) for (a, b, radius), part in zip(leg, parts, strict=True))
        for leg, parts in zip(limbs, share, strict=True)
    )
    return right, left
