"""The record of any run, read from its folder or made from a result in memory."""

from __future__ import annotations

from pathlib import Path
from typing import overload

from tulip_testbed.experiments.discovering import Discovered
from tulip_testbed.experiments.discovery_record import DiscoveryRecord, discovery_record, read_discovery
from tulip_testbed.experiments.laboratory import Run
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.run_file import run_kind
from tulip_testbed.experiments.validate import judge
from tulip_testbed.experiments.validation_record import ValidationRecord, read_validation
from tulip_testbed.experiments.validation_result import Validation, validation_record
from tulip_testbed.sim.robot import Robot

Record = ValidationRecord | MonteCarlo | DiscoveryRecord
Result = Run | Validation | MonteCarlo | Discovered


@overload
def record_of(result: Discovered) -> DiscoveryRecord: ...
@overload
def record_of(result: MonteCarlo) -> MonteCarlo: ...
@overload
def record_of(result: Run | Validation) -> ValidationRecord: ...
@overload
def record_of(result: Result) -> Record: ...
def record_of(result: Result) -> Record:
    """Make the record of a result in memory; a run is judged as a validation.

    Raises:
        InputError: measurements of a run that do not suffice to identify the robot.
    """
    if isinstance(result, Discovered):
        return discovery_record(result)
    if isinstance(result, MonteCarlo):
        return result
    return validation_record(judge(result) if isinstance(result, Run) else result)


def read_record(folder: Path, robot: Robot) -> Record:
    """Read a run folder of any kind and check that nothing in it was changed.

    Raises:
        InputError: no run folder, one of another version or robot, or a file that is not what was written.
    """
    readers = {
        "validation": read_validation,
        "Monte Carlo": MonteCarlo.load,
        "discovery": read_discovery,
    }
    return readers[run_kind(folder)](folder, robot)
