"""A rig and a plan whose postures are solved once, for many runs by statics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.measurements import MeasurementHeader, PosturePlan
from tulip_testbed.measurements.data import base_foot, feet_in_contact
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.plan_folder import check_support
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig, stages
from tulip_testbed.sim.robot import rotation_matrices
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.statics.forces import Load, StaticState
from tulip_testbed.sim.statics.mechanism import Mechanism
from tulip_testbed.sim.statics.read_mechanism import read_mechanism
from tulip_testbed.sim.statics.solve import Reference, solve_by_newton, solve_near


@dataclass(frozen=True)
class SolvedPlan:
    """A rig and a plan, with everything that is the same in all runs.

    Attributes:
        reference: solved planned postures, batch (postures,).
        boards: intended poses of the boards, by placement, (placements, 2, 3) [m, m, rad].
        placement: index of every posture's placement, (postures,).
        links: indices of the robot's bodies in the mechanism, in MJCF order, (n_links,).
        header: of the measurements.
        later: start, as a fraction of the experiment's time, and solved plan of each later rig.
    """

    rig: Rig
    plan: PosturePlan
    mechanism: Mechanism
    reference: Reference
    boards: np.ndarray
    placement: np.ndarray
    links: np.ndarray
    header: MeasurementHeader
    later: tuple[tuple[float, SolvedPlan], ...] = ()


def solve_plan(rig: Rig, plan: PosturePlan, near: SolvedPlan | None = None) -> SolvedPlan:
    """Solve every posture of a plan once, as planned.

    Args:
        near: the same plan in a similar rig, from whose equilibria the search begins; the result is the same
            but for rounding.
    """
    first, *others = stages(rig)
    later = tuple((start, _solve_plan(one, plan, near)) for start, one in others)
    return replace(_solve_plan(first[1], plan, near), rig=rig, later=later)


def _solve_plan(rig: Rig, plan: PosturePlan, near: SolvedPlan | None) -> SolvedPlan:
    check_support("plan", plan)
    m, model = read_mechanism(rig), rig.robot.model
    placements, placement = np.unique(plan.placement, return_inverse=True)
    first = [int(np.flatnonzero(plan.placement == number)[0]) for number in placements]
    boards = boards_under(rig, plan.foot_poses[first])
    load = Load(
        command=plan.joint_angles + plan.feed_forward / m.gain,
        friction=np.zeros(len(m.names)),
        feet=plan.foot_poses,
        plates=boards[placement],
        mass=m.mass,
        center=m.center,
        foot_contact=feet_in_contact(plan.support),
    )
    start = _start(rig, m, plan)
    if near is None or near.mechanism.names != m.names:
        reference = solve_by_newton(m, start, load)
    else:
        reference = solve_near(m, near.reference, start, load)
    names = [body.name for body in m.bodies]
    links = np.array([names.index(model.body(k).name) for k in range(1, model.nbody)])
    return SolvedPlan(rig, plan, m, reference, boards, placement, links, header_of(rig))


def feet_in_base(poses: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Return the poses of right and left foot in the base frame from those in the world, (m, 2, 3)."""
    every, base = np.arange(len(poses)), base_foot(support)
    x, y, yaw = (poses[every, 1 - base] - poses[every, base]).T
    c, s = np.cos(poses[every, base, 2]), np.sin(poses[every, base, 2])
    feet = np.zeros_like(poses)
    feet[every, 1 - base] = np.column_stack([c * x + s * y, c * y - s * x, yaw])
    return feet


def standard_parameters_of(solved_plan: SolvedPlan) -> np.ndarray:
    """Return the standard parameters of the robot in the rig's scene, (n_links, 4) [kg, kg m]."""
    m = solved_plan.mechanism
    mass = m.mass[solved_plan.links]
    return np.column_stack([mass, mass[:, None] * m.center[solved_plan.links]])


def _start(rig: Rig, m: Mechanism, plan: PosturePlan) -> StaticState:
    """Return the planned postures with the weight shared equally by the feet in contact."""
    chain = ClosedChain(rig.robot.model, rig.robot)
    base = base_foot(plan.support).tolist()
    pose = np.array([chain.base_pose(*each) for each in zip(plan.joint_angles, base, strict=True)])
    angles = np.zeros((len(pose), len(m.names)))
    angles[:, m.motors] = plan.joint_angles
    angles[:, m.joints] = plan.joint_angles
    share = feet_in_contact(plan.support) / feet_in_contact(plan.support).sum(axis=1)[:, None]
    wrench = np.zeros((len(pose), 2, 6))
    wrench[:, :, :3] = -share[:, :, None] * m.gravity * m.mass.sum()
    return StaticState(pose[:, :3], rotation_matrices(pose[:, 3:]), angles, wrench)
