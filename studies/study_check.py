"""How often `tulip check` cries wolf, and which planted faults it catches? Two Markdown tables.

The shipped plan is held once; the sensors are read anew for every draw. docs/check.md holds the result.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any

import joblib
import numpy as np

from studies.runner import header, row, rows_of, shipped_plan
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.sim.dynamics.dynamic_run import read_again, run_dynamics
from tulip_testbed.sim.measurements import Measurements, PosturePlan, SensorSheet
from tulip_testbed.sim.rig import Rig, preset_rig

Fault = Callable[[Measurements, np.random.Generator], Measurements]
PRESETS = ("wii", "force-plate")
SEED = 104
HEALTHY_DRAWS, FAULTY_DRAWS = 300, 40


def forces(change: Callable[[np.ndarray, Measurements, np.random.Generator], None]) -> Fault:
    """A fault that edits the cells' averages, (m, 8), in place."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values = m.cell_forces.copy()
        change(values, m, rng)
        return dataclasses.replace(m, cell_forces=values)

    return fault


def angles(change: Callable[[np.ndarray, Measurements, np.random.Generator], None]) -> Fault:
    """A fault that edits the joint angles, (m, n), in place."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values = m.joint_angles.copy()
        change(values, m, rng)
        return dataclasses.replace(m, joint_angles=values)

    return fault


def poses(change: Callable[[np.ndarray, np.random.Generator], None]) -> Fault:
    """A fault that edits one placement's plate poses, (k, 2, 3), in place."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values = m.plate_poses.copy()
        rows = m.placement == rng.choice(np.unique(m.placement))
        one = values[rows]
        change(one, rng)
        values[rows] = one
        return dataclasses.replace(m, plate_poses=values)

    return fault


def any_cell(rng: np.random.Generator) -> int:
    return int(rng.integers(8))


def gain(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, any_cell(rng)] *= 1.1


def tare(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, any_cell(rng)] += rng.choice([-5.0, 5.0])


def drift(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, any_cell(rng)] += 5.0 * (m.time - m.time[0]) / (m.time[-1] - m.time[0])


