"""Simulate the adopted effects in the full dynamics and compare with the measurements and the predictions.

The comparison with the predictions cannot detect misreadings, because prediction and injection cancel.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import Figure
from tulip_testbed.discovery.discover import Discovery
from tulip_testbed.discovery.nominal_laboratory import exact_rig, measured_plan
from tulip_testbed.effects.instance import EffectInstance, injected, removed
from tulip_testbed.effects.lasting import acting
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import SIZE, residuals
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics

PLACEMENTS = 8


@dataclass(frozen=True)
class DynamicsCheck:
    """Some placements, simulated again with the adopted effects.

    Attributes:
        postures: number that stood. tried: number that were tried.
        left: root mean square of the residuals after the effects are removed from the simulated dynamics,
            relative to the noise; well below 1 if statics and dynamics agree about the adopted effects.
        cells: root mean square difference of measured and simulated cells, or vertical forces of wrench
            sensors, without and with the effects [N].
        reason: why nothing could be compared, or "".
    """

    postures: int
    tried: int
    left: Figure
    cells: tuple[Figure, Figure]
    reason: str


def check_in_dynamics(
    found: Discovery,
    adopted: Sequence[EffectInstance],
    workers: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> DynamicsCheck:
    """Simulate some placements in the full dynamics, without and with the adopted effects.

    Of several experiments it is the first in which the effects act.
    """
    observed, adopted, numbers = _simulated_part(found.observed, adopted)
    chosen = numbers[np.linspace(0, len(numbers) - 1, min(PLACEMENTS, len(numbers))).astype(int)]
    rows = np.flatnonzero(np.isin(observed.stance, chosen))
    plan = measured_plan(observed).take(rows)
    rig = exact_rig(observed)
    shown = {}
    try:
        for label, laboratory in (("before", rig), ("after", injected(rig, adopted))):
            shown[label] = run_dynamics(laboratory, plan, 0, workers, progress).measurements
    except InputError as error:
        return DynamicsCheck(0, len(rows), np.nan, (np.nan, np.nan), str(error))
    common = np.intersect1d(shown["before"].posture, shown["after"].posture)
    if not len(common):
        return DynamicsCheck(0, len(rows), np.nan, (np.nan, np.nan), "no posture stood both times")
    at = {key: np.array([list(m.posture).index(n) for n in common]) for key, m in shown.items()}
    plain, changed = (observe(shown[key], observed.nominal) for key in ("before", "after"))
    theta = observed.nominal.value
    left = residuals(removed(changed, adopted), theta)[at["after"]] - residuals(plain, theta)[at["before"]]
    white = found.selection.null.linear.whitening
    full = np.zeros((len(observed), SIZE))
    full[common - 1] = left
    full[common - 1, 3:5] *= changed.on_four_cells[at["after"]] & plain.on_four_cells[at["before"]]
    used = np.isin(white.rows // SIZE, common - 1)
    read = _forces(observed.measurements)[common - 1]
    cells = [float(np.sqrt(((_forces(m)[at[key]] - read) ** 2).mean())) for key, m in shown.items()]
    rms = float(np.sqrt((white(full)[used] ** 2).mean()))
    return DynamicsCheck(len(common), len(rows), rms, (cells[0], cells[1]), "")


def _simulated_part(
    observed: Observation, adopted: Sequence[EffectInstance]
) -> tuple[Observation, list[EffectInstance], np.ndarray]:
    """Return all rows, the effects as they act in one of the experiments, and the stances of that one."""
    m = observed.measurements
    if not m.experiments:
        return observed, list(adopted), np.unique(observed.stance)
    best, first = list[EffectInstance](), 0
    for k in range(len(m.experiments)):
        acts = [(one, acting(one.effect, one.target, one.values, m.experiments, k)) for one in adopted]
        own = [replace(one, target=act[0], values=act[1]) for one, act in acts if act is not None]
        if len(own) > len(best):
            best, first = own, k
    return observed, best, np.unique(observed.stance[m.of_experiment == first])


def _forces(m: Measurements) -> np.ndarray:
    """Return the readings of the cells, or the vertical forces of wrench sensors, (m, k) [N]."""
    if m.contacts is None or m.wrenches is None:
        return m.cell_forces
    return m.wrenches[:, :, m.contacts.channels.index("fz")]
