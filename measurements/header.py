"""The header of measurements: what holds for all of their rows, as the manifest of a folder states it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.measurements.stated_convention import StatedConvention


@dataclass(frozen=True)
class SensorSheet:
    """Data-sheet s.d. and resolution of a posture's averaged readings; None means unknown."""

    encoder_sd: float | None = None
    encoder_resolution: float | None = None
    cell_sd: float | None = None
    cell_resolution: float | None = None
    placement_sd: tuple[float, float, float] | None = None

    @property
    def known_placement_sd(self) -> tuple[float, float, float]:
        """Return `placement_sd`, zeros if it is unknown [m, m, rad]."""
        return self.placement_sd or (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasurementHeader:
    """Robot, joints and sensors of measurements.

    Attributes:
        robot: {"model", "sha256", "stance_foot", "swing_foot"} of the nominal robot; sha256 may be None.
        joints: joint names.
        cells: the cells' positions in their plate's frame, (2, 4, 2) [m].
        top_height: height of the plates' top surface over the floor, (2,) [m].
        gravity: acceleration of gravity [m/s2].
        sensors: data-sheet figures.
        weighed_mass: value and s.d. [kg], or None.
        gains: of the joints' servos, torque per error of the angle, by joint [Nm/rad]; one that is not
            stated is in proportion to the torque limit.
        tolerances: of families of ordinary imperfections by name, where they are known better than by the
            sensors [SI]; zero: exact.
        contacts: wrench sensors in place of the plates' cells; None: cells. With them there are no cells:
            `cells` is (2, 0, 2). In the feet, `top_height` is 0.
        constant_joints: s.d. of joints that are not logged but known to stand still, by name [rad].
        conventions: of the log that the measurements were made from, as an audit found them; empty: none.
        experiments: session and manipulations of each of several experiments that were joined, or of this
            one where they are stated; empty: nothing is stated.
    """

    robot: dict[str, str | None]
    joints: tuple[str, ...]
    cells: np.ndarray
    top_height: np.ndarray
    gravity: float
    sensors: SensorSheet
    weighed_mass: tuple[float, float] | None = None
    gains: Mapping[str, float] = field(default_factory=dict)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    contacts: Contacts | None = None
    constant_joints: Mapping[str, float] = field(default_factory=dict)
    conventions: tuple[StatedConvention, ...] = ()
    experiments: tuple[Experiment, ...] = ()

    @property
    def stated(self) -> dict[str, Any]:
        """Return the fields of the header by name, for measurements with the same header."""
        return {one.name: getattr(self, one.name) for one in fields(MeasurementHeader)}

    @property
    def on_plates(self) -> bool:
        """Return whether the robot stands on plates whose poses are recorded, not on sensors in its feet."""
        return self.contacts is None or self.contacts.mount == "ground"
