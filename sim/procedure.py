"""From what the sensors said to the data contract; common to both laboratories."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import Measurements, PosturePlan, SensorSheet
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.scene import nominal_plates
from tulip_testbed.sim.sensors import averaged_sd


def record_error(rig: Rig, rng: np.random.Generator, placements: int) -> np.ndarray:
    """Errors of both plates' recorded poses, (placements, 2, 3) [m, m, rad]."""
    sd = np.array([rig.sensors.mark_sd, rig.sensors.placement_sd])
    return sd * rng.standard_normal((placements, 2, 3))


def check_support(plan: PosturePlan) -> None:
    """Refuse postures that no laboratory stands on.

    Raises:
        InputError: a support other than both feet or the stance foot.
    """
    if (other := plan.support == "left").any():
        raise InputError(
            f"plan, posture {plan.posture[other.argmax()]}: found support 'left', expected 'double' or "
            "'right' (the laboratory stands on both feet or on the stance foot)"
        )


def support_of(plan: PosturePlan, posture: np.ndarray) -> np.ndarray:
    """Support of postures by their numbers, same shape."""
    by_number = dict(zip(plan.posture.tolist(), plan.support.tolist(), strict=True))
    return np.array([by_number[number] for number in posture.tolist()])


def choose_repeats(plan: PosturePlan, count: int, rng: np.random.Generator) -> frozenset[int]:
    """Numbers of the postures that are measured twice; none where the plan says itself what is repeated."""
    if plan.postures < len(plan):
        return frozenset()
    chosen = rng.choice(plan.posture, size=min(count, len(plan)), replace=False)
    return frozenset(int(number) for number in chosen)


def order_of_tries(plan: PosturePlan, placement: int, repeats: frozenset[int]) -> list[tuple[int, bool]]:
    """Rows of the plan in the order in which a placement tries them, and whether it is a repeat."""
    rows = np.flatnonzero(plan.placement == placement).tolist()
    return [(row, False) for row in rows] + [(row, True) for row in rows if int(plan.posture[row]) in repeats]


def new_set_up(placement: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Whether the robot is put down anew before a try, for all but the first, (k - 1,) bool."""
    return (placement[1:] != placement[:-1]) | (support[1:] != support[:-1])


def start_times(rig: Rig, placement: np.ndarray) -> np.ndarray:
    """When the averaged window of every try begins, (k,) [s].

    Args:
        placement: of every try, in the order of trying, (k,).
    """
    p = rig.protocol
    fresh = np.append(True, placement[1:] != placement[:-1])
    held = p.rest_time + p.hold_time
    return np.cumsum(np.where(fresh, p.placement_time, p.move_time) + held) - p.window


def stage_at(starts: np.ndarray, time: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Which of a rig's stages stood there at every try, (k,) of numbers.

    The experiment's time runs from the first to the last posture that could be used; which these
    are depends, at the ends, on the stage.

    Args:
        starts: parts of the experiment's time, the first 0, (s,). time: of every try, (k,) [s].
        used: whether a try can be used in a stage, (s, k) bool.
    """
    every = np.arange(len(time))
    stage = np.searchsorted(starts, (time - time[0]) / max(np.ptp(time), 1e-9), side="right") - 1
    for _ in starts:
        kept = time[used[stage, every]]
        if not len(kept):
            break
        part = (time - kept[0]) / max(np.ptp(kept), 1e-9)
        stage = np.maximum(np.searchsorted(starts, part, side="right") - 1, 0)
    return stage


def weigh(rig: Rig, mass: float, rng: np.random.Generator) -> tuple[float, float]:
    """The scale's reading of the whole robot and its s.d. [kg]."""
    return mass + rig.sensors.weighed_mass_sd * rng.standard_normal(), rig.sensors.weighed_mass_sd


def constants(rig: Rig) -> dict[str, Any]:
    """The fields of `Measurements` that no posture changes."""
    s = rig.sensors
    plates = nominal_plates(rig.robot)
    samples = round(rig.protocol.window * s.sample_rate)
    return {
        "cells": np.array([plate.cells for plate in plates]),
        "top_height": np.array([plate.top_height for plate in plates]),
        "gravity": float(-rig.robot.model.opt.gravity[2]),
        "sensors": SensorSheet(
            encoder_sd=averaged_sd(s.encoder_repeatability, s.encoder_noise, s.encoder_resolution, samples),
            encoder_resolution=s.encoder_resolution,
            cell_sd=averaged_sd(s.cell_repeatability, s.cell_noise, s.cell_resolution, samples),
            cell_resolution=s.cell_resolution,
            placement_sd=s.placement_sd,
        ),
        "robot": {
            "model": rig.robot.model_file.name,
            "sha256": rig.robot.model_hash,
            "stance_foot": rig.robot.stance_foot,
            "swing_foot": rig.robot.swing_foot,
        },
    }


def make_measurements(
    rig: Rig,
    fixed: dict[str, Any],
    reading: dict[str, np.ndarray],
    weighed_mass: tuple[float, float],
    **columns: Any,
) -> Measurements:
    """What the laboratory hands over of m held postures.

    Args:
        fixed: see `constants`.
        reading: what the sensors said: "q", "q_std", "motor", (m, n_joints); "cell", "cell_std", (m, 8).
        columns: the other fields of `Measurements`.
    """
    m = len(reading["q"])
    handed_over = Measurements(
        window=np.full(m, rig.protocol.window),
        samples=np.full(m, round(rig.protocol.window * rig.sensors.sample_rate)),
        joint_angles=reading["q"],
        joint_angles_sd=reading["q_std"],
        motor=reading["motor"],
        cell_forces=reading["cell"],
        cell_forces_sd=reading["cell_std"],
        weighed_mass=weighed_mass,
        **fixed,
        **columns,
    )
    return handed_over if rig.misread is None else rig.misread(handed_over)
