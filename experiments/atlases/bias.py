"""The bias of the identified parameters by an effect that is not modelled.

To first order an estimate by generalised least squares moves by (H'V^-1 H)^-1 H'V^-1 d, d being what the
effect adds to the residuals of the centre of pressure. An effect that changes the robot itself (a payload, a
wrong length) moves, besides, what is estimated. Both together are the bias against the nominal robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel, linear_model
from tulip_testbed.discovery.candidates import Candidate
from tulip_testbed.discovery.columns import effect_columns, presence_column
from tulip_testbed.effects.true_robot import true_base_parameters, true_model
from tulip_testbed.experiments.atlases.planned_experiment import Planned
from tulip_testbed.identification.residual_channels import ROWS, SIZE
from tulip_testbed.sim.rig import Rig


@dataclass(frozen=True)
class BiasWeights:
    """The estimator about a planned experiment.

    Attributes:
        linear: of channel A alone.
        regressor: whitened, (r, p).
    """

    linear: LinearModel
    regressor: np.ndarray

    def change(self, candidate: Candidate, point: int) -> np.ndarray:
        """Of the estimate by an effect, (p, s) [m per unit of each size]; one without size: (p, 1) [m]."""
        if candidate.effect.sizes:
            added = effect_columns(self.linear, candidate, point)
        else:
            # The planned readings are free of it; taking it away from them brings it in.
            added = -presence_column(self.linear, candidate, point)
        return np.linalg.lstsq(self.regressor, added, rcond=None)[0]


def weights(planned: Planned) -> BiasWeights:
    """Return the covariance of the default estimator, with the noise that the data sheets state."""
    linear = linear_model(planned.observed, planned.noise, "A")
    regressor = planned.nominal.parameters.regressor(linear.smoothed.joint_angles)
    rows = np.zeros((len(planned.observed), SIZE, regressor.shape[2]))
    rows[:, ROWS["A"]] = regressor
    return BiasWeights(linear, linear.whitening(rows))


def own_change(planned: Planned, candidate: Candidate, point: int) -> np.ndarray:
    """Of the robot's own base parameters by an effect that is on or in it, (p, s) [m].

    The sizes take their priors' s.d. one after the other: a payload's place counts once it has a mass.
    """
    count, prior = max(len(candidate.effect.sizes), 1), candidate.prior
    out = np.zeros((len(planned.standard_errors), count))
    if not _changes_robot(planned, _with(planned.rig, candidate, prior, point)):
        return out
    before = planned.nominal.value
    for k in range(len(candidate.effect.sizes)):
        sizes = prior * (np.arange(count) <= k)
        changed = _with(planned.rig, candidate, sizes, point)
        after = true_base_parameters(changed, planned.nominal.parameters.support)
        out[:, k] = after - before
        before = after
    return out


def _changes_robot(planned: Planned, rig: Rig) -> bool:
    """Whether its masses or lengths are others; an edit may as well concern the world or the soles."""
    if rig.edit is planned.rig.edit:
        return False
    after, before = true_model(rig), true_model(planned.rig)
    return any(
        not np.array_equal(getattr(after, name), getattr(before, name))
        for name in ("body_mass", "body_ipos", "body_pos", "jnt_pos")
    )


def bias(planned: Planned, estimator: BiasWeights, candidate: Candidate, point: int) -> np.ndarray:
    """Against the nominal robot, at one prior s.d. of each size, (p, s) [m]; without size: (p, 1)."""
    unit = candidate.prior if candidate.effect.sizes else np.ones(1)
    return estimator.change(candidate, point) * unit + own_change(planned, candidate, point)


def _with(rig: Rig, candidate: Candidate, sizes: np.ndarray, point: int) -> Rig:
    return candidate.effect.inject(rig, candidate.target, candidate.values(sizes, point))