def saturate(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    cell = any_cell(rng)
    values[:, cell] = np.minimum(values[:, cell], np.quantile(values[:, cell], 0.8))


def unplug(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, any_cell(rng)] = (m.sensors.cell_sd or 0.0) * rng.standard_normal(len(m))


def in_kilograms(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values /= m.gravity


def swap_within(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    first, second = 4 * rng.integers(2) + rng.choice(4, size=2, replace=False)
    values[:, [first, second]] = values[:, [second, first]]


def swap_between(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    first, second = rng.integers(4), 4 + rng.integers(4)
    values[:, [first, second]] = values[:, [second, first]]


def swap_plates(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:] = values[:, [4, 5, 6, 7, 0, 1, 2, 3]]


def transpose_digits(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    """36 for 63: nine times the digits' difference."""
    values[rng.integers(len(m)), any_cell(rng)] += 9.0 * rng.choice([-3, -2, 2, 3])


def paste_row(m: Measurements, rng: np.random.Generator) -> Measurements:
    old, new = rng.choice(len(m), size=2, replace=False)
    q, f = m.joint_angles.copy(), m.cell_forces.copy()
    q[new], f[new] = q[old], f[old]
    return dataclasses.replace(m, joint_angles=q, cell_forces=f)


def mix_rows(m: Measurements, rng: np.random.Generator) -> Measurements:
    """The forces of two postures of a placement interchanged."""
    counts = np.bincount(m.placement)
    placement = rng.choice(np.flatnonzero(counts > 1))
    rows = rng.choice(np.flatnonzero(m.placement == placement), size=2, replace=False)
    f = m.cell_forces.copy()
    f[rows] = f[rows[::-1]]
    return dataclasses.replace(m, cell_forces=f)


def in_degrees(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    joint = rng.integers(len(m.joints))
    values[:, joint] = np.rad2deg(values[:, joint])


def all_degrees(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:] = np.rad2deg(values)


def zero_off(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(len(m.joints))] += np.deg2rad(1.0)


def sign_off(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(len(m.joints))] *= -1


def freeze(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    joint = rng.integers(len(m.joints))
    values[len(m) // 2 :, joint] = values[len(m) // 2, joint]


def shift_plate(one: np.ndarray, rng: np.random.Generator) -> None:
    plate, axis = rng.integers(2), rng.integers(2)
    one[:, plate, axis] += rng.choice([-0.03, 0.03])


def sign_of_x(one: np.ndarray, rng: np.random.Generator) -> None:
    one[:, 1, 0] *= -1


def sign_of_y(one: np.ndarray, rng: np.random.Generator) -> None:
    one[:, 1, 1] *= -1


def stated(**changes: float) -> Fault:
    """Stated figures times a factor."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values: dict[str, Any] = {name: factor * getattr(m.sensors, name) for name, factor in changes.items()}
        return dataclasses.replace(m, sensors=dataclasses.replace(m.sensors, **values))

    return fault


def weigh(m: Measurements, rng: np.random.Generator) -> Measurements:
    assert m.weighed_mass is not None
    return dataclasses.replace(m, weighed_mass=(m.weighed_mass[0] + 1.0, m.weighed_mass[1]))


FAULTS: dict[str, Fault] = {
    "one cell's gain 10 % high": forces(gain),
    "one cell's tare off by 5 N": forces(tare),
    "one cell drifts by 5 N": forces(drift),
    "one cell saturates in a fifth of the postures": forces(saturate),
    "one cell unplugged": forces(unplug),
    "two cells of a plate swapped": forces(swap_within),
    "two cells of different plates swapped": forces(swap_between),
    "right and left plate swapped": forces(swap_plates),
    "one force with two digits transposed": forces(transpose_digits),
    "one row pasted over another": paste_row,
    "forces of two postures interchanged": mix_rows,
    "one encoder in degrees": angles(in_degrees),
    "all encoders in degrees": angles(all_degrees),
    "one encoder's zero off by 1 degree": angles(zero_off),
    "one encoder's sign wrong": angles(sign_off),
    "one encoder frozen from halfway": angles(freeze),
    "one placement's plate recorded 30 mm off": poses(shift_plate),
    "one placement's left plate with the sign of x wrong": poses(sign_of_x),
    "one placement's left plate with the sign of y wrong": poses(sign_of_y),
    "forces in kilograms": forces(in_kilograms),
    "weighed mass 1 kg too high": weigh,
    "stated cell s.d. half of the true one": stated(cell_sd=0.5),
    "stated encoder s.d. half of the true one": stated(encoder_sd=0.5),
}

HEALTHY: dict[str, Callable[[Measurements], Measurements]] = {
    "whole folder": lambda m: m,
    "first fifteen placements": lambda m: rows_of(m, m.placement <= 15),
    "no weighed mass": lambda m: dataclasses.replace(m, weighed_mass=None),
    "nothing known of the sensors": lambda m: dataclasses.replace(m, sensors=SensorSheet()),
}


def results(m: Measurements, nominal: Nominal) -> dict[str, str]:
    return {finding.name: finding.result for finding in preflight(m, nominal)}


def healthy(rig: Rig, plan: PosturePlan, experiment: Experiment, nominal: Nominal, draw: int) -> list:
    m = read_again(rig, plan, experiment, np.random.default_rng([SEED, draw]))
    return [results(variant(m), nominal) for variant in HEALTHY.values()]


def faulty(rig: Rig, plan: PosturePlan, experiment: Experiment, nominal: Nominal, draw: int) -> list:
    rng = np.random.default_rng([SEED, 10**6 + draw])
    m = read_again(rig, plan, experiment, rng)
    return [results(fault(m, rng), nominal) for fault in FAULTS.values()]


def percent(seen: list[dict[str, str]], wanted: tuple[str, ...]) -> str:
    return f"{100 * np.mean([any(r in wanted for r in one.values()) for one in seen]):.3g} %"


def finders(seen: list[dict[str, str]]) -> str:
    """The checks that failed most often, or else warned."""
    for result in ("fail", "warn"):
        tally = Counter(name for one in seen for name, r in one.items() if r == result)
        if tally:
            return ", ".join(name for name, count in tally.most_common(2) if count > 0.2 * len(seen))
    return ""


def main() -> None:
    rig = preset_rig("ideal")
    plan, nominal = shipped_plan(rig.robot), nominal_robot(rig.robot)
    experiment = run_dynamics(rig, plan, SEED, workers=2)
    pool = joblib.Parallel(n_jobs=2)
    outcome: dict[str, dict[str, list]] = {"healthy": {}, "faulty": {}}
    for preset in PRESETS:
        read = preset_rig(preset)
        for kind, function, draws in (("healthy", healthy, HEALTHY_DRAWS), ("faulty", faulty, FAULTY_DRAWS)):
            jobs = (joblib.delayed(function)(read, plan, experiment, nominal, k) for k in range(draws))
            outcome[kind][preset] = list(zip(*pool(jobs), strict=True))
    print(header("healthy", *(f"{p}: {what}" for p in PRESETS for what in ("fail", "warn or fail"))))
    for k, name in enumerate(HEALTHY):
        seen = [outcome["healthy"][p][k] for p in PRESETS]
        print(row(name, *(percent(s, wanted) for s in seen for wanted in (("fail",), ("fail", "warn")))))
    kinds = ("fail", "warn or fail", "by")
    print("\n" + header("planted fault", *(f"{p}: {what}" for p in PRESETS for what in kinds)))
    for k, name in enumerate(FAULTS):
        seen = [outcome["faulty"][p][k] for p in PRESETS]
        cells = [(percent(s, ("fail",)), percent(s, ("fail", "warn")), finders(s)) for s in seen]
        print(row(name, *(cell for three in cells for cell in three)))


if __name__ == "__main__":
    main()
