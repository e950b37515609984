"""Readings of faulty instruments in an experiment by statics, by formulas of the study's own."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.injection import always, edited
from tulip_testbed.effects.targets import plate_of
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.sensors import PLATE, PRESETS, WrenchSensors
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

TILT = 2e-3  # rad, by which the floor is tilted to measure what the robot does then

Values = tuple[float, ...]


class Readings:
    """The readings of an experiment, which faults change in place.

    Attributes:
        true: the measurements by instruments without faults. rig, plan, seed: how they were made.
        angles: (m, n) [rad]. forces: (m, 2, 4) [N]. poses: of the plates, (m, 2, 3) [m, m, rad].
        time: as a fraction of the experiment's, (m,). load: on both plates, (m, 2) [N].
        new: whether the robot was set down again before a posture, (m,) bool.
    """

    def __init__(self, true: Measurements, rig: Rig, plan: PosturePlan, seed: int):
        self.true, self.rig, self.plan, self.seed = true, rig, plan, seed
        self.angles, self.poses = true.joint_angles.copy(), true.plate_poses.copy()
        self.forces = true.cell_forces.reshape(-1, 2, 4).copy()
        self.time = (true.time - true.time[0]) / np.ptp(true.time)
        self.load = self.forces.sum(axis=2)
        self.new = np.append(True, np.diff(true.placement) != 0)

    @property
    def measurements(self) -> Measurements:
        """Return the measurements with these readings."""
        forces = self.forces.reshape(-1, len(CELLS))
        return replace(self.true, joint_angles=self.angles, cell_forces=forces, plate_poses=self.poses)

    def before(self, values: np.ndarray) -> np.ndarray:
        """Return the values of the posture before, zero where the robot was set down again."""
        out = np.roll(values, 1, axis=0)
        out[self.new] = 0.0
        return out

    @cached_property
    def side(self) -> np.ndarray:
        """Return the true horizontal force of both plates on the feet, in their axes, (m, 2, 2) [N]."""
        sensors = replace(self.rig.sensors, wrench=WrenchSensors(place=PLATE))
        found, rows = self._again(always(self.rig, lambda rig: replace(rig, sensors=sensors)))
        assert found.truth.wrenches is not None
        return found.truth.wrenches[rows, :, :2]

    def tilt(self, about: np.ndarray) -> None:
        """Tilt the floor with robot and plates, about x and y by (m, 2) [rad]."""
        exact = always(self.rig, lambda rig: replace(rig, sensors=PRESETS["ideal"]))
        level = self._exact(exact)
        for axis, angle in zip("xy", about.T, strict=True):
            back = Rotation.from_euler(axis, -TILT)

            def edit(spec: mujoco.MjSpec, back: Rotation = back) -> None:
                spec.option.gravity = back.apply(spec.option.gravity)

            change = (self._exact(edited(exact, edit)) - level) * (angle / TILT)[:, None]
            self.angles += change[:, :-8]
            self.forces += change[:, -8:].reshape(self.forces.shape)

    def _exact(self, rig: Rig) -> np.ndarray:
        found, rows = self._again(rig)
        m = found.measurements
        return np.concatenate([m.joint_angles, m.cell_forces], axis=1)[rows]

    def _again(self, rig: Rig) -> tuple[Outcome, list[int]]:
        """Repeat the experiment with other sensors or another floor, and find the rows; no draw differs.

        Raises:
            InputError: there the robot falls in a posture that was measured.
        """
        stream = np.random.SeedSequence(self.seed)
        (found,) = run_statics(solve_plan(rig, self.plan), [stream], all_solved=True)
        rows = {time: row for row, time in enumerate(found.measurements.time.tolist())}
        times = self.true.time.tolist()
        if not rows.keys() >= set(times):
            raise InputError(f"the robot falls in {len(set(times) - rows.keys())} postures on another floor")
        return found, [rows[time] for time in times]


Reader = Callable[[Readings, str, Values], None]


def _on_joint(error: Callable[[Readings, np.ndarray, Values, int], np.ndarray | float]) -> Reader:
    def read(r: Readings, target: str, values: Values) -> None:
        at = r.true.joints.index(target)
        r.angles[:, at] += error(r, r.angles[:, at].copy(), values, at)

    return read


def _on_cells(error: Callable[[Readings, np.ndarray, Values], np.ndarray | float]) -> Reader:
    """Return a reader of one cell, of the four of a plate, or of all."""

    def read(r: Readings, target: str, values: Values) -> None:
        side, _, corner = target.partition(".")
        forces = r.forces[:, PLATES.index(side)] if side else r.forces
        forces = r.forces.reshape(-1, 8)[:, CELLS.index(target)] if corner else forces
        forces += error(r, forces.copy(), values)

    return read


def _on_poses(axes: slice) -> Reader:
    def read(r: Readings, target: str, values: Values) -> None:
        r.poses[:, PLATES.index(target), axes] -= values

    return read


def _misplaced_once(r: Readings, target: str, values: Values) -> None:
    r.poses[r.true.placement == int(target), PLATES.index("left"), :2] -= values


def _swapped(r: Readings, target: str, values: Values) -> None:
    side, pair = PLATES.index(target), [int(value) for value in values]
    r.forces[:, side, pair] = r.forces[:, side, pair[::-1]]


def _leg_load(r: Readings, angle: np.ndarray, values: Values, at: int) -> np.ndarray:
    return values[0] * r.load[:, PLATES.index(plate_of(r.rig.robot, r.true.joints[at]))]


def _command(r: Readings, angle: np.ndarray, values: Values, at: int) -> np.ndarray:
    assert r.true.command is not None
    return r.true.command[:, at] - angle


def _creep(r: Readings, load: np.ndarray, values: Values) -> np.ndarray:
    """Creep towards a part of the load, which the cell has borne since the posture before."""
    size, constant = values
    crept, kept = np.zeros(len(load)), np.exp(-np.diff(r.time) / constant)
    for k, part in enumerate(kept, 1):
        crept[k] = part * crept[k - 1] + (1 - part) * size * load[k]
    return crept


LOG = "logged-command"
# The order is that of the signals' way: the last acts on what the others have left.
READERS: dict[str, Reader] = {
    "encoder-gain": _on_joint(lambda r, angle, v, at: v[0] * angle),
    "encoder-load": _on_joint(_leg_load),
    "lag": _on_joint(lambda r, angle, v, at: v[0] * np.where(r.new, 0.0, r.before(angle) - angle)),
    "encoder-offset": _on_joint(lambda r, angle, v, at: v[0]),
    "encoder-slip": _on_joint(lambda r, angle, v, at: v[0] * (r.time >= v[1])),
    LOG: _on_joint(_command),
    "cell-crosstalk": _on_cells(lambda r, load, v: v[0] * (load.sum(axis=2, keepdims=True) - load)),
    "cell-hysteresis": _on_cells(lambda r, load, v: v[0] * (r.before(load) - load)),
    "creep": _on_cells(_creep),
    "cell-gain": _on_cells(lambda r, load, v: v[0] * load),
    "common-gain": _on_cells(lambda r, load, v: v[0] * load),
    "thermal-gain-drift": _on_cells(lambda r, load, v: v[0] * load * r.time[:, None, None]),
    "cell-tare": _on_cells(lambda r, load, v: v[0]),
    "cell-drift": _on_cells(lambda r, load, v: v[0] * r.time),
    "plate-drift": _on_cells(lambda r, load, v: v[0] * r.time[:, None]),
    "swapped-cells": _swapped,
    "plate-translation": _on_poses(slice(0, 2)),
    "plate-yaw": _on_poses(slice(2, 3)),
    "placement-blunder": _misplaced_once,
}


def couple(r: Readings, size: float, number: int) -> None:
    """Let every cell read a part of the side force that it bears, along an axis of its own."""
    along = np.random.default_rng(number).uniform(0, 2 * np.pi, (2, 4))
    borne = r.forces / r.forces.sum(axis=2, keepdims=True)
    r.forces += size * borne * np.einsum("msa,asc->msc", r.side, [np.cos(along), np.sin(along)])


def play(r: Readings, width: np.ndarray) -> None:
    """Let every encoder turn only when its joint has moved through a play, (n,) [rad]."""
    shown = r.angles[0].copy()
    for row in r.angles:
        shown = np.clip(shown, row - width / 2, row + width / 2)
        row[:] = shown


def bend(r: Readings, size: float, number: int) -> None:
    """Let both plates show the centre of pressure off by smooth waves over the place [m]."""
    rng = np.random.default_rng(number)
    for side, cells in enumerate(r.true.cells):
        load, parts = r.forces[:, side].sum(axis=1, keepdims=True), np.column_stack([cells, np.ones(4)])
        waves = rng.uniform(-np.pi, np.pi, (2, 2)) / np.abs(cells).max(axis=0)
        place = r.forces[:, side] @ cells / load
        off = size * np.sin(place @ waves + rng.uniform(0, 2 * np.pi, 2))
        r.forces[:, side] += load * off @ np.linalg.pinv(parts)[:2]


def wander(r: Readings, encoder: float, cell: float, seed: int) -> None:
    """Let all zeros wander slowly [rad, N]."""
    rng = np.random.default_rng(seed)
    for values, size in ((r.angles, encoder), (r.forces.reshape(-1, 8), cell)):
        turns, phase = rng.uniform([[0.3], [0.0]], [[1.5], [1.0]], (2, values.shape[1]))
        values += size * np.sin(2 * np.pi * (np.outer(r.time, turns) + phase))


def round_off(r: Readings, encoder: float, cell: float) -> None:
    """Round all readings to these steps [rad, N]."""
    for values, step in ((r.angles, encoder), (r.forces, cell)):
        values[:] = np.round(values / step) * step
