"""Fixtures shared by the tests; the experiments in the full dynamics run once for all processes."""

import dataclasses
import fcntl
import gc
import os
import pickle
import shutil
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "disable")
# Before numpy is loaded. Tests call functions below those that limit linear algebra to one thread
# (base/threads.py): with two threads the last bits of a discovery differ.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# pytest-xdist tells its workers the width of the terminal; tables would follow it.
os.environ.pop("COLUMNS", None)


import numpy as np
import pytest

import tulip_testbed as tt
from tests.drawing import WHEN, decide, obstacle_to, unreachable
from tests.edited_files import BUILT, change_texts
from tests.effect_changes import SEED, first
from tests.foreign_robots import ROBOTS, write_robot
from tests.synthetic import Bench, synthetic_bench
from tulip_testbed.experiments.discovering import Discovered, discover_effects
from tulip_testbed.experiments.protocols.protocol_run import LaboratoryProtocol, protocol_of
from tulip_testbed.experiments.robot_import import published
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.postures import random_postures
from tulip_testbed.plans import optimal
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.shipped import TULIP

DISCOVERED_SEED = 141


def pytest_addoption(parser: pytest.Parser) -> None:
    help_ = "tests that draw: where possible, always (or fail), never (drivers are made unreachable)"
    parser.addoption("--draw", choices=WHEN, default="possible", help=help_)


def pytest_collection_finish() -> None:
    """Spare the garbage collector what was imported: it would go through that again and again."""
    gc.collect()
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("draw") == "never":
        os.environ.update(unreachable(Path(tempfile.mkdtemp(prefix="no-drivers-"))))


@pytest.fixture(scope="session", autouse=True)
def in_this_process() -> Iterator[None]:
    """Read robots here and leave pictures of postures grey; each has a process of its own otherwise.

    Tests of these processes take them back.
    """

    def grey(robot: Robot, angles: np.ndarray, support: Any, plates: Any, *size: int) -> np.ndarray:
        return np.full((len(angles), *size[::-1], 3), 200, np.uint8)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tulip_testbed.sim.robot.try_to_compile", lambda path, files: None)
        patch.setattr(published, "call_safely", lambda function, path: function(path))
        patch.setattr("tulip_testbed.pages.pictures.rendered", grey)
        yield


@pytest.fixture(scope="session")
def once(tmp_path_factory, worker_id) -> Callable[[str, Callable[[], Any]], Any]:
    """Make something once for all processes of pytest-xdist: (name, function) -> its result."""

    def made(name: str, make: Callable[[], Any]) -> Any:
        if worker_id == "master":
            return make()
        path = tmp_path_factory.getbasetemp().parent / f"{name}.pickle"
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                path.write_bytes(pickle.dumps(make()))
        return pickle.loads(path.read_bytes())

    return made


@pytest.fixture(autouse=True)
def drawing(request, once, pytestconfig) -> None:
    """Skip what asks for a program that cannot draw here; each program draws once a test process."""
    for mark in request.node.iter_markers("draws"):
        (program,) = mark.args
        decide(
            program,
            once(f"obstacle-{program}", partial(obstacle_to, program)),
            pytestconfig.getoption("draw"),
        )


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot()


@pytest.fixture
def edited_tulip(tmp_path) -> Callable[..., Robot]:
    """Load a copy of TULip with other texts, `FILE: TEXT => ANOTHER`; its scene is built if so asked."""

    def load(*changes: str, built: bool = True, name: str = "own") -> Robot:
        folder = shutil.copytree(TULIP.parent, tmp_path / name)
        change_texts(folder, [BUILT] * built + list(changes))
        return load_robot(folder / "tulip.toml")

    return load


@pytest.fixture(scope="session")
def small_plan() -> tt.PosturePlan:
    """The first four placements of the optimal plan."""
    return optimal.take(optimal.placement <= 4)


@pytest.fixture(scope="session")
def small_protocol(robot, small_plan, once) -> LaboratoryProtocol:
    return once("small-protocol", lambda: protocol_of(robot, small_plan, "wii", repeats=3))


@pytest.fixture(scope="session")
def model(robot):
    return robot.model


@pytest.fixture(scope="session")
def rig(robot):
    return preset_rig("ideal", robot)


@pytest.fixture(scope="session")
def stand(model):
    """The asset's standing posture, (n,)."""
    return model.key("stand").qpos[7:]


@pytest.fixture(scope="session")
def parameters(robot) -> BaseParameters:
    return base_parameters(robot)


@pytest.fixture(scope="session")
def plate(robot) -> tt.PlateGeometry:
    return nominal_plates(robot)[0]


@pytest.fixture(scope="session")
def plan(robot, model) -> tt.PosturePlan:
    return read_plan(DEFAULT_PLAN, robot)


