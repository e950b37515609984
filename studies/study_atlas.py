"""Measure how small the angle between two effects may be for the right one to win (docs/studies/atlas.md; minutes).

Residuals with noise and one effect at twice its detectable size are scored by the whole catalogue, on
development seeds 0 to 99, in the linear model of the shipped plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from studies.runner import Settings, header, row
from tulip_testbed.calibration.linear_model import LinearModel, linear_model
from tulip_testbed.discovery.candidate_search import DECISIVE
from tulip_testbed.discovery.columns import CandidateColumns, candidate_columns
from tulip_testbed.discovery.detectability import noncentrality
from tulip_testbed.discovery.evidence import ranked
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlases.atlas_result import Atlas
from tulip_testbed.experiments.atlases.effect_atlas import atlas
from tulip_testbed.experiments.atlases.planned_experiment import planned
from tulip_testbed.experiments.usable_plan import plan_for
from tulip_testbed.sim.robot import load_robot

SETTINGS = Settings(seed=0, only=("wii", "force-plate"))
SEEDS = 100
EDGES = (0, 5, 10, 15, 20, 25, 30, 40, 90)  # deg
PER_SEED = 6
TIMES = 2.0  # the detectable size


def drawn(
    found: Atlas, linear: LinearModel, columns: CandidateColumns, rng: np.random.Generator
) -> Iterator[tuple[float, bool, bool]]:
    """Draw some effects and rank the catalogue for each.

    Yields:
        the angle to the nearest other effect [deg], whether the right effect came first, and whether a wrong
        one led it by decisive evidence.
    """
    among = [k for k, c in enumerate(found.shown) if c.effect.sizes and c.effect.targets is not PLACEMENTS]
    label = [candidate.label for candidate in columns.candidates]
    for k in rng.choice(among, PER_SEED, replace=False):
        candidate = found.shown[k]
        points = columns.projected[label.index(candidate.label)]
        column = points[rng.integers(len(points))]
        way = candidate.prior * rng.standard_normal(len(candidate.prior))
        way = np.where(candidate.positive, np.abs(way), way)
        level = 2 * found.level if candidate.positive.any() else found.level
        length = TIMES * np.sqrt(noncentrality(len(way), level))
        signal = column @ way
        noise = linear.project(rng.standard_normal(len(signal) - 1))
        ranking = ranked([columns], signal * length / np.linalg.norm(signal) + noise)
        mine = next(s for s in ranking if s.candidate.label == candidate.label)
        right = ranking[0] is mine
        wrong = ranking[0].log_bayes_factor - mine.log_bayes_factor > DECISIVE
        yield float(np.degrees(found.nearest(k)[1])), right, wrong


def study(settings: Settings) -> Iterator[str]:
    """Yield a table for each preset, a line for each range of angles."""
    robot = load_robot()
    seeds = range(settings.seed, settings.seed + settings.count(SEEDS))
    for preset in settings.only:
        plan = planned(plan_for(robot, None), preset, robot, settings.seed)
        found = atlas(plan, np.random.default_rng(settings.seed))
        linear = linear_model(plan.observed, plan.noise)
        columns = candidate_columns(linear, [row.candidate for row in found.rows if row.size in (0, None)])
        every = np.array(
            [line for seed in seeds for line in drawn(found, linear, columns, np.random.default_rng(seed))]
        )
        yield f"\n{preset}\n\n{header('angle [deg]', 'data sets', 'right first [%]', 'wrong [%]')}"
        for low, high in pairwise(EDGES):
            inside = every[(every[:, 0] >= low) & (every[:, 0] < high)]
            if len(inside):
                right, wrong = 100 * inside[:, 1:].mean(axis=0)
                yield row(f"{low} to {high}", len(inside), f"{right:.1f}", f"{wrong:.1f}")
