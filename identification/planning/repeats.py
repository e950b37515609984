"""Repeated postures in a plan, for pure error: what differs though nothing was meant to."""

from __future__ import annotations

import dataclasses

import numpy as np

from tulip_testbed.sim.measurements import PosturePlan


def with_repeats(plan: PosturePlan, count: int, seed: int) -> PosturePlan:
    """A plan in which `count` postures come twice, with the same number.

    Half of them (rounded up) at the end of their own placement: their pure error is that of readings and
    approach. The others each on a placement of its own with the same foot pose, so that the plates are laid
    and recorded anew: theirs holds the placement's error too.

    Args:
        count: at most the plan's postures.
        seed: of the choice.
    """
    order = np.random.default_rng([seed, count, 2]).permutation(len(plan))
    # Not a placement's last posture: its repeat would follow at once, without a new approach.
    last = np.append(plan.placement[1:] != plan.placement[:-1], True)
    within = np.sort(order[~last[order]][: (count + 1) // 2])
    anew = np.sort(order[~np.isin(order, within)][: count - len(within)])
    rows: list[int] = []
    for number in dict.fromkeys(plan.placement.tolist()):
        there = np.flatnonzero(plan.placement == number)
        rows += [*there.tolist(), *within[np.isin(within, there)].tolist()]
    placement = np.append(plan.placement[rows], plan.placement.max() + 1 + np.arange(len(anew)))
    chosen = np.append(rows, anew).astype(int)
    repeats = {"within_placement": plan.posture[within].tolist(), "placed_anew": plan.posture[anew].tolist()}
    return dataclasses.replace(plan.take(chosen), placement=placement, made=plan.made | {"repeats": repeats})
