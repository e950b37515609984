"""The planning problem: nominal kinematics, masses, drives, soles and ranges of a robot, as arrays."""

from dataclasses import dataclass, fields
from itertools import pairwise

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.base_parameters import BaseParameters, standard_parameters
from tulip_testbed.identification.kinematics import Tree, frame_positions, link_rotations, moved_frames, walk
from tulip_testbed.identification.link_clearances import LinkPairs, link_pairs
from tulip_testbed.identification.nominal import Nominal, nominal_robot
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
Leg = tuple[int, int, float]
LEAST_LIMB = 0.155  # of the leg's length, between joint centres; shorter links are part of a hip or an ankle


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
    legs: tuple[Leg, ...]
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
        legs=_legs(robot, tree),
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


def _legs(robot: Robot, tree: Tree) -> tuple[Leg, ...]:
    """Return the legs of two long links or more, from the hip, which the other leg does not share."""
    rotations = link_rotations(tree, tree.frame_of_link[0], np.zeros((1, len(tree.joints))))
    places = frame_positions(tree, tree.frame_of_link[0], rotations, np.zeros(3))[0]
    before = {step.new: step.known for step in walk(tree, tree.frame_of_link[0])}
    ways = [[tree.frame(foot)] for foot in robot.feet]  # from each foot to the free body
    for way in ways:
        while way[-1] in before:
            way.append(before[way[-1]])
    shared, least = set(ways[0]) & set(ways[1]), LEAST_LIMB * leg_length(robot)
    legs = []
    for way in ways:
        length = {pair: float(np.linalg.norm(places[pair[0]] - places[pair[1]])) for pair in pairwise(way)}
        long = [pair for pair in length if pair[1] not in shared and length[pair] >= least]
        if len(long) > 1:
            legs.append((long[-1][1], long[0][0], sum(length[pair] for pair in long)))
    return tuple(legs)
