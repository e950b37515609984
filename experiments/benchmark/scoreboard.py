"""Predictions before any data: how large an effect must be, and what looks like it.

Everything here is of the nominal laboratory and the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel, linear_model
from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.detectability import noncentrality, single_level
from tulip_testbed.discovery.evidence import DETECTABLE, effective_tests
from tulip_testbed.discovery.refit import exact_rig, measured_plan, simulated, without_noise
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.instance import split_label
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.identification.residual_noise import noise_of
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

REFERENCE = 999  # stream of the one nominal experiment at which columns are taken


@dataclass(frozen=True)
class Board:
    """A plan in a nominal laboratory, and what every candidate of the catalogue shows there.

    Attributes:
        quiet: the same laboratory with nothing random but friction.
        candidates: of the whole catalogue.
        projected: columns of every candidate at every grid point, whitened and projected, (r + 1, s).
        bases: orthonormal, of what a candidate can visibly show within its prior, by grid point.
        level: of a single test among the catalogue's.
    """

    rig: Rig
    plan: PosturePlan
    solved_plan: SolvedPlan
    quiet: SolvedPlan
    linear: LinearModel
    candidates: list[Candidate]
    projected: list[list[np.ndarray]]
    bases: list[list[np.ndarray]]
    level: float

    def wanted(self, candidate: Candidate) -> float:
        """Length of a signal that is found with 90 % probability."""
        return wanted(candidate, self.level)

    def angles(self, signal: np.ndarray) -> dict[str, float]:
        """Angle between a signal and what each candidate can show, by label [rad]."""
        return angles(signal, self.candidates, self.bases)

    def twins(self, signal: np.ndarray, own: Sequence[str] = ()) -> tuple[str, ...]:
        """Candidates that can look like a signal; those in `own`, labels or names, are not asked."""
        near = self._others(signal, own)
        return tuple(label for label, angle in near.items() if angle < ISOLABLE)

    def remainder(self, signal: np.ndarray, own: Sequence[str] = ()) -> float:
        """Return the residual of the closest other candidate as a multiple of the detection limit."""
        nearest = min(self._others(signal, own).values())
        return float(np.linalg.norm(signal) * np.sin(nearest) / np.sqrt(noncentrality(1, self.level)))

    def _others(self, signal: np.ndarray, own: Sequence[str]) -> dict[str, float]:
        near = self.angles(signal).items()
        return {k: angle for k, angle in near if k not in own and split_label(k)[0] not in own}

    def signal(self, change: Callable[[Rig], Rig]) -> np.ndarray:
        """Return the change of the readings by one of the laboratory, whitened and projected, (r + 1,)."""
        observed, theta = self.linear.observed, self.linear.theta
        rig, plan = exact_rig(observed), measured_plan(observed)
        with_it, without = (observe(simulated(one, plan), observed.nominal) for one in (change(rig), rig))
        after, before = residuals(with_it, theta), residuals(without, theta)
        rows = {int(number): k for k, number in enumerate(without.measurements.posture)}
        out = np.zeros((len(observed), 11))
        for k, number in enumerate(with_it.measurements.posture):
            if (at := rows.get(int(number))) is not None:
                out[int(number) - 1] = after[k] - before[at]
                out[int(number) - 1, 3:5] *= with_it.on_four_cells[k] & without.on_four_cells[at]
        return self.linear.project(self.linear.whitening(out))


def wanted(candidate: Candidate, level: float) -> float:
    """Length of a signal that a single test of this level finds with 90 % probability."""
    one_sided = candidate.positive.any() or not candidate.effect.sizes
    at = 2 * level if one_sided else level
    return float(np.sqrt(noncentrality(max(len(candidate.effect.sizes), 1), at)))


def angles(
    signal: np.ndarray, candidates: Sequence[Candidate], bases: Sequence[Sequence[np.ndarray]]
) -> dict[str, float]:
    """Angle between a signal and what each candidate can show, by label [rad].

    Args:
        bases: of every candidate at every grid point, see `visible`.
    """
    length = np.linalg.norm(signal)
    return {
        candidate.label: min(
            float(np.arccos(min(1.0, np.linalg.norm(basis.T @ signal) / length))) for basis in each
        )
        for candidate, each in zip(candidates, bases, strict=True)
    }


@cache
def board(preset: str, folder: Path = DEFAULT_PLAN) -> Board:
    """Of a preset's laboratory of TULip and a plan; made once in every process.

    Raises:
        InputError: a plan that does not fit.
    """
    robot = load_robot()
    plan, rig = read_plan(folder, robot), preset_rig(preset, robot)
    solved_plan = solve_plan(rig, plan)
    measured = run_statics(solved_plan, [np.random.SeedSequence(REFERENCE)])[0].measurements
    observed = observe(measured, nominal_robot(robot))
    linear = linear_model(observed, noise_of(observed))
    columns = candidate_columns(linear, candidates(observed))
    level = single_level(LEVEL, effective_tests([columns], np.random.default_rng(0)))
    bases = [
        [visible(candidate, column) for column in points]
        for candidate, points in zip(columns.candidates, columns.projected, strict=True)
    ]
    return Board(
        rig,
        plan,
        solved_plan,
        solve_plan(without_noise(rig), plan),
        linear,
        columns.candidates,
        columns.projected,
        bases,
        level,
    )


def visible(candidate: Candidate, columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what a candidate can show, (r + 1, k)."""
    scaled = columns * candidate.prior if candidate.effect.sizes else columns
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    return left[:, size > DETECTABLE]
