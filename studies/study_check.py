"""Measure false alarms of `tulip check` and the planted faults that it finds (docs/studies/check.md; ten minutes).

The shipped plan is held once; sensors, plate records and scale are read again for every draw. Ordinary
laboratories are drawn and measured again, in the static laboratory.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.calibration.usual_changes import usual_changes
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.measurements import Measurements, PosturePlan, SensorSheet
from tulip_testbed.sim.dynamics.dynamic_run import read_again, run_dynamics
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.rig import Rig, preset_rig

Fault = Callable[[Measurements, np.random.Generator], Measurements]
SETTINGS = Settings(seed=104, only=("wii", "force-plate"))
HEALTHY_DRAWS, FAULTY_DRAWS, ORDINARY_DRAWS = 300, 40, 200


def edited(name: str, change: Callable[[np.ndarray, Measurements, np.random.Generator], None]) -> Fault:
    """Make a fault of a function that edits an array of the measurements, (m, ...), in place."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values = getattr(m, name).copy()
        change(values, m, rng)
        return dataclasses.replace(m, **{name: values})

    return fault


forces, angles = partial(edited, "cell_forces"), partial(edited, "joint_angles")


def poses(change: Callable[[np.ndarray, np.random.Generator], None]) -> Fault:
    """Make a fault of a function that edits the plate poses of one placement, (k, 2, 3), in place."""

    def edit(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
        rows = m.placement == rng.choice(np.unique(m.placement))
        one = values[rows]
        change(one, rng)
        values[rows] = one

    return edited("plate_poses", edit)


def gain(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(8)] *= 1.1


def tare(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(8)] += rng.choice([-5.0, 5.0])


def drift(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(8)] += 5.0 * (m.time - m.time[0]) / (m.time[-1] - m.time[0])


def saturate(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    cell = rng.integers(8)
    values[:, cell] = np.minimum(values[:, cell], np.quantile(values[:, cell], 0.8))


def unplug(values: np.ndarray, m: Measurements, rng: np.random.Generator) -> None:
    values[:, rng.integers(8)] = (m.sensors.cell_sd or 0.0) * rng.standard_normal(len(m))


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
    """Write 36 for 63: the error is nine times the difference of the digits."""
    values[rng.integers(len(m)), rng.integers(8)] += 9.0 * rng.choice([-3, -2, 2, 3])


def paste_row(m: Measurements, rng: np.random.Generator) -> Measurements:
    old, new = rng.choice(len(m), size=2, replace=False)
    q, f = m.joint_angles.copy(), m.cell_forces.copy()
    q[new], f[new] = q[old], f[old]
    return dataclasses.replace(m, joint_angles=q, cell_forces=f)


def mix_rows(m: Measurements, rng: np.random.Generator) -> Measurements:
    """Interchange the forces of two postures of a placement."""
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
    """Multiply figures that the manifest states."""

    def fault(m: Measurements, rng: np.random.Generator) -> Measurements:
        values: dict[str, Any] = {name: factor * getattr(m.sensors, name) for name, factor in changes.items()}
        return dataclasses.replace(m, sensors=dataclasses.replace(m.sensors, **values))

    return fault


def weigh(m: Measurements, rng: np.random.Generator) -> Measurements:
    assert m.weighed_mass is not None
    return dataclasses.replace(m, weighed_mass=(m.weighed_mass[0] + 1.0, m.weighed_mass[1]))


ORDINARY = "everything a little off"
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
    "first fifteen placements": lambda m: m.take(m.placement <= 15),
    "no weighed mass": lambda m: dataclasses.replace(m, weighed_mass=None),
    "nothing known of the sensors": lambda m: dataclasses.replace(m, sensors=SensorSheet()),
}


def results(m: Measurements, nominal: Nominal) -> dict[str, str]:
    found = preflight(m, nominal, usual_changes=partial(usual_changes, m, nominal))
    return {finding.name: finding.result for finding in found}


def healthy(rig: Rig, plan: PosturePlan, experiment: Outcome, nominal: Nominal, stream: list[int]) -> list:
    m = read_again(rig, plan, experiment, np.random.default_rng(stream))
    return [results(variant(m), nominal) for variant in HEALTHY.values()]


def faulty(rig: Rig, plan: PosturePlan, experiment: Outcome, nominal: Nominal, stream: list[int]) -> list:
    rng = np.random.default_rng(stream)
    m = read_again(rig, plan, experiment, rng)
    return [results(fault(m, rng), nominal) for fault in FAULTS.values()]


def ordinary(preset: str, rig: Rig, plan: PosturePlan, nominal: Nominal, stream: list[int]) -> list:
    """Run a laboratory in which all is a little off, with spreads of 0.1 to 1 tolerance."""
    drawing, measuring = np.random.SeedSequence(stream).generate_state(2).tolist()
    hidden = ordinary_members(rig, np.random.default_rng(drawing))
    laboratory = Laboratory(rig.robot, preset, hidden=hidden)
    return [results(laboratory.run(plan, measuring, "statics", workers=1).measurements, nominal)]


def percent(seen: list[dict[str, str]], wanted: tuple[str, ...]) -> str:
    return f"{100 * np.mean([any(r in wanted for r in one.values()) for one in seen]):.3g} %"


def finders(seen: list[dict[str, str]]) -> str:
    """Name the checks that failed most often or, if none failed, that warned."""
    for result in ("fail", "warn"):
        tally = Counter(name for one in seen for name, r in one.items() if r == result)
        if tally:
            return ", ".join(name for name, count in tally.most_common(2) if count > 0.2 * len(seen))
    return ""


def study(settings: Settings) -> Iterator[str]:
    """Yield a table of false alarms and one of planted faults."""
    rig, presets, seed = preset_rig("ideal"), settings.only, settings.seed
    plan, nominal = shipped_plan(rig.robot), nominal_robot(rig.robot)
    experiment = run_dynamics(rig, plan, seed, settings.workers)

    def outcomes(preset: str, function: Callable[..., list], first: int, draws: int) -> list:
        """Return the results of every draw for each kind of folder."""
        read = preset_rig(preset)
        streams = ([seed, first + k] for k in range(settings.count(draws)))
        given = (preset, read, plan, nominal) if function is ordinary else (read, plan, experiment, nominal)
        calls = ((*given, stream) for stream in streams)
        return list(zip(*settings.parallel(f"{preset}, {function.__name__}", function, calls), strict=True))

    seen = [
        outcomes(p, healthy, 0, HEALTHY_DRAWS) + outcomes(p, ordinary, 2 * 10**6, ORDINARY_DRAWS)
        for p in presets
    ]
    yield header("healthy", *(f"{p}: {what}" for p in presets for what in ("fail", "warn or fail")))
    for name, *found in zip((*HEALTHY, ORDINARY), *seen, strict=True):
        yield row(
            name, *(percent(draws, wanted) for draws in found for wanted in (("fail",), ("fail", "warn")))
        )
    seen = [outcomes(preset, faulty, 10**6, FAULTY_DRAWS) for preset in presets]
    kinds = ("fail", "warn or fail", "by")
    yield "\n" + header("planted fault", *(f"{p}: {what}" for p in presets for what in kinds))
    for name, *found in zip(FAULTS, *seen, strict=True):
        cells = [
            (percent(draws, ("fail",)), percent(draws, ("fail", "warn")), finders(draws)) for draws in found
        ]
        yield row(name, *(cell for three in cells for cell in three))
