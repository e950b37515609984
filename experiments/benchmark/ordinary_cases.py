"""Cases of an ordinary world: random robots, half of every arm with ordinary imperfections."""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.catalogue import effects_on
from tulip_testbed.experiments.benchmark.cases import OUTSIDE_ARM, Case, Settings, in_turn
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot

NOTHING, PRIOR, CLEAR, TWICE, SCATTER = "nothing", "prior", "clear", "twice", "scatter"
FULL = {NOTHING: 60, PRIOR: 120, CLEAR: 120, TWICE: 60, OUTSIDE_ARM: 60, SCATTER: 40, "dynamics": 100}
NULLS = 0.2  # of the cases in the full dynamics


def ordinary_cases(settings: Settings, robot: Robot, plan: PosturePlan) -> list[Case]:
    """Return all cases, in an order in which every arm is spread evenly.

    The arms: `nothing` is hidden in addition to ordinary imperfections; one effect with sizes from
        its `prior`; one
    that is `clear`, large enough to be found in that laboratory and no ordinary size of its family; `twice`,
    two of the same kind; one `outside` the catalogue; nothing, but plates that `scatter` more or less than
    the data sheet says.
    """
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    numbers = tuple(int(number) for number in np.unique(plan.placement))
    effects = effects_on(None, statics=True)
    kinds = [effect.name for effect in effects]
    several = [effect.name for effect in effects if len(effect.targets.of(robot, numbers)) > 1]
    out = [Case(NOTHING, imperfect=True)] * settings.count(FULL[NOTHING])
    out += [Case(SCATTER)] * settings.count(FULL[SCATTER])
    for arm, names in ((PRIOR, kinds), (CLEAR, kinds), (TWICE, several)):
        out += _halved(arm, in_turn(names, settings.count(FULL[arm]), rng))
    outside = in_turn([fault.name for fault in OUTSIDE], settings.count(FULL[OUTSIDE_ARM]), rng)
    out += _halved(OUTSIDE_ARM, outside)
    dynamic = settings.count(FULL["dynamics"])
    nulls = round(NULLS * dynamic)
    out += [Case(NOTHING, dynamics=True, imperfect=True)] * nulls
    out += _halved(PRIOR, in_turn(kinds, dynamic - nulls, rng), dynamics=True)
    return [out[k] for k in rng.permutation(len(out))]


def _halved(arm: str, names: list[str], dynamics: bool = False) -> list[Case]:
    """Return one case a name, every second one with ordinary imperfections."""
    return [Case(arm, (name,), 0.0, dynamics, k % 2 == 0) for k, name in enumerate(names)]