@pytest.fixture(scope="session")
def foreign(tmp_path_factory) -> dict[str, Robot]:
    """Humanoids that nobody here wrote."""
    folder = tmp_path_factory.mktemp("foreign")
    return {name: load_robot(write_robot(name, folder / name)) for name in ROBOTS}


@pytest.fixture(scope="session")
def humanoid_plan(foreign, once) -> tt.PosturePlan:
    """Eight placements of five random postures each of the humanoid."""
    robot = foreign["humanoid"]
    return once("humanoid", lambda: random_postures(robot, nominal_plates(robot)[0], 8, 5, 110))


@pytest.fixture(scope="session")
def ideal(once, robot, plan) -> tt.Validation:
    """Ten placements of the default plan without sensor noise, in the full dynamics."""
    part = plan.take(plan.placement <= 10)
    exact = partial(tt.validate, estimator=MIXED_MODEL, workers=1, imperfections=0)
    return once("ideal", lambda: exact(tt.Laboratory(robot, "ideal"), part, seed=101))


@pytest.fixture(scope="session")
def wii(once, robot, plan) -> tt.Validation:
    """The whole default plan at preset wii, exact but for noise, by statics and the mixed model."""
    exact = partial(tt.validate, estimator=MIXED_MODEL, engine="statics", imperfections=0)
    return once("wii", lambda: exact(tt.Laboratory(robot, "wii"), plan, seed=102))


@pytest.fixture(scope="session")
def static_run(robot, plan) -> tt.Run:
    """An experiment of the statics engine with an encoder's offset, in memory."""
    laboratory = tt.Laboratory(robot, "force-plate").with_effects("encoder-offset:right_knee=0.01")
    return laboratory.run(plan.take(plan.placement <= 10), DISCOVERED_SEED, "statics")


@pytest.fixture(scope="session")
def run(robot) -> tt.Run:
    """The shipped plan on force plates, by statics."""
    return tt.Laboratory(robot, "force-plate").run(tt.plans.random, seed=3, engine="statics")


@pytest.fixture(scope="session")
def discovered(once, static_run, robot) -> Discovered:
    """The offset found again."""
    return once("discovered", lambda: discover_effects(static_run.measurements, robot, check=False))


@pytest.fixture(scope="session")
def discovered_folder(discovered, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("discovery") / "found"
    discovered.save(folder)
    return folder


@pytest.fixture(scope="session")
def moved_wii(once, robot, plan) -> tt.Validation:
    """Six placements at preset wii, exact but for noise, in the full dynamics, by the mixed model."""
    few = plan.take((plan.placement >= 11) & (plan.placement <= 16))  # some postures are lost
    exact = partial(tt.validate, estimator=MIXED_MODEL, workers=1, imperfections=0)
    return once("moved-wii", lambda: exact(tt.Laboratory(robot, "wii"), few, seed=102))


@pytest.fixture(scope="session")
def run_folder(moved_wii, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("view") / "run"
    moved_wii.save(folder)
    return folder


@pytest.fixture(scope="session")
def coverage(once, robot, plan, tmp_path_factory) -> Path:
    """The folder of a Monte Carlo of two chunks in exact laboratories, by the quickest estimator."""

    def make() -> Path:
        folder = tmp_path_factory.mktemp("coverage") / "montecarlo"
        exact = {"estimator": MIXED_MODEL, "imperfections": 0.0, "workers": 1}
        few = plan.take(plan.placement <= 12)
        tt.monte_carlo(tt.Laboratory(robot), few, runs=40, seed=103, out=folder, **exact)
        return folder

    return once("coverage", make)


@pytest.fixture(scope="session")
def nominal(robot) -> Nominal:
    return nominal_robot(robot)


@pytest.fixture(scope="session")
def precise(robot, plan) -> tt.Measurements:
    """The whole default plan on force plates, by statics."""
    return tt.Laboratory(robot, "force-plate").run(plan, 110, "statics").measurements


@pytest.fixture(scope="session")
def bench(nominal, plan) -> Bench:
    return synthetic_bench(nominal, plan)


@pytest.fixture(scope="session")
def few(plan) -> tt.PosturePlan:
    return first(plan, 8)


@pytest.fixture(scope="session")
def twelve(plan) -> tt.PosturePlan:
    return first(plan, 12)


@pytest.fixture(scope="session")
def two(plan) -> tt.PosturePlan:
    return first(plan, 2)


@pytest.fixture(scope="session")
def noiseless(robot) -> Rig:
    rig = preset_rig("ideal", robot)
    return dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=2))


@pytest.fixture(scope="session")
def moved(noiseless, two) -> Outcome:
    """Two placements without any effect, in the full dynamics."""
    return run_dynamics(noiseless, two, SEED)
