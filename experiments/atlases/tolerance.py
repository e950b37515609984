"""How exactly a laboratory must be set up: bias by small errors of plates, floor, encoders and cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column, columns
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import finite
from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.experiments.atlases.planned_experiment import (
    BiasWeights,
    Planned,
    estimates,
    noisy,
    streams,
)
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.statics.solved_plan import solve_plan

# Effect, and the amount that a laboratory thinks in.
UNITS = {
    "plate-translation": (1e-3, "1 mm"),
    "plate-yaw": (np.radians(0.1), "0.1 deg"),
    "tilt": (np.radians(0.1), "0.1 deg"),
    "encoder-offset": (np.radians(0.1), "0.1 deg"),
    "cell-gain": (0.01, "1 %"),
}
ALLOWED = 0.5  # standard errors of bias, in every parameter
NO_BIAS = 1e-6  # standard errors: rounding
CHECKED = 5  # runs of the simulation
LARGE = 1000.0  # units: more than anybody would call a tolerance


@dataclass(frozen=True)
class ErrorSource:
    """One error of the set-up.

    Attributes:
        size: number among the effect's sizes. amount: of one unit [SI]. words: that unit.
    """

    candidate: Candidate
    size: int
    amount: float
    words: str

    @property
    def parameter(self) -> str:
        return self.candidate.effect.parameters[self.candidate.effect.sizes[self.size]].name

    @property
    def label(self) -> str:
        """Return effect and target, and the parameter if the effect has several."""
        return self.candidate.label + f" {self.parameter}" * (len(self.candidate.effect.sizes) > 1)

    @property
    def sizes(self) -> np.ndarray:
        """Return one unit of this error as sizes of the effect, (s,)."""
        return self.amount * (np.arange(len(self.candidate.effect.sizes)) == self.size)


@dataclass(frozen=True, eq=False, repr=False)
class Tolerance(Result):
    """Biases of a plan by errors of the set-up.

    Attributes:
        sources: n of them.
        bias: predicted, of one unit, in standard errors, (n, p).
        simulated: the same by the static laboratory, mean over runs, (n, p).
        spread: standard error of that mean, (n, p).
    """

    planned: Planned
    sources: tuple[ErrorSource, ...]
    bias: np.ndarray
    simulated: np.ndarray
    spread: np.ndarray

    def allowed(self, number: int) -> float:
        """Units of one error alone that bias no parameter by more than half a standard error."""
        return _kept(np.abs(self.bias[number]))

    def together(self, effect: str) -> float:
        """S.d. in units of all errors of a kind, independent, that keep the root mean square bias there."""
        return _kept(np.sqrt((self.bias[self._of(effect)] ** 2).sum(axis=0)))

    def _of(self, effect: str) -> list[int]:
        return [k for k, source in enumerate(self.sources) if source.candidate.effect.name == effect]

    def tables(self) -> list[Table | str]:
        difference = np.abs(self.simulated - self.bias)
        k, j = np.unravel_index(int(difference.argmax()), difference.shape)
        names = self.planned.nominal.parameters.names
        numbered = [Column(str(number), format=".2f", extra=True) for number in range(1, len(names) + 1)]
        biases = Table(
            "Bias of every parameter, by its number, in standard errors of the default estimator",
            columns("error", "of", *numbered),
            [[s.label, s.words, *bias.tolist()] for s, bias in zip(self.sources, self.bias, strict=True)],
            "`tulip robot` tells the names of the parameters.",
        )
        return [
            f"{len(self.planned.observed)} of {len(self.planned.plan)} postures can be measured.",
            biases,
            self.tolerance_table(),
            f"Checked by simulation ({CHECKED} runs with and without each error): the largest difference "
            f"from the prediction is {difference[k, j]:.2f} s.e. ({self.sources[k].label}, {names[j]}); the "
            f"largest bias is {np.abs(self.bias).max():.2f} s.e.",
        ]

    def tolerance_table(self) -> Table:
        biases = ("by", "s.e.", "+.3f"), ("simulated", "s.e.", "+.3f")
        allowed = ("allowed alone", "", ".2g"), ("allowed s.d. if all of a kind err", "", ".2g")
        heads = columns("error", "of", "biases most", *biases, *allowed, "unit")
        names, rows, told = self.planned.nominal.parameters.names, [], set()
        for k, source in enumerate(self.sources):
            worst = int(np.abs(self.bias[k]).argmax())
            effect = source.candidate.effect.name
            amount, unit = UNITS[effect][1].split(" ")
            alone, together = (
                float(amount) * units if units <= LARGE else "any"
                for units in (self.allowed(k), self.together(effect))
            )
            rows.append(
                [
                    source.label,
                    source.words,
                    names[worst],
                    float(self.bias[k, worst]),
                    float(self.simulated[k, worst]),
                    alone,
                    None if effect in told else together,
                    unit,
                ]
            )
            told.add(effect)
        title = f"Tolerances that keep the bias of every parameter below {ALLOWED} standard errors"
        return Table(title, heads, rows)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON document; biases in standard errors, amounts in SI units."""
        planned, difference = self.planned, np.abs(self.simulated - self.bias)
        return finite(
            {
                "preset": planned.sensors,
                "seed": planned.seed,
                "postures": len(planned.observed),
                "allowed_bias_se": ALLOWED,
                "parameters": list(planned.nominal.parameters.names),
                "standard_error_m": planned.standard_errors.tolist(),
                "sources": [
                    {
                        "effect": source.candidate.effect.name,
                        "target": source.candidate.target or None,
                        "parameter": source.parameter,
                        "unit": source.words,
                        "amount": source.amount,
                        "bias_se": self.bias[k].tolist(),
                        "simulated_bias_se": self.simulated[k].tolist(),
                        "allowed_units": self.allowed(k),
                        "allowed": self.allowed(k) * source.amount,
                    }
                    for k, source in enumerate(self.sources)
                ],
                "kinds": [
                    {
                        "effect": name,
                        "unit": words,
                        "alone_units": min(map(self.allowed, self._of(name))),
                        "together_units": self.together(name),
                    }
                    for name, (_, words) in UNITS.items()
                ],
                "check": {
                    "runs": CHECKED,
                    "largest_difference_se": float(difference.max()),
                    "largest_bias_se": float(np.abs(self.bias).max()),
                },
            }
        )


