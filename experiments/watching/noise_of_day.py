"""How long the noise of a motion lasts, by its first rows, before any of them is judged."""

from dataclasses import replace
from itertools import product

import numpy as np

from tulip_testbed.experiments.watching.day_model import DayModel
from tulip_testbed.experiments.watching.row_columns import RowColumns, row_columns
from tulip_testbed.experiments.watching.watch_row import rocking, spreads_of
from tulip_testbed.experiments.watching.watch_state import begin_row, first_state
from tulip_testbed.identification.noise_in_time import WHITE, NoiseInTime
from tulip_testbed.measurements import Measurements

FIRST = 120  # rows
SHARES, SECONDS = (0.5, 0.8, 0.9, 0.95, 0.98), (0.5, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
TRIED = (WHITE, *(NoiseInTime(*each) for each in product(SHARES, SECONDS)))


def with_noise_in_time(model: DayModel, rows: Measurements) -> DayModel:
    """Return the model of a moving day with the most likely correlation of the noise of its first rows.

    Args:
        rows: the first `FIRST` ones, so that the model does not depend on how many have arrived.
    """
    one_by_one = [rows.take(np.array([k])) for k in range(len(rows))]
    spreads = np.array([spreads_of(row) for row in one_by_one])
    rocks = np.array([rocking(row, spreads) for row in one_by_one])  # their twists are no noise
    columns = row_columns(model, rows).without_twist(rocks)
    return max((model.with_noise(one) for one in TRIED), key=lambda each: likelihood(each, rows, columns))


def likelihood(model: DayModel, rows: Measurements, columns: RowColumns) -> float:
    """Return ln of the likelihood of rows, but for a constant."""
    state, out = first_state(model), 0.0
    for k in range(len(rows)):
        state = begin_row(model, state, rows.take(np.array([k])), k)
        innovation = state.belief.predict(model, columns.row(k))
        _, volume = np.linalg.slogdet(innovation.covariance)
        out -= (innovation.chi_square + volume) / 2
        state = replace(state, belief=state.belief.updated(innovation))
    return out
