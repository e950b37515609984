"""What `discover` takes, as a ratio within one run: `OTHER=/path/of/a/checkout make bench` for a comparison.

Two commits are compared as processes, taking turns; each has its own virtual environment in `.venv`.
"""

import json
import os
import resource
import statistics
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.meshed_robot import meshed_plan, write_meshed_robot
from tulip_testbed import plans
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.measurements import write_measurements
from tulip_testbed.sim.robot import load_robot

HERE = Path(__file__).parents[2]
ROUNDS = 9


def seconds(checkout: Path, robot: Path | None, folder: Path, out: Path) -> float:
    """Processor time of one run of the command and its children."""
    asked = ["discover", str(folder), "--json", "--out", str(out)]
    if robot is not None:
        asked += ["--robot", str(robot)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(checkout / ".venv/bin/tulip"), *asked], cwd=checkout, capture_output=True, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert json.loads(done.stdout)["verdict"] == "named"
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.filterwarnings("ignore::tulip_testbed.base.errors.InputWarning")  # of what such a robot lacks
@pytest.mark.parametrize("name", ["TULip", "29 joints with meshes"])
def test_discover_against_another_checkout(benchmark, tmp_path, name):
    other = os.environ.get("OTHER")
    if other is None:
        pytest.skip("OTHER names no checkout to compare with")
    if name == "TULip":
        robot, path, plan = load_robot(), None, plans.random
    else:
        robot = write_meshed_robot(tmp_path / "robot")
        path = tmp_path / "robot" / "robot.toml"
        plan = meshed_plan(robot, plans.random, np.random.default_rng(1))
    laboratory = Laboratory(robot, "force-plate").with_effects("encoder-offset:right_knee=0.01")
    run = laboratory.run(plan, 3, "statics")
    # Commits differ in how they hash a robot of several files.
    anonymous = replace(run.measurements, robot=run.measurements.robot | {"sha256": None})
    write_measurements(tmp_path / "measured", anonymous)
    times: dict[Path, list[float]] = {Path(other): [], HERE: []}
    for k in range(ROUNDS):
        for checkout in times:
            out = tmp_path / f"{'here' if checkout == HERE else 'other'}{k}"
            times[checkout].append(seconds(checkout, path, tmp_path / "measured", out))
    then, now = (statistics.median(times[checkout]) for checkout in (Path(other), HERE))
    benchmark.extra_info["ratio"] = then / now
    print(f"\ndiscover, {name}: {then:.1f} s there, {now:.1f} s here, {then / now:.2f} times as fast")
    benchmark.pedantic(lambda: None)