def _kept(bias: np.ndarray) -> float:
    worst = float(bias.max())
    return ALLOWED / worst if worst > NO_BIAS else np.inf


def sources(planned: Planned) -> tuple[ErrorSource, ...]:
    effects = {name: catalogue()[name] for name in UNITS}
    return tuple(
        ErrorSource(candidate, size, *UNITS[candidate.effect.name])
        for candidate in candidates(planned.observed, effects)
        for size in range(len(candidate.effect.sizes))
    )


def tolerance(planned: Planned, progress: Progress = silent) -> Tolerance:
    estimator, every = BiasWeights(planned), sources(planned)
    predicted = np.array([estimator.change(source.candidate, 0) @ source.sizes for source in every])
    plain = planned.runs[:CHECKED]
    without = estimates(plain, planned.nominal)
    moved = []
    with progress("simulating errors", len(every), 0) as advance:
        for source in every:
            moved.append(estimates(erring(planned, source), planned.nominal) - without)
            advance(1)
    shifts = np.array(moved) / planned.standard_errors
    spread = shifts.std(axis=1, ddof=1) / np.sqrt(len(plain))
    return Tolerance(planned, every, predicted / planned.standard_errors, shifts.mean(axis=1), spread)


def erring(planned: Planned, source: ErrorSource) -> list[Measurements]:
    """Repeat the first runs with one unit of an error: the same random numbers."""
    candidate = source.candidate
    rig = candidate.effect.inject(planned.rig, candidate.target, candidate.values(source.sizes))
    # What instruments make of readings moves nothing.
    only_misread = replace(rig, misread=None) == planned.rig
    solved = planned.solved_plan
    solved = replace(solved, rig=rig) if only_misread else solve_plan(rig, solved.plan)
    return noisy(solved, streams(planned.seed, CHECKED))
