"""Links keep apart in planned postures and between them, held against collision runs of MuJoCo's own."""

import dataclasses
import itertools

import mujoco
import numpy as np
import pytest

from tulip_testbed.base.table import Table
from tulip_testbed.experiments.plan_clearances import clearance_table, clearances_of
from tulip_testbed.identification.link_clearances import (
    clearances_at,
    link_pairs,
    moving_pairs,
    overlaps_at_reference,
    unjoined_pairs,
)
from tulip_testbed.identification.link_paths import SHARE, blocked, path_clearances, with_free_paths
from tulip_testbed.identification.link_shapes import GROUND
from tulip_testbed.identification.planning.constraints import evaluate
from tulip_testbed.identification.planning.objectives import objectives
from tulip_testbed.identification.planning.one_foot import single_support_margins
from tulip_testbed.identification.planning.optimal_plan import SearchTask, smallest_margins
from tulip_testbed.identification.planning.problem import planning_problem
from tulip_testbed.identification.planning.search import design_of
from tulip_testbed.identification.planning_ranges import planning_margins
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.robot import joint_names
from tulip_testbed.sim.scene import nominal_plates

PENETRATION = 1e-3  # m
NAME = "humanoid"


@pytest.fixture(scope="module")
def humanoid(foreign):
    return foreign[NAME]


@pytest.fixture(scope="module")
def random_plan(humanoid_plan):
    return humanoid_plan.take(humanoid_plan.placement <= 4)


@pytest.fixture(scope="module")
def problem(humanoid):
    return planning_problem(humanoid, nominal_plates(humanoid)[0])


class Collisions:
    """Penetrations by MuJoCo's contacts: every shape of the robot can touch every other, and a floor."""

    def __init__(self, robot):
        spec = robot.spec.copy()
        for geom in spec.geoms:
            corner = geom.name.endswith(("_left", "_right")) and "foot_" in geom.name
            geom.contype = geom.conaffinity = 0 if corner else 1
            geom.margin = 0
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1], contype=1, conaffinity=1)
        self.robot, self.model = robot, spec.compile()
        self.data = mujoco.MjData(self.model)
        self.qpos = [self.model.joint(name).qposadr[0] for name in joint_names(self.model)]
        self.chain = ClosedChain(robot.model, robot)
        stand = robot.model.key("stand").qpos[self.chain.qpos]
        self.usual = set(self.at(stand))

    def at(self, angles):
        """Depth of every penetration by the names of the bodies [m], other than those in the keyframe."""
        self.data.qpos[:7], self.data.qpos[self.qpos] = self.chain.base_pose(angles), angles
        mujoco.mj_forward(self.model, self.data)
        feet, found = {f"{name}" for name in self.robot.feet}, {}
        for contact in self.data.contact:
            names = frozenset(self.model.body(self.model.geom_bodyid[g]).name for g in contact.geom)
            if not ("world" in names and names & feet) and names not in getattr(self, "usual", ()):
                found[names] = max(found.get(names, 0.0), -contact.dist)
        return found

    def deepest(self, postures):
        return max((depth for angles in postures for depth in self.at(angles).values()), default=0.0)


@pytest.fixture(scope="module")
def collisions(humanoid):
    return Collisions(humanoid)


def test_random_postures_and_paths_are_free_of_collisions(humanoid, random_plan, collisions):
    assert collisions.deepest(random_plan.joint_angles) < PENETRATION
    assert collisions.deepest(ways(humanoid, random_plan)) < PENETRATION


@pytest.mark.slow
def test_optimal_postures_and_paths_are_free_of_collisions(humanoid, problem, collisions):
    optimal_plan = SearchTask(problem, objectives(4.16e-3)["condition"], 7, 5, 412, hops=1).run()
    assert optimal_plan.made["final_objective"] < 0.6 * optimal_plan.made["initial_objective"]
    assert collisions.deepest(optimal_plan.joint_angles) < PENETRATION
    assert collisions.deepest(ways(humanoid, optimal_plan)) < PENETRATION
    assert all(margin["value"] > -1e-6 for margin in smallest_margins(problem, optimal_plan).values())
    held = clearances_at(problem.pairs, optimal_plan.joint_angles, 0.1).distance
    assert (held >= problem.pairs.needed - 1e-7).all()


