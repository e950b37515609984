"""Faults of a measurement folder, planted one at a time, and healthy folders."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tulip_testbed.measurements import Measurements, SensorSheet

Fault = Callable[[Measurements, np.random.Generator], Measurements]
Random = np.random.Generator


def edited(name: str, change: Callable[[np.ndarray, Measurements, Random], Any]) -> Fault:
    """Make a fault of a function that edits an array of the measurements, (m, ...), in place."""

    def fault(m: Measurements, rng: Random) -> Measurements:
        values = getattr(m, name).copy()
        change(values, m, rng)
        return replace(m, **{name: values})

    return fault


def cell(change: Callable[[np.ndarray, Measurements, Random], np.ndarray]) -> Fault:
    """Make a fault of a function of the readings of one cell, (m,)."""

    def edit(values: np.ndarray, m: Measurements, rng: Random) -> None:
        k = rng.integers(8)
        values[:, k] = change(values[:, k], m, rng)

    return edited("cell_forces", edit)


def joint(change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Make a fault of a function of the angles of one joint, (m,)."""

    def edit(values: np.ndarray, m: Measurements, rng: Random) -> None:
        k = rng.integers(len(m.joints))
        values[:, k] = change(values[:, k])

    return edited("joint_angles", edit)


def left_plate(axis: int, change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Make a fault of a function of a coordinate of the left plate in one placement, (k,)."""

    def edit(values: np.ndarray, m: Measurements, rng: Random) -> None:
        rows = m.placement == rng.choice(np.unique(m.placement))
        values[rows, 1, axis] = change(values[rows, 1, axis])

    return edited("plate_poses", edit)


def transpose_digits(values: np.ndarray, m: Measurements, rng: Random) -> None:
    """Write 36 for 63: the error is nine times the difference of the digits."""
    values[rng.integers(len(m)), rng.integers(8)] += 9.0 * rng.choice([-3, -2, 2, 3])


def paste_row(m: Measurements, rng: Random) -> Measurements:
    rows = np.arange(len(m))
    old, new = rng.choice(len(m), size=2, replace=False)
    rows[new] = old
    return replace(m, joint_angles=m.joint_angles[rows], cell_forces=m.cell_forces[rows])


def mix_rows(values: np.ndarray, m: Measurements, rng: Random) -> None:
    """Interchange the forces of two postures of a placement."""
    placement = rng.choice(np.flatnonzero(np.bincount(m.placement) > 1))
    rows = rng.choice(np.flatnonzero(m.placement == placement), size=2, replace=False)
    values[rows] = values[rows[::-1]]


def freeze(angles: np.ndarray) -> np.ndarray:
    half = len(angles) // 2
    return np.append(angles[:half], np.full(len(angles) - half, angles[half]))


def half_stated(name: str) -> Fault:
    """Halve an s.d. that the manifest states."""
    return lambda m, rng: replace(m, sensors=replace(m.sensors, **{name: 0.5 * getattr(m.sensors, name)}))


def weigh(m: Any, rng: Random) -> Measurements:
    return replace(m, weighed_mass=(m.weighed_mass[0] + 1.0, m.weighed_mass[1]))


# Each with the check that fails.
FAULTS: dict[str, tuple[Fault, str]] = {
    "one cell's gain 10 % high": (cell(lambda f, m, rng: 1.1 * f), "weight balance"),
    "one cell's tare off by 5 N": (cell(lambda f, m, rng: f + 5.0), "weight balance"),
    "one cell drifts by 5 N": (
        cell(lambda f, m, rng: f + 5.0 * (m.time - m.time[0]) / np.ptp(m.time)),
        "drift",
    ),
    "one cell saturates": (cell(lambda f, m, rng: np.minimum(f, np.quantile(f, 0.8))), "stuck readings"),
    "one cell unplugged": (
        cell(lambda f, m, rng: (m.sensors.cell_sd or 0.0) * rng.standard_normal(len(f))),
        "cell loads",
    ),
    "one force with two digits transposed": (edited("cell_forces", transpose_digits), "single postures"),
    "one row pasted over another": (paste_row, "stuck readings"),
    "forces of two postures interchanged": (edited("cell_forces", mix_rows), "single postures"),
    "one encoder in degrees": (joint(np.rad2deg), "units"),
    "all encoders in degrees": (lambda m, rng: replace(m, joint_angles=np.rad2deg(m.joint_angles)), "units"),
    "one encoder's zero off by 1 degree": (joint(lambda q: q + np.deg2rad(1.0)), "legs close"),
    "one encoder's sign wrong": (joint(np.negative), "legs close"),
    "one encoder frozen from halfway": (joint(freeze), "stuck readings"),
    "one placement's plate recorded 30 mm off": (left_plate(0, lambda x: x + 0.03), "single placements"),
    "one placement's left plate with the sign of x wrong": (left_plate(0, np.negative), "single placements"),
    "one placement's left plate with the sign of y wrong": (left_plate(1, np.negative), "plate poses"),
    "forces in kilograms": (lambda m, rng: replace(m, cell_forces=m.cell_forces / m.gravity), "units"),
    "weighed mass 1 kg too high": (weigh, "weight balance"),
    "stated cell s.d. half of the true one": (half_stated("cell_sd"), "weight balance"),
    "stated encoder s.d. half of the true one": (half_stated("encoder_sd"), "legs close"),
}

HEALTHY: dict[str, Callable[[Measurements], Measurements]] = {
    "whole folder": lambda m: m,
    "first fifteen placements": lambda m: m.take(m.placement <= 15),
    "no weighed mass": lambda m: replace(m, weighed_mass=None),
    "nothing known of the sensors": lambda m: replace(m, sensors=SensorSheet()),
}


def planted(fault: str, m: Measurements, seed: int = 0) -> Measurements:
    return FAULTS[fault][0](m, np.random.default_rng(seed))
