"""Structural derivation of the base parameters: counts, names, ranks, invariance."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import subspace_angles

from tests.moving_robots import moving
from tests.posed import posed, seen_from
from tulip_testbed.identification.base_parameters import _frame_matrix, base_parameters, standard_parameters
from tulip_testbed.identification.inertial_wrench import wrench_regressor
from tulip_testbed.identification.kinematics import link_rotations
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import stacked_regressor
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.robot import Robot, sole_point

# facts: number -> links that the parameter unites, and its axis
PAPER = {
    1: "torso x", 2: "right_hip_yaw right_hip x", 3: "right_upper_leg x", 4: "right_lower_leg x",
    5: "right_ankle right_foot x", 6: "left_hip_yaw left_hip x", 7: "left_upper_leg x",
    8: "left_lower_leg x", 9: "left_ankle left_foot x", 10: "torso y", 11: "right_hip_yaw y",
    12: "right_hip right_upper_leg right_lower_leg right_ankle y", 13: "right_foot y",
    14: "left_hip_yaw y", 15: "left_hip left_upper_leg left_lower_leg left_ankle y", 16: "left_foot y",
    17: "torso right_hip_yaw left_hip_yaw z", 18: "right_hip z", 19: "right_upper_leg z",
    20: "right_lower_leg z", 21: "right_ankle z", 22: "left_hip z", 23: "left_upper_leg z",
    24: "left_lower_leg z", 25: "left_ankle z",
}  # fmt: skip


def test_counts_are_those_of_the_paper(robot, parameters):
    assert 4 * len(parameters.tree.links) == 52
    assert 3 * len(parameters.tree.frames) == 39
    assert parameters.merged_columns == 27
    assert len(parameters.names) == 25
    assert len(base_parameters(robot, support="right").names) == 26
    assert len(base_parameters(robot, support="left").names) == 26


@pytest.mark.parametrize("number", PAPER)
def test_numbers_and_groups_are_those_of_the_paper(number, parameters):
    frames = [parameters.tree.frames[f] for f in parameters.members(number - 1)]
    axis = parameters.names[number - 1][-1]
    assert " ".join([*frames, axis]) == PAPER[number]


def random_tree(seed: int, bodies: int) -> tuple[mujoco.MjModel, Robot]:
    """A tree of up to two hinges a body, rotated bodies, parallel, crossing and skew axes."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    nodes = [spec.worldbody.add_body(name="b0")]
    nodes[0].add_freejoint()
    for k in range(1, bodies):
        parent = nodes[max(0, k - int(rng.integers(1, 4)))]
        rotation = rng.standard_normal(4) if rng.random() < 0.5 else np.array([1.0, 0, 0, 0])
        node = parent.add_body(
            name=f"b{k}", pos=rng.uniform(-0.3, 0.3, 3), quat=rotation / np.linalg.norm(rotation)
        )
        for h in range(int(rng.choice([1, 1, 1, 2]))):
            axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.7 else rng.standard_normal(3)
            offset = rng.uniform(-0.1, 0.1, 3) if rng.random() < 0.3 else np.zeros(3)
            node.add_joint(
                name=f"j{k}{h}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, pos=offset, armature=1
            )
        nodes.append(node)
    for node in nodes:
        node.mass, node.inertia, node.explicitinertial = 1.0, [0.01, 0.01, 0.01], True
        node.ipos = rng.uniform(-0.1, 0.1, 3)
    leaves = [n for n in nodes if not n.bodies][-2:]
    feet = [n.name for n in ([nodes[0], *leaves] if len(leaves) < 2 else leaves)[-2:]]
    for foot in feet:
        for corner in CORNERS:
            spec.body(foot).add_geom(
                name=f"{foot}_{corner}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[0.001, 0, 0],
                pos=[0.1 if "front" in corner else -0.1, 0.05 if "left" in corner else -0.05, -0.05],
            )
    model = spec.compile()
    mjcf, nothing = Path("x.xml"), {"scene_file": None, "settings": {}, "hashes": {}, "model_hash": ""}
    files = {"path": Path("x.toml"), "model_file": mjcf, "plate_file": mjcf}
    return model, Robot(**files, **nothing, stance_foot=feet[0], swing_foot=feet[1], spec=spec, model=model)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), bodies=st.integers(2, 9))
