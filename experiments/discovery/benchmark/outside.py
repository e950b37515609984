"""Faults that the catalogue never holds, to be hidden in data: the right answer is `unknown`.

Each acts on one joint, cell or plate, chosen by a number, in proportion to one amplitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.effects.injection import edited, misreading, passed
from experiments.effects.torso import FAR, hook, tie
from sim.measurements import Measurements
from sim.model import joint_names, load_model
from sim.rig import Rig


@dataclass(frozen=True)
class Outside:
    """A fault without an entry in the catalogue.

    Attributes:
        amplitude: a typical one [unit]; the benchmark draws multiples of it by what they show.
        inject: (rig, number of the target, amplitude) -> rig.
    """

    name: str
    sentence: str
    unit: str
    amplitude: float
    inject: Callable[[Rig, int, float], Rig]


def _angles(rig: Rig, number: int, error: Callable[[Measurements, int], np.ndarray]) -> Rig:
    """Joint `number`'s encoder errs by `error` of the measurements and the joint's number, (m,) [rad]."""

    def read(m: Measurements) -> Measurements:
        at = number % len(m.joints)
        wrong = np.zeros_like(m.joint_angles)
        wrong[:, at] = error(m, at)
        return replace(m, joint_angles=m.joint_angles + wrong)

    return misreading(rig, read)


def _cells(rig: Rig, number: int, error: Callable[[Measurements, int], np.ndarray]) -> Rig:
    """The same of a cell [N]."""

    def read(m: Measurements) -> Measurements:
        at = number % m.cell_forces.shape[1]
        wrong = np.zeros_like(m.cell_forces)
        wrong[:, at] = error(m, at)
        return replace(m, cell_forces=m.cell_forces + wrong)

    return misreading(rig, read)


def _eccentric(rig: Rig, number: int, amplitude: float) -> Rig:
    phase = 2.4 * number
    return _angles(rig, number, lambda m, at: amplitude * np.sin(m.joint_angles[:, at] + phase))


def _jump(rig: Rig, number: int, amplitude: float) -> Rig:
    return _angles(
        rig, number, lambda m, at: amplitude * (m.joint_angles[:, at] > np.median(m.joint_angles[:, at]))
    )


def _coupled(rig: Rig, number: int, amplitude: float) -> Rig:
    return _angles(rig, number, lambda m, at: amplitude * m.joint_angles[:, at - 1])


def _warm(rig: Rig, number: int, amplitude: float) -> Rig:
    return _cells(rig, number, lambda m, at: amplitude * (2 * passed(m.time) - 1) ** 2 * m.cell_forces[:, at])


def _walk(rig: Rig, number: int, amplitude: float) -> Rig:
    def walk(m: Measurements, at: int) -> np.ndarray:
        steps = np.random.default_rng(number).standard_normal(10_000)
        path = np.concatenate([[0.0], np.cumsum(steps)]) / 100
        return amplitude * np.interp(passed(m.time), np.linspace(0, 1, len(path)), path)

    return _cells(rig, number, walk)


def _bent(rig: Rig, number: int, amplitude: float) -> Rig:
    def read(m: Measurements) -> Measurements:
        forces = m.cell_forces.copy()
        plate = slice(4 * (number % 2), 4 * (number % 2) + 4)
        load = forces[:, plate].sum(axis=1, keepdims=True)
        forces[:, plate] *= 1 + amplitude * load / (m.gravity * 20.0)
        return replace(m, cell_forces=forces)

    return misreading(rig, read)


def _skewed(rig: Rig, number: int, amplitude: float) -> Rig:
    names = joint_names(load_model(rig.robot))

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(names[number % len(names)])
        across = np.roll(joint.axis, 1 + number % 2)
        joint.axis = Rotation.from_rotvec(amplitude * across).apply(joint.axis)

    return edited(rig, edit)


def _slack(rig: Rig, number: int, amplitude: float) -> Rig:
    hooked, turn = hook(rig.robot), 2.4 * number

    def edit(spec: mujoco.MjSpec) -> None:
        tie(spec, "slack", hooked, np.array([np.cos(turn), np.sin(turn)]), amplitude, FAR)
        spec.tendon("slack").springlength = [0.0, FAR]

    return edited(rig, edit)


OUTSIDE = tuple(
    Outside(*entry)
    for entry in (
        ("encoder-eccentric", "An encoder errs with one period a turn.", "rad", 0.01, _eccentric),
        ("encoder-jump", "An encoder reads too much beyond one angle.", "rad", 0.01, _jump),
        ("encoder-coupled", "A joint's reading depends on its neighbour's angle.", "", 0.01, _coupled),
        ("cell-warm", "A cell's gain grows with the square of a temperature.", "", 0.02, _warm),
        ("cell-walk", "A cell's zero walks at random.", "N", 1.0, _walk),
        ("plate-bent", "A plate's cells read in proportion to its load's square.", "", 0.02, _bent),
        ("axis-skewed", "A joint's axis is not where the drawing has it.", "rad", 0.01, _skewed),
        ("cable-slack", "A cable pulls at the torso on one side, slack on the other.", "N/m", 20.0, _slack),
    )
)
