"""Compare a posture with the last time that it was measured: no model of the robot enters but its change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.recursive_estimate import ANEW
from tulip_testbed.experiments.watching.row_columns import RowColumns
from tulip_testbed.experiments.watching.watch_state import Earlier, WatchState
from tulip_testbed.identification.distributions import chi2_sf


def repeat_probability(model: DayModel, state: WatchState, columns: RowColumns, planned: int) -> float:
    """Return the p-value of the difference from the last time; 1 if there was none.

    Args:
        columns: of the row. planned: the plan's row.
    """
    first, past = first_of(model, planned), state.earlier
    if not past.there[first]:
        return 1.0
    here = columns.about(state.belief.mean[: model.parameters])
    then = past.state[first].astype(float)
    shared = slice(0, len(state.belief.mean) - ANEW)
    change = here.state - then
    left = columns.residual - past.residual[first] - change[:, shared] @ state.belief.mean[shared]
    prior = model.covariance[-ANEW:, -ANEW:]
    spread = here.noise(model.noise.encoder) + past.noise[first]
    spread = spread + change[:, shared] @ state.belief.covariance[shared, shared] @ change[:, shared].T
    same = past.stance[first] == state.stance
    for one in (change,) if same else (here.state, then):
        spread = spread + one[:, -ANEW:] @ prior @ one[:, -ANEW:].T
    used = here.used & past.used[first]
    left, spread = left[used], spread[np.ix_(used, used)]
    scale = 1 / np.sqrt(np.diag(spread))
    scaled = scale * left
    square = float(scaled @ np.linalg.solve(scale[:, None] * spread * scale, scaled))
    return float(chi2_sf(square, used.sum()))


def with_earlier(model: DayModel, state: WatchState, columns: RowColumns, planned: int) -> Earlier:
    """Return what postures showed, with this row as the last time of its own."""
    at, past = first_of(model, planned), state.earlier
    here = columns.about(state.belief.mean[: model.parameters])
    changed = {
        "there": True,
        "stance": state.stance,
        "residual": columns.residual,
        "state": here.state,
        "noise": here.noise(model.noise.encoder),
        "used": columns.used,
    }
    out = {}
    for name, value in changed.items():
        out[name] = getattr(past, name).copy()
        out[name][at] = value
    return replace(past, **out)


def first_of(model: DayModel, planned: int) -> int:
    """Return the first row of the plan with the same posture."""
    return model.of_posture[int(model.plan.posture[planned])][0]