def test_structural_count_is_the_numerical_rank_on_random_trees(seed, bodies):
    model, robot = random_tree(seed, bodies)
    parameters = base_parameters(robot, model, "right")
    angles = np.random.default_rng(seed).uniform(-3, 3, (60, len(parameters.tree.joints)))
    rotations = link_rotations(parameters.tree, parameters.base, angles)
    frames = rotations[:, :, :2].transpose(0, 2, 1, 3).reshape(120, -1)
    standard = frames @ _frame_matrix(parameters.tree, parameters.base, sole_point(model, robot.stance_foot))
    matrix = stacked_regressor(parameters, angles)
    count = len(parameters.names)
    assert np.linalg.matrix_rank(standard, tol=1e-9) == count
    assert np.linalg.matrix_rank(matrix, tol=1e-9) == count
    # The base regressor says of any robot of this shape what the standard one says.
    masses = standard_parameters(model)
    assert matrix @ parameters.values(masses) == pytest.approx(
        standard @ masses.ravel() / masses[:, 0].sum(), abs=1e-12
    )


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), bodies=st.integers(2, 9))
def test_random_trees_com_is_mujocos(seed, bodies):
    model, robot = random_tree(seed, bodies)
    parameters = base_parameters(robot, model, "right")
    angles = np.random.default_rng(seed).uniform(-3, 3, len(parameters.tree.joints))
    data = posed(model, angles, parameters.tree.joints)
    com = seen_from(data, robot.stance_foot, data.subtree_com[1]) - sole_point(model, robot.stance_foot)
    estimate = parameters.regressor(angles[None])[0] @ parameters.values(standard_parameters(model))
    assert estimate == pytest.approx(com[:2], abs=1e-12)


FOLDER = Path(__file__).parent / "data" / "oracle"
SUPPORTS = ("right", "double")


@pytest.fixture(scope="module", params=["tulip", "humanoid", "humanoid_CMU"])
def case(request, robot, foreign):
    """A robot, what we make of it, and what the oracles said."""
    described = ({"tulip": robot} | foreign)[request.param]
    model = described.model
    with np.load(FOLDER / f"{request.param}.npz") as answers:
        return SimpleNamespace(
            robot=described,
            model=model,
            standard=standard_parameters(model),
            parameters={support: base_parameters(described, model, support) for support in SUPPORTS},
            oracle=dict(answers),
        )


def test_oracle_read_the_same_robot(case):
    assert tuple(case.oracle["links"]) == case.parameters["right"].tree.links
    assert case.oracle["mass"] == pytest.approx(case.standard[:, 0].sum(), abs=1e-12)


def test_the_regressor_of_the_wrench_is_that_of_pinocchio(case):
    m = moving(case.robot, np.random.default_rng(0), len(case.oracle["rates"]))
    m = dataclasses.replace(
        m,
        support=np.full(len(m), "right"),
        joint_angles=case.oracle["right.angles"],
        joint_rates=case.oracle["rates"],
        joint_accelerations=case.oracle["accelerations"],
    )
    ours = wrench_regressor(nominal_robot(case.robot), m).reshape(len(m), 6, -1)
    theirs = case.oracle["root_rows"]
    assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()


@pytest.mark.parametrize("support", SUPPORTS)
def test_regressor_of_standard_parameters(case, support):
    """Ours goes through the base parameters; Pinocchio's knows no such thing."""
    parameters = case.parameters[support]
    ours = parameters.regressor(case.oracle[f"{support}.angles"]) @ parameters.from_standard
    assert np.abs(ours / case.oracle["mass"] - case.oracle[f"{support}.regressor"]).max() < 1e-12


@pytest.mark.parametrize("support", SUPPORTS)
def test_rank_and_span_of_the_base_parameters(case, support):
    """The same combinations of standard parameters, whichever basis each program picks."""
    ours, figaroh = case.parameters[support].from_standard, case.oracle[f"{support}.mapping"]
    assert len(ours) == len(figaroh)
    assert np.max(subspace_angles(ours.T, figaroh.T)) < 1e-10
