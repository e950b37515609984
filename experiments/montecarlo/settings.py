"""What a Monte Carlo is told to do, checked before the work begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tulip_testbed.experiments.montecarlo.engine import ENGINES
from tulip_testbed.experiments.preparation import at_least
from tulip_testbed.identification.estimators import ESTIMATORS
from tulip_testbed.sim.errors import InputError, look_up

CHUNK = 25  # runs a file: some seconds of work
DYNAMIC_CHUNK = 1  # a run takes about a minute, and a kill should cost no more


@dataclass(frozen=True)
class Settings:
    """Everything beside laboratory and plan that the results depend on.

    Attributes:
        spread: of random true robots (`sim.random_robots`); None: the nominal robot.
        dynamics: whether every run is held in the full dynamics.
    """

    runs: int
    seed: int
    estimator: str
    spread: float | None
    dynamics: bool

    @property
    def chunk(self) -> int:
        return DYNAMIC_CHUNK if self.dynamics else CHUNK

    def document(self) -> dict[str, Any]:
        """For run.json."""
        return {
            "runs": self.runs,
            "seed": self.seed,
            "estimator": self.estimator,
            "random_robots": self.spread,
            "dynamics": self.dynamics,
            "chunk": self.chunk,
        }


def check_settings(settings: Settings, engine: str, address: str | None) -> None:
    """Refuse what cannot be run.

    Raises:
        InputError: names the option, what was found and what is valid.
    """
    at_least("--runs", settings.runs, 1)
    look_up("estimator", settings.estimator, ESTIMATORS, "--estimator")
    look_up("engine", engine, ENGINES, "--engine")
    if (engine == "dask") != (address is not None):
        raise InputError(
            f"--engine {engine}: found {'no ' if address is None else ''}--address; expected "
            + (
                "the scheduler's address, tcp://HOST:PORT"
                if engine == "dask"
                else "it with --engine dask only"
            )
        )
    if settings.spread is not None and not 0 < settings.spread <= 1:
        raise InputError(
            f"--random-robots: found {settings.spread}, expected more than 0 and at most 1 "
            "(s.d. of the logarithm of a link's mass, and of its centre of mass in half edges of its box)"
        )
