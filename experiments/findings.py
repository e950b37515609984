"""Findings of a discovery: verdict, effects, the estimate before and after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from tulip_testbed.base.errors import InputError
from tulip_testbed.discovery.discover import Discovery
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.discovery.next_experiment import NextExperiment
from tulip_testbed.discovery.story import story
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.identify import Identification
from tulip_testbed.experiments.proposed_experiment import Proposals, propose_experiments
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class Findings:
    """Findings of a discovery, and the changes of the estimate.

    Attributes:
        robot: the nominal robot.
        discovery: candidates, evidence, held-out residuals, verdict.
        before, after: the robot identified without corrections, and with the adopted effects removed; None:
            there are none. Both by the self-calibrating estimator, which estimates ordinary imperfections.
        source: of the measurements. seed: of the bootstrap. no_check: whether no simulation was asked for.
        check: the adopted physics in the full dynamics; None: nothing to simulate, or not asked for.
    """

    robot: Robot
    discovery: Discovery
    before: Identification
    after: Identification | None
    check: DynamicsCheck | None
    source: str = "measurements"
    seed: int = 0
    no_check: bool = False

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
