"""Draw random feasible postures (section IV, steps 1 to 5)."""

import dataclasses
from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, most_frequent
from tulip_testbed.identification.feasibility import (
    boards_fit,
    foot_clearance,
    place_polygon,
    planned_foot_loads,
    predicted_cell_loads,
    predicted_foot_loads,
    stability_margin,
    support_polygon,
)
from tulip_testbed.identification.inverse_kinematics import InverseKinematics
from tulip_testbed.identification.link_clearances import LinkPairs, clearances_at, link_pairs, moving_pairs
from tulip_testbed.identification.link_paths import blocked, too_near
from tulip_testbed.identification.planning_ranges import (
    Margins,
    PlanningRanges,
    Range,
    free_joint_ranges,
    planning_margins,
    planning_ranges,
)
from tulip_testbed.measurements import PlateGeometry, PosturePlan, lay_boards
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import Robot, between_feet, joint_names, joint_ranges, sole_corners, standing

ATTEMPTS = 3000  # without a feasible posture, after which the ranges are considered infeasible
REDRAWS = 100  # of the joints that are not between the feet, for one posture
ATTEMPTS_HERE = 200  # for the next posture of a placement, after which the placement is given up


def random_postures(
    robot: Robot,
    plate: PlateGeometry,
    placements: int,
    per_placement: int,
    seed: int,
    ranges: PlanningRanges | None = None,
    progress: Callable[[int], None] = lambda count: None,
    margins: Margins | None = None,
) -> PosturePlan:
    """Draw feasible postures, `per_placement` on each of `placements` foot placements.

    Without ranges or margins they are those of the robot's description. Each time a placement is complete,
    `progress` is called with the number of its postures.
    """
    model = robot.model
    ranges, margins = ranges or planning_ranges(robot), margins or planning_margins(robot)
    search = _Search(robot, plate, ranges, margins, np.random.default_rng(seed))
    angles, poses = [], []
    while len(angles) < placements * per_placement:
        found = search.placement(per_placement)
        progress(len(found))
        angles += [q for q, _ in found]
        poses += [pose for _, pose in found]
    count = len(angles)
    return PosturePlan(
        joints=joint_names(model),
        joint_angles=np.array(angles),
        posture=np.arange(1, count + 1),
        placement=np.repeat(np.arange(1, placements + 1), per_placement),
        support=np.full(count, "double"),
        swing_pose=np.array(poses),
        robot={"model": robot.model_file.name, "sha256": robot.model_hash},
        made={
            "objective": "random",
            "seed": seed,
            "placements": placements,
            "per_placement": per_placement,
            "ranges": dataclasses.asdict(search.ranges),
            "attempts": search.attempts,
            "rejected": dict(search.rejected),
        },
    )


