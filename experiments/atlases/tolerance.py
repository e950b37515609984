"""How exactly a laboratory must be set up: bias by small errors of plates, floor, encoders and cells."""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.result import Array, InMemory, Result
from tulip_testbed.base.table import Table
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.experiments.atlases.planned_experiment import BiasWeights, Planned

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
LARGE = 1000.0  # units: more than anybody would call a tolerance


@dataclass(frozen=True)
class ErrorSource:
    """One error of the set-up.

    Attributes:
        parameter: of the effect. unit: in words. amount: of one unit [SI].
        bias_se: of every parameter by one unit, in standard errors, (p,).
        allowed_units, allowed: of this error alone, which bias no parameter by more than half a standard
            error; the second in SI units.
    """

    effect: str
    target: str | None
    parameter: str
    unit: str
    amount: float
    bias_se: Array
    allowed_units: float
    allowed: float

    @property
    def label(self) -> str:
        """Return effect and target, and the parameter if the effect has several."""
        several = len(catalogue()[self.effect].sizes) > 1
        return effect_label(self.effect, self.target) + (f" {self.parameter}" if several else "")


@dataclass(frozen=True)
class ErrorKind:
    """All errors of a kind.

    Attributes:
        alone_units: of the worst one alone.
        together_units: s.d. of all, independent, that keep the root mean square bias there.
    """

    effect: str
    unit: str
    alone_units: float
    together_units: float


@dataclass(frozen=True, eq=False, repr=False)
class Tolerance(Result):
    """Biases of a plan by errors of the set-up, to first order.

    Attributes:
        postures: that can be measured, of so many `planned` ones.
        standard_error_m: of the base parameters by the default estimator, (p,) [m].
    """

    preset: str
    seed: int
    postures: int
    allowed_bias_se: float
    parameters: tuple[str, ...]
    standard_error_m: Array
    sources: tuple[ErrorSource, ...]
    kinds: tuple[ErrorKind, ...]
    planned: InMemory[int]

    def tables(self) -> list[Table | str]:
        numbers = range(1, len(self.parameters) + 1)
        numbered = [Column(str(number), format=".2f", extra=True) for number in numbers]
        biases = Table(
            "Bias of every parameter, by its number, in standard errors of the default estimator",
            ("error", "of", *numbered),
            [[source.label, source.unit, *source.bias_se.tolist()] for source in self.sources],
            "`tulip robot` tells the names of the parameters.",
        )
        return [
            f"{self.postures} of {self.planned} postures can be measured.",
            biases,
            self.tolerance_table(),
            f"The largest bias is {max(np.abs(source.bias_se).max() for source in self.sources):.2f} s.e.",
        ]

    def tolerance_table(self) -> Table:
        allowed = ("allowed alone", "", ".2g"), ("allowed s.d. if all of a kind err", "", ".2g")
        heads = ("error", "of", "biases most", ("by", "s.e.", "+.3f"), *allowed, "unit")
        rows, kinds = [], {kind.effect: kind.together_units for kind in self.kinds}
        for source in self.sources:
            worst = int(np.abs(source.bias_se).argmax())
            amount, unit = source.unit.split(" ")
            limits = [source.allowed_units, kinds.pop(source.effect, None)]  # of a kind in its first row
            alone, together = (
                units and (float(amount) * units if units <= LARGE else "any") for units in limits
            )
            biased = self.parameters[worst], float(source.bias_se[worst])
            rows.append([source.label, source.unit, *biased, alone, together, unit])
        title = f"Tolerances that keep the bias of every parameter below {ALLOWED} standard errors"
        return Table(title, heads, rows)


def _kept(bias: np.ndarray) -> float:
    """Return how many units keep the largest of some biases at what is allowed."""
    worst = float(bias.max())
    return ALLOWED / worst if worst > NO_BIAS else np.inf


def tolerance(planned: Planned) -> Tolerance:
    estimator, sources, kinds = BiasWeights(planned), list[ErrorSource](), list[ErrorKind]()
    for name, (amount, words) in UNITS.items():
        effect, of_kind = catalogue()[name], list[ErrorSource]()
        for candidate in candidates(planned.observed, {name: effect}):
            biases = amount * estimator.change(candidate, 0) / planned.standard_errors[:, None]
            for size, bias in zip(effect.sizes, biases.T, strict=True):
                units, parameter = _kept(np.abs(bias)), effect.parameters[size].name
                of = candidate.target or None, parameter, words, float(amount)
                of_kind.append(ErrorSource(name, *of, bias, units, units * amount))
        together = _kept(np.sqrt(sum(source.bias_se**2 for source in of_kind)))
        kinds.append(ErrorKind(name, words, min(source.allowed_units for source in of_kind), together))
        sources += of_kind
    return Tolerance(
        preset=planned.sensors,
        seed=planned.seed,
        postures=len(planned.observed),
        allowed_bias_se=ALLOWED,
        parameters=planned.nominal.parameters.names,
        standard_error_m=planned.standard_errors,
        sources=tuple(sources),
        kinds=tuple(kinds),
        planned=len(planned.plan),
    )
