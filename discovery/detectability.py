"""How large an effect must be for an experiment to show it, and how it biases the base parameters unseen."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from pydantic import computed_field
from scipy.special import chndtrinc

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import Figure
from tulip_testbed.calibration.linear_model import LinearModel, known_beforehand, nuisances
from tulip_testbed.discovery.candidates import Candidate, Fitted, standing_out
from tulip_testbed.discovery.columns import effect_columns
from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.identification.distributions import chi2_isf
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import preset_rig

POWER = 0.9


@cache
def noncentrality(freedom: int, level: float) -> float:
    """Of chi-square that exceeds its `level` quantile with probability `POWER`."""
    return float(chndtrinc(chi2_isf(level, freedom), freedom, 1 - POWER))


def single_level(level: float, tests: float) -> float:
    """Level of one test among many that together keep `level`."""
    return float(-np.expm1(np.log1p(-level) / tests))


def least_multiple(candidate: Candidate, visible: float, level: float) -> float:
    """Least size that is found with 90 % probability, in prior s.d.; infinite: never.

    Args:
        visible: see `Fitted`.
        level: of a single test.
    """
    one_sided = 2 * level if candidate.positive.any() else level
    wanted = np.sqrt(noncentrality(len(candidate.prior), min(one_sided, 0.5)))
    return float(wanted / visible) if visible > 0 else np.inf


def detectable_size(
    candidate: Candidate, projected: np.ndarray, level: float, direction: np.ndarray | None = None
) -> float:
    """Least size that is found with 90 % probability [of the size's unit]; infinite: never.

    Args:
        projected: the candidate's columns, whitened and projected, (r + 1, s).
        level: of a single test.
        direction: of several sizes, (s,), as multiples; the first one's alone if None.
    """
    if not candidate.effect.sizes:
        return 1.0
    along = np.eye(projected.shape[1])[0] if direction is None else direction
    return least_multiple(candidate, float(np.linalg.norm(projected @ along)), level)


@dataclass(frozen=True)
class Undetectable:
    """An effect that the experiment cannot show.

    Attributes:
        parameter: number of the base parameter that it would bias most, from 1; 0: none.
        bias: of that parameter, for a size of one prior s.d. [m].
    """

    candidate: Candidate
    parameter: int
    bias: Figure


@dataclass(frozen=True)
class WeaklyDetectable:
    """An effect that the experiment shows only if it is larger than plausible.

    Attributes:
        multiple: least size that is found with 90 % probability, in prior s.d.; more than 1.
    """

    candidate: Candidate
    multiple: Figure

    @computed_field
    @property
    def least(self) -> float | None:
        """Return that size in SI units; None for an effect of several sizes."""
        prior = self.candidate.prior
        return self.multiple * float(prior[0]) if len(prior) == 1 else None

    @property
    def size(self) -> Parameter:
        """Return the first number of the effect that is a size."""
        effect = self.candidate.effect
        return effect.parameters_on(self.candidate.target)[effect.sizes[0]]


def weakly_detectable(fits: Sequence[Fitted], level: float) -> tuple[WeaklyDetectable, ...]:
    """List the effects that an experiment shows only if they are larger than plausible.

    Args:
        fits: of all candidates, each alone.
        level: of a single test among them.
    """
    sized = [one for one in fits if one.detectable and one.candidate.effect.sizes]
    least = [(one.candidate, least_multiple(one.candidate, one.visible, level)) for one in sized]
    return tuple(WeaklyDetectable(candidate, multiple) for candidate, multiple in least if multiple > 1)


def by_kind(listed: Sequence[Candidate], observed: Observation) -> dict[str, list[str]]:
    """Group effects by their kind: targets by name; none where every target of the experiment is listed."""
    numbers = standing_out(observed)
    out: dict[str, list[str]] = {}
    for one in listed:
        out.setdefault(one.effect.name, []).append(one.target)
    targets = {one.effect.name: one.effect.targets for one in listed}
    return {
        name: [] if len(found) == len(targets[name].of(observed.nominal.robot, numbers)) else found
        for name, found in sorted(out.items())
    }


def undetectable(linear: LinearModel, candidates: Sequence[Candidate]) -> tuple[Undetectable, ...]:
    """Compute the bias of the base parameters by each effect that leaves no residual.

    Args:
        linear: the experiment without any effect.
    """
    rows, _ = known_beforehand(linear.smoothed, linear.theta)
    known = np.vstack([linear.whitening(nuisances(linear.smoothed, "AFTC")), rows])
    least_squares = np.linalg.pinv(known, rcond=np.finfo(float).eps * max(known.shape))
    absorbed = least_squares[: len(linear.theta), : -len(rows)]  # no effect changes what was known before
    return tuple(_undetectable(linear, absorbed, candidate) for candidate in candidates)


def _undetectable(linear: LinearModel, absorbed: np.ndarray, candidate: Candidate) -> Undetectable:
    if not candidate.effect.sizes:
        return Undetectable(candidate, 0, 0.0)
    effect = effect_columns(linear, candidate, 0) * candidate.prior
    moved = absorbed @ effect if effect.any() else _change_of_robot(linear.observed, candidate)[:, None]
    at = np.unravel_index(np.abs(moved).argmax(), moved.shape)
    if not moved[at]:
        return Undetectable(candidate, 0, 0.0)
    return Undetectable(candidate, int(at[0]) + 1, float(np.abs(moved[at])))


def _change_of_robot(observed: Observation, candidate: Candidate) -> np.ndarray:
    """Compute how the robot's own base parameters change with the effect, (p,) [m]."""
    nominal = observed.nominal
    sizes = np.zeros(len(candidate.prior))
    sizes[0] = candidate.prior[0]
    rig = candidate.effect.inject(
        preset_rig("ideal", nominal.robot), candidate.target, candidate.values(sizes)
    )
    if rig.edit is None:
        return np.zeros(len(nominal.value))
    try:
        return true_base_parameters(rig, nominal.parameters.support) - nominal.value
    except InputError:  # a sole that is no plane any more says nothing about the robot's masses
        return np.zeros(len(nominal.value))
