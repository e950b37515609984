"""The settings of a Monte Carlo, checked before the work begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from tulip_testbed.base.document import Document, Seed
from tulip_testbed.base.errors import InputError, at_least, at_most, look_up
from tulip_testbed.experiments.defaults import ORDINARY
from tulip_testbed.experiments.identification_result import ESTIMATORS
from tulip_testbed.experiments.laboratory import ENGINES

CHUNK = 25  # runs a file: some seconds of work
MOST_RUNS = 1_000_000
DYNAMIC_CHUNK = 1  # a run takes about a minute, and a kill should cost no more


class MonteCarloSettings(Document):
    """Settings as run.json has them; chunk: runs in a file."""

    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    seed: Seed
    estimator: str
    robot_spread: Annotated[float, Field(gt=0, le=1)] | None
    dynamics: bool
    chunk: Annotated[int, Field(ge=1, le=CHUNK)]
    imperfections: Annotated[float, Field(ge=0)]

    @property
    def asked(self) -> Settings:
        """The settings that were asked for."""
        engine = "dynamics" if self.dynamics else "statics"
        return Settings(self.runs, self.seed, self.estimator, self.robot_spread, engine, self.imperfections)


@dataclass(frozen=True)
class Settings:
    """Everything except laboratory and plan that the results depend on.

    Attributes:
        robot_spread: of random true robots (`sim.random_robots`); None: the nominal robot.
        engine: "statics", or "dynamics": every run is held in the full dynamics.
        imperfections: scale of the ordinary imperfections of every run's laboratory; 0: it is exact.
    """

    runs: int
    seed: int
    estimator: str
    robot_spread: float | None
    engine: str = "statics"
    imperfections: float = ORDINARY

    @property
    def chunk(self) -> int:
        return DYNAMIC_CHUNK if self.engine == "dynamics" else CHUNK

    def document(self) -> MonteCarloSettings:
        """Return the settings as run.json has them."""
        return MonteCarloSettings(
            runs=self.runs,
            seed=self.seed,
            estimator=self.estimator,
            robot_spread=self.robot_spread,
            dynamics=self.engine == "dynamics",
            chunk=self.chunk,
            imperfections=float(self.imperfections),
        )


def check_settings(settings: Settings) -> None:
    """Refuse what cannot be run.

    Raises:
        InputError: names what was found and what is valid.
    """
    at_least("runs", settings.runs, 1)
    at_most("runs", settings.runs, MOST_RUNS)
    at_least("seed", settings.seed, 0)
    look_up("estimator", settings.estimator, ESTIMATORS, "estimator")
    look_up("engine", settings.engine, ENGINES, "engine")
    if settings.robot_spread is not None and not 0 < settings.robot_spread <= 1:
        raise InputError(
            f"robot_spread: found {settings.robot_spread}, expected more than 0 and at most 1 "
            "(s.d. of the logarithm of a link's mass, and of its centre of mass in half edges of its box)"
        )
