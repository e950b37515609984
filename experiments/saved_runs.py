"""Runs of any kind, read from their folders."""

from pathlib import Path

from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.run_file import run_kind
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.sim.robot import Robot

RunResult = Validation | Discovered | MonteCarlo


def read_run(folder: Path, robot: Robot) -> RunResult:
    """Read a run folder of any kind and check that nothing in it was changed."""
    kinds = {one.kind: one for one in (Validation, Discovered, MonteCarlo)}
    return kinds[run_kind(folder)].load(folder, robot)
