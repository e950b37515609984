"""The whole discovery: search, identification before and after by one estimator, check in full dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tulip_testbed.base.errors import InputError, at_least
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.base.threads import processes
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.discovery.candidate_search import first_calibration
from tulip_testbed.discovery.discover import NONE, Discovery, discover
from tulip_testbed.discovery.dynamics_check import DynamicsCheck, check_in_dynamics
from tulip_testbed.discovery.next_experiment import NextExperiment
from tulip_testbed.discovery.story import story
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.discovery_tables import weak_table
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.proposed_experiment import Proposals, propose_experiments
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight.units import units
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, PosturePlan, as_joined
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class Discovered(Shown):
    """The result of a discovery, and the changes of the estimate.

    Attributes:
        robot: the nominal robot.
        discovery: candidates, evidence, held-out residuals, verdict.
        before, after: the robot identified without corrections, and with the adopted effects removed; None:
            there are none. Both by the self-calibrating estimator, which estimates ordinary imperfections.
        check: the adopted physics in the full dynamics; None: nothing to simulate, or not asked for.
    """

    robot: Robot
    discovery: Discovery
    before: Identification
    after: Identification | None
    check: DynamicsCheck | None

    @property
    def verdict(self) -> str:
        """ "none", "calibrated", "named", "described", "ambiguous" or "unknown"."""
        return self.discovery.verdict

    @property
    def adopted(self) -> tuple[EffectInstance, ...]:
        """The effects that are added to the model; empty unless it is "named" or "described"."""
        return self.discovery.adopted

    @property
    def calibrated(self) -> tuple[EffectInstance, ...]:
        """The ordinary imperfections that are added to the model."""
        return self.discovery.calibrated

    def propose(self, plan: PosturePlan | None = None, seed: int = 0) -> Proposals:
        """Rank the experiments that would settle what is ambiguous, see `propose_experiments`."""
        found = self.discovery
        measured = found.observed.measurements
        return propose_experiments(measured, self.robot, found.verdict, found.explanations, plan, seed)

    @cached_property
    def ranking(self) -> tuple[NextExperiment, ...]:
        """Experiments of the measured postures that would settle what is ambiguous, the best first."""
        try:
            return self.propose().experiments
        except InputError:  # none can be weighed, which the story says
            return ()

    @cached_property
    def story(self) -> list[str]:
        """The finding in sentences, the most important first."""
        return story(self.discovery, self.ranking)

    def parts(self) -> list[Table | str]:
        """Return the verdict and the story; without a gap, which effects may hide as well."""
        words: list[Table | str] = [f"Verdict: {self.verdict}", *self.story]
        weak = weak_table([one.document() for one in self.discovery.selection.weak])
        return [*words, weak] if self.verdict == NONE and weak.rows else words

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row a parameter: before and, if effects were adopted, after."""
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
    progress: Callable[[str, int], Callable[[int], None]] = lambda what, total: lambda count: None,
) -> Discovered:
    """Find what the nominal model lacks, adopt it if it has a name, identify the robot before and after.

    Args:
        seed: of the bootstrap that calibrates the level.
        check: simulate adopted physics in the full dynamics; saves up to two minutes if not.
        workers: processes of that simulation. Results do not depend on it.
        source: of the measurements, for messages.
        tolerances: of families of ordinary imperfections, in place of those of the measurements and those
            that fit the sensors [SI]; zero: exact.
        progress: called with a stage's name and its number of steps; gives what is called with each step.

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
    discovery = discover(
        measurements,
        robot,
        seed,
        tolerances=tolerances,
        source=source,
        calibration=before.calibration,
        progress=progress("looking for what is missing", 4),
    )
    after = None
    if discovery.adopted:
        after = identify(measurements, robot, source, adopted=discovery.adopted, tolerances=tolerances)
    checked = None
    if check and any(not one.effect.misreads for one in discovery.adopted):
        steps = progress("the adopted model in full dynamics", 80)
        checked = check_in_dynamics(discovery, discovery.adopted, workers, steps)
    return Discovered(robot, discovery, before, after, checked)
