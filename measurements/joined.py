"""Several experiments with one robot as one set of measurements, whose rows know their experiment."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.measurements.data import Measurements, stacked
from tulip_testbed.measurements.manipulations import Experiment, arrangement_of, needs_cells
from tulip_testbed.measurements.measurement_folder import read_measurements, write_measurements

BREAK = 3600.0  # s, between two experiments
# rad, m, 100 N or 100 Nm: readings that agree better are the same. Repeats on force plates differ in some
# reading by eight times as much.
ALIKE = 1e-3
MOST_OFF = 5.0  # s.d., between weights of the same robot
SAME = ("gravity", "gains", "tolerances", "sensors")  # of all experiments, by the keys of their manifests


def joined(measured: Sequence[Measurements], sources: Sequence[str] = ()) -> Measurements:
    """Join experiments with one robot.

    Placements and postures are renumbered where two experiments share a number, and each experiment begins an
    hour after the one before. The weighed mass becomes that of the robot without known masses.

    Args:
        measured: in the order of time. One without session and manipulations alone is returned as it is.
    """
    names = list(sources) or [f"experiment {k + 1}" for k in range(len(measured))]
    parts = [(one, name) for m, name in zip(measured, names, strict=True) for one in separate(m)]
    if not parts:
        raise InputError("measurements: found none, expected one experiment or more")
    if len(parts) == 1 and not measured[0].experiments:
        return measured[0]
    for k, (one, name) in enumerate(parts):
        _check_manipulations(one, name)
        for other, before in parts[:k]:
            _check_pair(other, before, one, name)
            if sources:  # readings that a plan predicts for the same laboratory may well be alike
                _check_different(other, one, f"{name} and {before}")
    each = [one for one, _ in parts]
    for k, one in enumerate(each):
        if one.wrench_jerks is None and any(other.wrench_jerks is not None for other in each):
            each[k] = replace(one, wrench_jerks=np.full_like(one.wrenches, np.nan))  # of an older folder
    return replace(
        stacked(each),
        placement=np.concatenate(_renumbered([one.placement for one in each])),
        posture=np.concatenate(_renumbered([one.posture for one in each])),
        time=np.concatenate(_apart([one.time for one in each])),
        experiment=np.repeat(np.arange(len(each)), [len(one) for one in each]),
        experiments=tuple(_experiment(one) for one in each),
        weighed_mass=_weighed(parts),
    )


def as_joined(measurements: Measurements) -> Measurements:
    """Return measurements whose known masses are distinguished from the robot, as `joined` does it."""
    waiting = measurements.experiments and measurements.experiment is None
    return joined([measurements]) if waiting else measurements


def separate(measurements: Measurements) -> list[Measurements]:
    """Return the experiments that were joined, each as its folder has it."""
    m = measurements
    if m.experiment is None:
        return [m]
    out = []
    for k, experiment in enumerate(m.experiments):
        one = m.take(m.experiment == k)
        added, weighed = experiment.arrangement.known_mass, m.weighed_mass
        out.append(
            replace(
                one,
                time=one.time - one.time.min() if np.isfinite(one.time).all() else one.time,
                experiments=() if experiment == Experiment() else (experiment,),
                experiment=None,
                weighed_mass=None if weighed is None else (weighed[0] + added, weighed[1]),
            )
        )
    return out


def write_experiments(folder: Path, measurements: Measurements) -> None:
    """Write measurements as a folder, or as one folder for each experiment, 1, 2, ... within it."""
    if measurements.experiment is None:
        write_measurements(folder, measurements)
        return
    folder.mkdir()
    for k, one in enumerate(separate(measurements)):
        write_measurements(folder / str(k + 1), one)


def read_written(folder: Path) -> Measurements:
    several = sorted((path for path in folder.glob("*") if path.name.isdigit()), key=lambda p: int(p.name))
    folders = several or [folder]
    return joined([read_measurements(one) for one in folders], [str(one) for one in folders])


def _experiment(one: Measurements) -> Experiment:
    return one.experiments[0] if one.experiments else Experiment()


def _check_manipulations(one: Measurements, name: str) -> None:
    """Refuse manipulations that contradict each other or that the experiment cannot have."""
    where = f"{name}: key 'manipulations'"
    experiment = _experiment(one)
    arrangement = arrangement_of(experiment.manipulations, where)
    for joint in arrangement.zeroed:
        look_up("joint", joint, one.joints, where)
    for text in experiment.manipulations:
        if one.contacts is not None and needs_cells(text):
            raise InputError(
                f"{where}: found '{shortened(text)}' with wrench sensors, expected plates on cells"
            )
    if one.weighed_mass is not None and one.weighed_mass[0] <= arrangement.known_mass:
        raise InputError(
            f"{where}: found known masses of {arrangement.known_mass:g} kg and a weighed mass of "
            f"{one.weighed_mass[0]:g} kg, expected the robot's mass and the known masses together"
        )


def _check_pair(first: Measurements, name: str, second: Measurements, other: str) -> None:
    """Refuse two experiments that do not belong together."""
    both = f"{other} and {name}"
    same_hash = first.robot["sha256"] == second.robot["sha256"] is not None
    for key in ("sha256", "model", "stance_foot", "swing_foot"):
        a, b = first.robot[key], second.robot[key]
        unknown = key == "sha256" and None in (a, b)
        if a != b and not unknown and not (key == "model" and same_hash):
            raise InputError(
                f"{both}: key 'robot.{key}': found '{shortened(b)}' and '{shortened(a)}', expected one robot "
                "with one nominal model"
            )
    if first.joints != second.joints:
        raise InputError(f"{both}: key 'joints': found other joints, expected those of one robot")
    kinds = [_kind(one) for one in (second, first)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"{both}: found {kinds[0]} and {kinds[1]}, expected the same kind of sensors and of rows"
        )
    for key in SAME:
        if getattr(first, key) != getattr(second, key):
            raise InputError(
                f"{both}: key '{key}': found {shortened(getattr(second, key))} and "
                f"{shortened(getattr(first, key))}, expected the same in all experiments"
            )
    for key in ("cells", "top_height"):
        if not np.allclose(getattr(first, key), getattr(second, key), rtol=0.0, atol=1e-9):
            raise InputError(f"{both}: key 'plates': found other plates ({key}), expected the same ones")
    if first.contacts is not None and (first.contacts.zero_sd > 0).any():
        raise InputError(
            f"{both}: found wrench sensors with zeros that are not known, expected tared ones: several "
            "experiments have no common zeros yet"
        )
    _check_weights(first, second, both)


def _check_weights(first: Measurements, second: Measurements, both: str) -> None:
    """Refuse weights that known masses do not explain."""
    if first.weighed_mass is None or second.weighed_mass is None:
        return
    masses = [one.weighed_mass[0] - _experiment(one).arrangement.known_mass for one in (second, first)]  # pyrefly: ignore
    spread = float(np.hypot(first.weighed_mass[1], second.weighed_mass[1]))
    if abs(masses[0] - masses[1]) > MOST_OFF * max(spread, 1e-6):
        raise InputError(
            f"{both}: key 'weighed_mass': found a robot of {masses[0]:.3f} kg and of {masses[1]:.3f} kg "
            f"without the known masses of 'manipulations', expected the same within {MOST_OFF:g} s.d. "
            f"({spread:.2g} kg): a manipulation is missing or wrong"
        )


def _kind(one: Measurements) -> str:
    """Describe sensors and rows: rates count for all rows or none, and noise lasts by one window."""
    moves = "" if one.joint_rates is None else f" in windows of {one.window[0]:g} s of a robot that moves"
    if one.contacts is None:
        return f"plates on cells{moves}"
    return f"wrench sensors ({one.contacts.mount}; {', '.join(one.contacts.channels)}){moves}"


def _check_different(first: Measurements, second: Measurements, both: str) -> None:
    """Refuse an experiment half of whose rows are in the other one, perhaps rounded or in another order."""
    readings = []
    for one in sorted((first, second), key=len, reverse=True):
        forces = one.cell_forces if one.wrenches is None else np.nan_to_num(one.wrenches)
        parts = (one.joint_angles, one.plate_poses, forces / 100)
        readings.append(np.column_stack([part.reshape(len(one), -1) for part in parts]))
    more, fewer = readings
    alike = int(
        (scipy.spatial.KDTree(more).query(fewer, p=np.inf, distance_upper_bound=ALIKE)[0] < np.inf).sum()
    )
    if 2 * alike >= len(fewer) > 0:
        raise InputError(
            f"{both}: found the same measurements twice ({alike} of {len(fewer)} rows agree within "
            f"{ALIKE:g} rad or m and {100 * ALIKE:g} N), expected every experiment once"
        )


def _weighed(parts: Sequence[tuple[Measurements, str]]) -> tuple[float, float] | None:
    """Return the mass of the robot without known masses, by all weighings, and its s.d. [kg]."""
    # A weighing that several folders state counts once; adding and taking off masses rounds it.
    each: dict[tuple[float, float], tuple[float, float]] = {}
    for one, _ in parts:
        if one.weighed_mass is not None:
            own, sd = one.weighed_mass[0] - _experiment(one).arrangement.known_mass, one.weighed_mass[1]
            each.setdefault((round(own, 9), sd), (own, sd))
    found = sorted(each.values())
    if len(found) < 2:
        return found[0] if found else None
    values, spreads = np.array(found).T
    weight = 1 / np.maximum(spreads, 1e-6) ** 2
    return float((weight * values).sum() / weight.sum()), float(weight.sum() ** -0.5)


def _renumbered(numbers: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return numbers that no two experiments share; as they are if none is shared."""
    every = np.concatenate([np.unique(one) for one in numbers])
    if len(every) == len(np.unique(every)):
        return list(numbers)
    out, last = [], 0
    for one in numbers:
        out.append(one - one.min() + 1 + last)
        last = int(out[-1].max())
    return out


def _apart(times: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return times that increase from experiment to experiment [s]."""
    out, last = [], 0.0
    for k, one in enumerate(times):
        if k and np.isfinite(one).any():
            one = one - np.nanmin(one) + last + BREAK
        out.append(one)
        last = float(np.nanmax(one)) if np.isfinite(one).any() else last
    return out
