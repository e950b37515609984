"""Effects that an experiment cannot show, and how far they would bias the base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel, nuisances, weighing
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.columns import effect_columns
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.rig import preset_rig


@dataclass(frozen=True)
class Undetectable:
    """An effect that the experiment cannot show.

    Attributes:
        parameter: number of the base parameter that it would bias most, from 1; 0: none.
        bias: of that parameter, for a size of one prior s.d. [m].
    """

    candidate: Candidate
    parameter: int
    bias: float


def undetectable(linear: LinearModel, candidates: Sequence[Candidate]) -> tuple[Undetectable, ...]:
    """Compute the bias of the base parameters by each effect that leaves no residual.

    Args:
        linear: the experiment without any effect.
    """
    known = np.vstack([linear.whitening(nuisances(linear.smoothed, "AFTC")), weighing(linear.smoothed)[None]])
    least_squares = np.linalg.pinv(known, rcond=np.finfo(float).eps * max(known.shape))
    absorbed = least_squares[: len(linear.theta), :-1]  # no effect changes the weighing, the last row
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