class _Search:
    def __init__(
        self,
        robot: Robot,
        plate: PlateGeometry,
        ranges: PlanningRanges,
        margins: Margins,
        rng: np.random.Generator,
    ):
        model = robot.model
        self.ranges, self.rng, self.plate, self.model = ranges, rng, plate, model
        self.solver = InverseKinematics(robot, model)
        self.corners = [sole_corners(model, foot)[:, :2] for foot in robot.feet]
        self.names, self.limits = joint_names(model), joint_ranges(model)
        self.free_joints = free_joint_ranges(robot, model, ranges)
        self.weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
        self.guess = standing(model)
        self.chain = ClosedChain(model, robot)
        self.pairs = link_pairs(robot, margins.link_clearance)
        # Whatever joints between the feet do not move is known before inverse kinematics.
        self.fixed = self.pairs.take(~moving_pairs(self.pairs, between_feet(model, robot)))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        ground = _lowest_sole(model, data, robot)
        upright, highest = data.body(self.solver.torso).xpos[2] - ground, data.subtree_com[0, 2] - ground
        # From straight legs down to the least height of the hip; inverse kinematics decides on reachability.
        self.com_height = (highest - max(upright - ranges.least_height, 0.0), highest)
        self.rejected: Counter[str] = Counter()
        self.attempts = self.found = 0

    def placement(self, wanted: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Carry out steps 1 to 5 for one placement: pairs of joint angles and swing foot pose."""
        while True:
            r = self.ranges
            pose = np.array([self._draw(x) for x in (r.swing_x, r.swing_y, r.swing_yaw)])
            soles = np.array([self.corners[0], place_polygon(self.corners[1], pose)])
            if why := self._lay_boards(soles):
                self._reject(why)
                continue
            accepted, tries = [], 0
            while len(accepted) < wanted:
                found = self._try(pose, soles, accepted[-1][0] if accepted else None)  # steps 3 and 4
                if isinstance(found, str):
                    self._reject(found)
                    tries += 1
                    if not accepted or tries > ATTEMPTS_HERE:
                        break  # back to step 1
                else:
                    self.attempts += 1
                    self.found += 1
                    tries = 0
                    accepted.append((found, pose))
            if len(accepted) == wanted:
                return accepted

    def _lay_boards(self, soles: np.ndarray) -> str | None:
        """Lay the boards under the soles, or return the violated constraint."""
        if foot_clearance(*soles) <= max(self.ranges.foot_clearance, 1e-9):
            return "foot clearance"
        self.boards = lay_boards(soles, self.plate.size, self.ranges.plate_gap)
        return None if boards_fit(soles, self.boards, self.plate) else "boards do not carry the feet"

    def _try(self, pose: np.ndarray, soles: np.ndarray, before: np.ndarray | None) -> np.ndarray | str:
        """Return the joint angles of one random draw after those of `before`, or the violated constraint."""
        r = self.ranges
        polygon = support_polygon(soles)
        com = self.rng.uniform(polygon.min(axis=0), polygon.max(axis=0))
        height = self._draw(self.com_height)
        rpy = np.array([self._draw(x) for x in (r.torso_roll, r.torso_pitch, r.torso_yaw)])
        if stability_margin(com, polygon) < r.stability_margin:
            return "stability margin"
        share, cop = predicted_foot_loads(com, np.array([np.zeros(2), pose[:2]]))
        # Without feed-forward the feet's loads follow neither model, so that both keep the margin.
        centers = soles.mean(axis=1)
        _, planned = planned_foot_loads(self.weight, com[None], *centers[:, None])
        for points in (cop, planned[0]):
            if min(map(stability_margin, points, map(support_polygon, soles))) < r.sole_margin:
                return "a sole would lift"
        if predicted_cell_loads(share, cop, self.boards, self.plate, self.weight).min() < r.least_cell_load:
            return "a cell would unload"
        guess, links = self._free_joints()
        if links:
            return f"self-collision {links}"
        angles = self.solver.solve(pose, np.array([*com, height]), rpy, guess)
        if angles is None:
            return "out of reach"
        outside = (angles < self.limits[:, 0]) | (angles > self.limits[:, 1])
        if outside.any():
            return f"joint limit {self.names[int(outside.argmax())]}"
        if self.solver.height(self.solver.torso) < r.least_height:
            return "least height"
        if links := self._too_near(angles, self.pairs):
            return f"self-collision {links}"
        if before is not None and (links := blocked(self.pairs, self.chain.path, before, angles)):
            return f"self-collision on the way {links}"
        return angles

    def _free_joints(self) -> tuple[np.ndarray, str | None]:
        """Draw the joints that are not between the feet until what they alone move keeps its distance.

        Returns the configuration for inverse kinematics to start from, (nq,), and links that remain too near.
        """
        guess, links = self.guess.copy(), None
        for _ in range(REDRAWS):
            for name, interval in self.free_joints.items():
                guess[self.model.joint(name).qposadr[0]] = self._draw(interval)
            links = self._too_near(guess[self.solver.joints], self.fixed)
            if links is None:
                break
        return guess, links

    def _too_near(self, angles: np.ndarray, pairs: LinkPairs) -> str | None:
        if not pairs.names:
            return None
        found = clearances_at(pairs, angles[None], pairs.needed.max(initial=0.0))
        return too_near(pairs, found, pairs.needed)

    def _draw(self, interval: Range) -> float:
        return float(self.rng.uniform(*interval))

    def _reject(self, reason: str) -> None:
        self.attempts += 1
        self.rejected[reason] += 1
        if self.found == 0 and self.attempts >= ATTEMPTS:
            raise InputError(
                f"{self.solver.robot.path}: planning ranges admit no posture: "
                f"{self.attempts} tries, none feasible; blocked by {most_frequent(self.rejected)}"
            )


def _lowest_sole(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> float:
    return min(
        float((data.body(foot).xpos + data.body(foot).xmat.reshape(3, 3) @ corner)[2])
        for foot in robot.feet
        for corner in sole_corners(model, foot)
    )
