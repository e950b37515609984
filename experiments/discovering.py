"""The whole discovery: search, identification before and after, check in the full dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tulip_testbed.base.errors import InputError, at_least
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.base.threads import processes
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING
from tulip_testbed.calibration.families import check_tolerances
from tulip_testbed.discovery.discover import ADOPTED, AMBIGUOUS, CALIBRATED, NONE, Discovery, discover
from tulip_testbed.discovery.dynamics_check import DynamicsCheck, check_in_dynamics
from tulip_testbed.discovery.proposals import Proposal, proposals
from tulip_testbed.discovery.story import story
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.discovery_tables import weak_table
from tulip_testbed.experiments.identify import Identification, identify, plain_estimator
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.preflight.units import units
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class Discovered(Shown):
    """The result of a discovery, and the changes of the estimate.

    Attributes:
        robot: the nominal robot.
        discovery: candidates, evidence, held-out residuals, verdict.
        before, after: the robot identified without and with what was adopted; None: nothing was.
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

    @cached_property
    def proposals(self) -> list[Proposal]:
        """Experiments that would separate what is ambiguous, the best first."""
        return next_experiments(self.discovery)

    @cached_property
    def story(self) -> list[str]:
        """The finding in sentences, the most important first."""
        return story(self.discovery, self.proposals)

    def parts(self) -> list[Table | str]:
        """Return the verdict and the story; without a gap, which effects may hide as well."""
        words: list[Table | str] = [f"Verdict: {self.verdict}", *self.story]
        weak = weak_table([one.document() for one in self.discovery.selection.weak])
        return [*words, weak] if self.verdict == NONE and weak.rows else words

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter, identified before and after."""
        before, after = self.before.to_frame(), (self.after or self.before).to_frame()
        kept = [name for name in before if name.startswith(("estimate", "s.e."))]
        return before[kept].join(after[kept], lsuffix=", before", rsuffix=", after")


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
    found = units(measurements, nominal)
    if found.result == "fail":
        raise InputError(f"{source}: found {found.seen}; expected {found.expected} (the preflight says more)")
    check_tolerances(tolerances or {})
    # Says what does not fit, before the work.
    before = identify(measurements, robot, source, plain_estimator(measurements))
    steps = progress("looking for what is missing", 4)
    discovery = discover(measurements, robot, seed, tolerances=tolerances, source=source, progress=steps)
    after = None
    if discovery.verdict in (*ADOPTED, CALIBRATED):
        after = identify(
            measurements,
            robot,
            source,
            SELF_CALIBRATING,
            adopted=discovery.adopted,
            tolerances=tolerances,
        )
    checked = None
    if check and any(not one.effect.misreads for one in discovery.adopted):
        steps = progress("the adopted model in full dynamics", 80)
        checked = check_in_dynamics(discovery, discovery.adopted, workers, steps)
    return Discovered(robot, discovery, before, after, checked)


def next_experiments(found: Discovery) -> list[Proposal]:
    """Propose experiments that would separate the equivalent explanations of an ambiguous discovery."""
    if found.verdict != AMBIGUOUS:
        return []
    out: list[Proposal] = []
    for k in found.effects:
        if len(explanations := found.equivalents[k]) > 1:
            out += proposals(found.selection.null.linear, explanations)
    return sorted({p.words: p for p in out}.values(), key=lambda p: -p.separation)
