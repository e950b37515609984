"""The settings of a Monte Carlo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from tulip_testbed.base.document import Seed
from tulip_testbed.base.errors import at_least, at_most, look_up
from tulip_testbed.experiments.defaults import ORDINARY
from tulip_testbed.experiments.identification_result import ESTIMATORS
from tulip_testbed.experiments.laboratory import ENGINES
from tulip_testbed.sim.random_robots import check_spread

CHUNK = 25  # runs a file: some seconds of work
MOST_RUNS = 1_000_000


@dataclass(frozen=True)
class Settings:
    """Everything except laboratory and plan that the results depend on, as run.json has it.

    Attributes:
        robot_spread: of random true robots (`sim.random_robots`); None: the nominal robot.
        engine: "statics", or "dynamics": every run is held in the full dynamics.
        imperfections: scale of the ordinary imperfections of every run's laboratory; 0: it is exact.
    """

    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    seed: Seed
    estimator: str
    robot_spread: Annotated[float, Field(gt=0, le=1)] | None
    engine: Annotated[str, Field(pattern="^(statics|dynamics)$")] = "statics"
    imperfections: Annotated[float, Field(ge=0)] = ORDINARY

    @property
    def chunk(self) -> int:
        """Return the runs in a file; one run of the dynamics takes a minute, and a kill costs no more."""
        return 1 if self.engine == "dynamics" else CHUNK

    def check(self) -> None:
        """Refuse what cannot be run."""
        at_least("runs", self.runs, 1)
        at_most("runs", self.runs, MOST_RUNS)
        at_least("seed", self.seed, 0)
        look_up("estimator", self.estimator, ESTIMATORS, "estimator")
        look_up("engine", self.engine, ENGINES, "engine")
        if self.robot_spread is not None:
            check_spread(self.robot_spread)
