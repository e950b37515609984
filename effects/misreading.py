"""A misreading: an effect on readings alone, as a function of the measurements."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tulip_testbed.effects.injection import misreading
from tulip_testbed.effects.lasting import Values
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot


@dataclass(frozen=True)
class Misreading:
    """How an instrument misreads.

    Attributes:
        apply: (measurements, robot, target, values) -> the measurements that the faulty instruments give.
        remove: (observation, target, values) -> the observation with the readings corrected. It may share
            a formula with `apply`, because hand-worked readings in the tests hold sign and definition.
        unsure: see `Physics`.
    """

    apply: Callable[[Measurements, Robot, str, Values], Measurements]
    remove: Callable[[Observation, str, Values], Observation]
    unsure: Callable[[Observation, str, Values], Observation] | None = None

    def inject(self, rig: Rig, target: str, values: Values) -> Rig:
        return misreading(rig, lambda measurements: self.apply(measurements, rig.robot, target, values))


@dataclass(frozen=True)
class InstrumentFault:
    """A fault of an instrument in an experiment, with what its error may depend on.

    Attributes:
        measurements: the true ones while it is injected, what was read while it is removed.
        observed: the observation of what was read; None while it is injected.
    """

    target: str
    values: Values
    measurements: Measurements
    robot: Robot
    observed: Observation | None = None

    @property
    def size(self) -> float:
        return self.values[0]

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the columns of the joint angles."""
        return self.measurements.joints if self.observed is None else self.observed.tree.joints

    @property
    def time(self) -> np.ndarray:
        """Return the time as a fraction of the experiment's, (m,)."""
        return (
            fraction_of_time(self.measurements.time) if self.observed is None else self.observed.time_fraction
        )

    @property
    def down(self) -> np.ndarray:
        """Return the vertical force on both feet, (m, 2) [N]."""
        m = self.measurements
        if self.observed is not None:
            return self.observed.foot_loads[0]
        if m.contacts is None or m.wrenches is None:
            return m.cell_forces.reshape(-1, len(PLATES), len(CORNERS)).sum(axis=2)
        return m.wrenches[:, :, m.contacts.channels.index("fz")]


def mapped(
    field: str,
    misread: Callable[[np.ndarray, InstrumentFault], np.ndarray],
    correct: Callable[[np.ndarray, InstrumentFault], np.ndarray],
) -> Misreading:
    """Make a misreading from a function of true readings and its inverse.

    Args:
        field: `joint_angles`, `cell_forces` or `plate_poses`.
        misread: (true readings, fault) -> faulty ones.
        correct: (faulty readings, fault) -> true ones.
    """

    def apply(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
        read: Any = misread(getattr(m, field), InstrumentFault(target, values, m, robot))
        return replace(m, **{field: read})

    def remove(observed: Observation, target: str, values: Values) -> Observation:
        fault = InstrumentFault(target, values, observed.measurements, observed.nominal.robot, observed)
        return observed.changed(**{field: correct(getattr(observed, field), fault)})

    return Misreading(apply, remove)


def added(field: str, error: Callable[[InstrumentFault], np.ndarray]) -> Misreading:
    """Make a misreading of an error, reading minus truth, that does not depend on the reading itself."""
    return mapped(field, lambda true, fault: true + error(fault), lambda read, fault: read - error(fault))


def scaled(field: str, factor: Callable[[InstrumentFault], np.ndarray]) -> Misreading:
    """Make a misreading of a factor, reading over truth, in the shape of the readings or of one row."""
    return mapped(field, lambda true, fault: true * factor(fault), lambda read, fault: read / factor(fault))
