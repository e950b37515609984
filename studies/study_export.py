"""Measure how exported models predict the centre of pressure of new postures (docs/studies/export.md; 3 minutes).

Random true robots stand on force plates, on the shipped plan, in statics. Each is identified and exported;
MuJoCo loads the file and computes the centre of mass of 100 new random postures, as it does for the true
robot and for CAD. Angles are exact and there is no noise: only the models differ.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

import tulip_testbed as tt
from studies.runner import Settings, header, row
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of
from tulip_testbed.experiments.usable_plan import random_plan
from tulip_testbed.sim.random_robots import edit_of
from tulip_testbed.sim.robot import Robot, joint_names, load_robot
from tulip_testbed.sim.specs import compile_spec

SETTINGS = Settings(seed=9500)
ROBOTS, SPREAD, PLACEMENTS, POSTURES = 10, 0.2, 20, 5


def pressure(model: mujoco.MjModel, robot: Robot, angles: np.ndarray) -> np.ndarray:
    """Return the centre of pressure at rest in the stance foot's frame, below that of mass, (m, 2) [m]."""
    data, found = mujoco.MjData(model), []
    columns = [int(model.joint(name).qposadr[0]) for name in joint_names(model)]
    for row_angles in angles:
        data.qpos[columns] = row_angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        foot = data.body(robot.stance_foot)
        found.append((foot.xmat.reshape(3, 3).T @ (data.subtree_com[1] - foot.xpos))[:2])
    return np.array(found)


def one(seed: int) -> tuple[float, float, float]:
    """Return r.m.s. of CAD and of the exported model [m], and the misfit of the exported base parameters."""
    robot = load_robot()
    laboratory = tt.Laboratory(robot, "force-plate")
    (outcome,) = source_of(laboratory, tt.plans.random, SPREAD, "statics")([np.random.SeedSequence(seed)])
    assert not isinstance(outcome, str), outcome
    spec = robot.spec.copy()
    edit_of(robot.model, outcome.truth.standard)(spec)
    truth = compile_spec(spec, "true robot")
    found = tt.identify(outcome.measurements, robot)
    with tempfile.TemporaryDirectory() as folder:
        made = tt.export_model(found, robot, out=Path(folder) / "robot.xml")
        exported = mujoco.MjModel.from_xml_path(made.file)
    plan = random_plan(robot, PLACEMENTS, POSTURES, seed)
    true = pressure(truth, robot, plan.joint_angles)
    rms = [
        float(np.sqrt(((pressure(model, robot, plan.joint_angles) - true) ** 2).sum(axis=1).mean()))
        for model in (robot.model, exported)
    ]
    return rms[0], rms[1], made.misfit_in_standard_errors


def study(settings: Settings) -> Iterator[str]:
    """Yield a row a robot."""
    seeds = [settings.seed + k for k in range(settings.count(ROBOTS))]
    results = settings.parallel("robots", one, ((seed,) for seed in seeds))
    yield header("robot", "CAD, mm", "exported, mm", "exported over CAD", "misfit, s.e.")
    for seed, (cad, exported, misfit) in zip(seeds, results, strict=True):
        yield row(seed, f"{1e3 * cad:.2f}", f"{1e3 * exported:.2f}", f"{exported / cad:.3f}", f"{misfit:.2g}")