def ways(robot, plan):
    """Postures on the laboratory's paths between the postures of each placement."""
    chain = ClosedChain(robot.model, robot)
    rows = [k for k in range(len(plan) - 1) if plan.placement[k] == plan.placement[k + 1]]
    angles = plan.joint_angles
    return np.concatenate([chain.path(angles[k], angles[k + 1], 60) for k in rows])


@pytest.mark.parametrize("name", ["tulip", NAME])
def test_distances_are_those_of_all_shapes(name, robot, foreign):
    """Every pair of links against a search over all pairs of geoms after MuJoCo's own kinematics."""
    robot = robot if name == "tulip" else foreign[name]
    pairs, model = link_pairs(robot, 0.01), robot.model
    low, high = np.array([model.joint(joint).range for joint in joint_names(model)]).T
    drawn = np.random.default_rng(414).uniform(0.5 * low, 0.5 * high, (6, len(low)))
    found, data = clearances_at(pairs, drawn, 0.05), mujoco.MjData(model)
    corners = {k for k in range(model.ngeom) if model.geom(k).name.startswith(robot.feet)}
    for row, angles in enumerate(drawn):
        data.qpos[[model.joint(joint).qposadr[0] for joint in joint_names(model)]] = angles
        mujoco.mj_forward(model, data)
        for k, (first, second) in enumerate(pairs.names):
            if second == GROUND:
                continue
            bodies = [model.body(link).id for link in (first, second)]
            own = [set(np.flatnonzero(model.geom_bodyid == body)) - corners for body in bodies]
            every = [
                mujoco.mj_geomDistance(model, data, a, b, 0.05, None) for a, b in itertools.product(*own)
            ]
            assert found.distance[row, k] == pytest.approx(min(every), abs=1e-6)


def test_derivatives_of_the_distances(problem, random_plan):
    design = design_of(problem, random_plan.joint_angles, random_plan.swing_pose)
    found, step = evaluate(problem, design, random_plan.joint_angles), 1e-5
    rows = np.array(found.names) == "link clearance"

    def values(u):
        return evaluate(problem, u, random_plan.joint_angles).inequalities[:, rows]

    slopes = [(values(design + step * e) - values(design - step * e)) / (2 * step) for e in np.eye(9)]
    exact = found.inequality_jacobian[:, rows]
    assert np.abs(exact).max() > 1
    scale = np.maximum(np.abs(exact).max(axis=2, keepdims=True), 1.0)
    assert np.abs((np.stack(slopes, axis=-1) - exact) / scale).max() < 1e-4


def test_the_planner_sees_lower_legs_that_penetrate(robot, plate, plan):
    """By the 8.9 mm of the report below, of links that must keep 10 mm, on both feet and on one."""
    met, here = plan.take(plan.placement == 14), planning_problem(robot, plate)
    seen = smallest_margins(here, met)["link clearance"]["value"]
    assert seen == pytest.approx(-18.9, abs=0.1)
    alone = single_support_margins(here, met.joint_angles, met.swing_pose)["link clearance"]
    assert alone.min() == pytest.approx(-18.9, abs=0.1)


def test_neighbours_and_links_that_overlap_at_rest_are_left_out(robot, foreign):
    names = {frozenset(pair) for pair in link_pairs(robot, 0.01).names}
    assert frozenset(("right_upper_leg", "left_upper_leg")) in names
    assert frozenset(("torso", "right_hip_yaw")) not in names  # a joint
    assert frozenset(("right_hip_yaw", "right_upper_leg")) not in names  # a hip of three joints
    assert frozenset(("right_ankle", GROUND)) in names
    assert frozenset(("right_foot", GROUND)) not in names
    stand = foreign["humanoid_CMU"]
    pairs = link_pairs(stand, 0.015)
    assert (pairs.needed > 0).all()
    assert pairs.needed.max() == 0.015
    overlaps = overlaps_at_reference(stand)
    assert [*overlaps] == [("upperneck", "lclavicle"), ("upperneck", "rclavicle")]
    assert set(unjoined_pairs(stand).names) - set(pairs.names) == {*overlaps}
    assert max(overlaps.values()) == pytest.approx(0.0591, abs=1e-4)
    fixed = pairs.take(~moving_pairs(pairs, np.ones(56, bool)))
    assert not fixed.names  # some joint moves every pair


