"""Compare what an effect changes in a simulation with its prediction."""

import numpy as np

from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import ANCHORED, ROWS, residuals
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SEED = 103  # bounds were set on seed 1
DISCOVERY_SEED = 7001  # no development seed
# A millimetre, a newton and a milliradian count the same.
UNIT = np.array([1e-3, 1e-3, 1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])


def first(plan, count):
    return plan.take(np.isin(plan.placement, np.unique(plan.placement)[:count]))


def statically(rig, plan, seed=1101) -> Measurements:
    return run_statics(solve_plan(rig, plan), [np.random.SeedSequence(seed)])[0].measurements


def measured(robot, plan, preset, *hidden, seed=DISCOVERY_SEED):
    """Simulate measurements of a laboratory with effects: (name, target, values)."""
    rig = preset_rig(preset, robot)
    for name, target, values in hidden:
        rig = catalogue()[name].inject(rig, target, values)
    return statically(rig, plan, seed)


def changes(nominal, base, with_it, effect, target, values, absorbed=True):
    """Compute the simulated and the predicted change of the residuals, both (k, 11).

    Only postures in both experiments count. What the base parameters (if `absorbed`) and the constants of a
    stance absorb is projected out of both, as a discovery does. Postures in which a board rests on three
    cells are left out, because small loads decide which these are. Of a board that rocks, and so rests on
    three cells in all of them, only the twist is left out.
    """
    observed, before = observe(with_it, nominal), observe(base, nominal)
    rows = {key: k for k, key in enumerate(_keys(base))}
    here = np.array([k for k, key in enumerate(_keys(with_it)) if key in rows])
    steady = np.where(observed.on_four_cells.any(axis=0), 1.0, 0.0)
    there = np.array([rows[_keys(with_it)[k]] for k in here])
    found, earlier = (residuals(one, nominal.value) for one in (observed, before))
    cleaned = residuals(effect.remove(observed, target, values), nominal.value)
    twisted = np.abs(earlier[there]) + np.abs(cleaned[here])
    kept = (twisted[:, ROWS["T"]] * steady).max(axis=1) < 1e-6
    here, there = here[kept], there[kept]
    differences = (found[here] - earlier[there], (found - cleaned)[here])
    regressor = nominal.parameters.regressor(with_it.joint_angles[here]).reshape(2 * len(here), -1)
    basis = np.linalg.qr(regressor)[0]
    stances = np.column_stack([observed.stance[here], before.stance[there]])
    projected = []
    for rows_of in differences:
        part = rows_of / UNIT
        part[:, ROWS["T"]] *= steady
        center = part[:, ROWS["A"]].ravel()
        if absorbed:
            part[:, ROWS["A"]] = (center - basis @ (basis.T @ center)).reshape(-1, 2)
        for pair in np.unique(stances, axis=0):
            mine = (stances == pair).all(axis=1)
            part[mine, ANCHORED] -= part[mine, ANCHORED].mean(axis=0)
        projected.append(part)
    return projected


def _keys(measurements):
    """Return each row's posture and the count of its measurements so far."""
    observed: dict[int, int] = {}
    keys = []
    for number in measurements.posture.tolist():
        observed[number] = observed.get(number, 0) + 1
        keys.append((number, observed[number]))
    return keys


def agreement(simulated, predicted):
    """Compute the cosine, and the slope of the simulated on the predicted change."""
    a, b = simulated.ravel(), predicted.ravel()
    return a @ b / np.linalg.norm(a) / np.linalg.norm(b), a @ b / (b @ b)
