"""The whole discovery: search, identification before and after by one estimator, check in full dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tulip_testbed.base.errors import InputError, at_least
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.threads import processes
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.discovery.candidate_search import first_calibration
from tulip_testbed.discovery.discover import discover
from tulip_testbed.discovery.dynamics_check import check_in_dynamics
from tulip_testbed.experiments.discovery_record import DiscoveryRecord, discovery_record, write_discovery
from tulip_testbed.experiments.discovery_tables import discovery_summary
from tulip_testbed.experiments.findings import Findings
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.rig_folder import RIG
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight.units import units
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class Discovered(Findings, Result):
    """The result of a discovery, see `Findings`.

    Attributes:
        folder: its run folder; None: it was not saved.
    """

    folder: Path | None = None

    @cached_property
    def _record(self) -> DiscoveryRecord:
        return discovery_record(self)

    def tables(self) -> list[Table | str]:
        """Return the verdict, the story and the tables that belong to them."""
        place = [] if self.folder is None else [f"Run folder: {self.folder}"]
        return [f"Verdict: {self.verdict}", *discovery_summary(self.to_json(), self.story), *place]

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document, which discovery.json of the run folder holds."""
        rig = None if self.folder is None or not self._record.rig else str(self.folder / RIG)
        return self._record.report.plain() | {"rig": rig}

    def save(self, folder: str | Path) -> None:
        """Write a new run folder, which appears whole or not at all.

        Raises:
            InputError: the folder exists or cannot be written.
        """
        write_discovery(Path(folder), self._record)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter, before and after."""
        before = self.before.to_frame()
        kept = [name for name in before if name.startswith(("estimate", "s.e."))]
        if self.after is None:
            return before[kept]
        return before[kept].join(self.after.to_frame()[kept], lsuffix=", before", rsuffix=", after")


def discover_effects(
    measurements: Measurements,
    robot: Robot,
    seed: int = 0,
    check: bool = True,
    workers: int = 1,
    source: str = "measurements",
    tolerances: Mapping[str, float] | None = None,
    progress: Progress = silent,
) -> Discovered:
    """Find what the nominal model lacks, adopt it if it has a name, identify the robot before and after.

    Args:
        seed: of the bootstrap that calibrates the level.
        check: simulate adopted physics in the full dynamics; saves up to two minutes if not.
        workers: processes of that simulation. Results do not depend on it.
        source: of the measurements, for messages.
        tolerances: of families of ordinary imperfections, in place of those of the measurements and those
            that fit the sensors [SI]; zero: exact.

    Raises:
        InputError: measurements that do not fit the robot, in wrong units, or too few placements.
    """
    at_least("seed", seed, 0)
    processes(workers)
    measurements = as_joined(measurements)
    nominal = nominal_robot(robot)
    check_robot(nominal.parameters, measurements, robot, source)
    unit_check = units(measurements, nominal)
    if unit_check.result == "fail":
        expected = f"expected {unit_check.expected} (the preflight says more)"
        raise InputError(f"{source}: found {unit_check.seen}; {expected}")
    check_tolerances(tolerances or {})
    # Says what does not fit, before the work.
    before = identify(measurements, robot, source, tolerances=tolerances, calibrate=first_calibration)
    with progress("looking for what is missing", 4, 0) as advance:
        discovery = discover(
            measurements,
            robot,
            seed,
            tolerances=tolerances,
            source=source,
            calibration=before.calibration,
            progress=advance,
        )
    after = None
    if discovery.adopted:
        after = identify(measurements, robot, source, adopted=discovery.adopted, tolerances=tolerances)
    checked = None
    if check and any(not one.effect.misreads for one in discovery.adopted):
        with progress("the adopted model in full dynamics", 80, 0) as advance:
            checked = check_in_dynamics(discovery, discovery.adopted, workers, advance)
    return Discovered(robot, discovery, before, after, checked, source, seed, not check)