def test_pairs_that_the_model_excludes_are_left_out(foreign):
    robot = foreign[NAME]
    spec = robot.spec.copy()
    spec.add_exclude(name="hands", bodyname1="left_hand", bodyname2="right_hand")
    other = dataclasses.replace(robot, spec=spec)
    names = {frozenset(pair) for pair in link_pairs(robot, 0.01).names}
    assert names - {frozenset(pair) for pair in link_pairs(other, 0.01).names} == {
        frozenset(("left_hand", "right_hand"))
    }


def test_a_path_through_a_link_is_refused(humanoid, random_plan):
    """Arms drawn at random in two postures: both are free, but on some paths arms meet a link."""
    pairs = link_pairs(humanoid, planning_margins(humanoid).link_clearance)
    chain, rng = ClosedChain(humanoid.model, humanoid), np.random.default_rng(415)
    low, high = np.array([humanoid.model.joint(name).range for name in joint_names(humanoid.model)]).T
    found = []
    while not any(found):
        start, end = ends = random_plan.joint_angles[:2].copy()
        ends[:, ~chain.coupled] = rng.uniform(low, high, ends.shape)[:, ~chain.coupled]
        if (clearances_at(pairs, ends, 0.02).distance < pairs.needed).any():
            continue
        found.append(blocked(pairs, chain.path, start, end))
        if found[-1] or len(found) < 5:
            between = clearances_at(pairs, chain.path(start, end, 200), 0.02).distance
            assert (found[-1] is not None) == bool((between < SHARE * pairs.needed).any())
            least = path_clearances(pairs, chain.path, start, end, 0.02).distance.min(initial=0.02)
            assert least == pytest.approx(between.min(), abs=2e-3)
    assert None in found


def test_postures_without_a_free_path_are_placed_anew(problem, random_plan, monkeypatch):
    from tulip_testbed.identification import link_paths

    walls = {frozenset((0, 1)), frozenset((2, 3))}
    first = random_plan.take(random_plan.placement <= 2)
    rows = {angles.tobytes(): k % 5 for k, angles in enumerate(first.joint_angles)}

    def blocked_by_walls(pairs, path, start, end):
        met = frozenset((rows[start.tobytes()], rows[end.tobytes()]))
        return "wall" if met in walls else None

    monkeypatch.setattr(link_paths, "blocked", blocked_by_walls)
    moved = with_free_paths(problem.robot, problem.pairs, first)
    assert moved.placement.tolist() == first.placement.tolist()
    steps = [rows[angles.tobytes()] for angles in moved.joint_angles[:5]]
    assert sorted(steps) == list(range(5))
    assert not any(frozenset(step) in walls for step in itertools.pairwise(steps))
    walls |= {frozenset((4, k)) for k in range(4)}  # nothing leads to the fifth
    apart = with_free_paths(problem.robot, problem.pairs, first)
    assert apart.placement.tolist() == [1] * 4 + [2] * 4 + [3, 4]
    assert apart.posture.tolist() == first.posture.tolist()
    assert {a.tobytes() for a in apart.joint_angles} == set(rows)
    for number, pose in zip(apart.placement, apart.swing_pose, strict=True):
        assert pose.tolist() == first.swing_pose[first.placement == (1 + (number + 1) % 2)][0].tolist()


def test_the_report_gives_the_nearest_links(robot, plan, humanoid, random_plan):
    said = clearances_of(robot, plan.take(plan.placement == 14))
    assert said["postures"][0]["links"] == ["right_lower_leg", "left_lower_leg"]
    assert said["postures"][0]["distance_mm"] == pytest.approx(-8.9, abs=0.1)
    assert said["postures"][0]["at"] == [68]
    assert said["paths"][0]["at"] in ([67, 68], [68, 69])
    table = clearance_table(said)
    assert isinstance(table, Table)
    assert table.rows[0][0] == "right_lower_leg and left_lower_leg"
    assert clearance_table({"postures": [], "paths": []}) == "No links come nearer to each other than 30 mm."
    lain = {"postures": [], "paths": [], "left_out": [{"links": ["hand", "thigh"], "distance_mm": -27.2}]}
    assert str(clearance_table(lain)).endswith(
        "since they overlap in the posture stand: hand and thigh (27 mm)."
    )
    assert said["left_out"] == []
    least = clearances_of(humanoid, random_plan)
    needed = 1e3 * planning_margins(humanoid).link_clearance
    assert all(entry["distance_mm"] >= needed - 1e-6 for entry in least["postures"])
    assert all(entry["distance_mm"] >= SHARE * needed - 1e-6 for entry in least["paths"])
